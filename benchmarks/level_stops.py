"""Contact by level where the arm rings at its stops, with and without the encoder: `python -m benchmarks level_stops`.

Passages of results/pretouch.md with the plant's own echo. A mechanism that moves more quietly than the plant's rings at
each stop: 1e-4 of full scale, 5 to 60 Hz, gone in 0.08 to 0.25 s, in a direction drawn anew. Thresholds are set on
other passages, or are as shipped.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from behaviors.events import Contact
from benchmarks import pretouch as study
from benchmarks.pretouch import RATE_HZ, Complexes, Event, Floats, PassageRecord, rate
from benchmarks.results import in_parallel, save, workers
from controller.detectors.level import LevelDetector, LevelSettings
from simulator.physics.aura_settings import NOTHING, SIDES, SIX

RING_FS = 1e-4
RING_HZ, RING_S = (5.0, 60.0), (0.08, 0.25)
MOVERS_FS = (1e-5, 5e-5, 2e-4)
"""Noise of the mechanism at 0.01 m/s (`motion_fs`): a quiet one, a middling one, the plant's own."""

DETECTORS: Mapping[str, LevelSettings] = {
    "level": LevelSettings(),
    "level, given the stops": LevelSettings(position_input="arm.position"),
}
SEED_SET, SEED_JUDGED = 51_000, 52_000
TNR = 0.987
"""Of passages that set thresholds (Rupavatharam et al., IV.B)."""

KINDS: tuple[study.Kind, ...] = ("nothing", "near", "touch")
FULL, QUICK = 200, 20
"""Passages of each kind; as many set thresholds, of the first two kinds."""


class Rung(NamedTuple):
    """A passage: its kind and number, the part that it belongs to, and the mechanism's noise."""

    kind: study.Kind
    number: int
    seed: int
    motion_fs: float


def simulate(rung: Rung) -> PassageRecord:
    """The passage, with what rings."""
    number = rung.number
    thing = NOTHING if rung.kind == "nothing" else SIX[number // 10 % 6]
    side, speed_m_s = SIDES[number // 2 % 5], study.SPEEDS_M_S[number % 2]
    record = study.passage(
        Event(rung.seed, number, rung.kind, thing, side, speed_m_s, motion_fs=rung.motion_fs)
    )
    event = record.event
    way_m = study.course(event, record.times_s)[0].x_m
    return replace(record, z=record.z + ringing(way_m, np.random.default_rng((rung.seed, number, 3))))


def ringing(way_m: Floats, rng: np.random.Generator) -> Complexes:
    """What a mover adds that rings after each stop, by its way at each sample, shape (n,)."""
    moves = np.abs(np.diff(way_m)) > 0.0
    stops = np.flatnonzero(moves[:-1] & ~moves[1:]) + 2
    found = np.zeros(len(way_m), dtype=np.complex128)
    for stop in stops.tolist():
        after_s = np.arange(len(way_m) - stop) / RATE_HZ
        phase_rad, towards_rad = rng.uniform(0.0, 2.0 * math.pi, 2)
        swing = np.cos(2.0 * math.pi * rng.uniform(*RING_HZ) * after_s + phase_rad)
        found[stop:] += RING_FS * np.exp(1j * towards_rad - after_s / rng.uniform(*RING_S)) * swing
    return found


def on_top(rung: Rung) -> bool:
    """Whether the finger's top goes ahead."""
    return SIDES[rung.number // 2 % 5] == "top"


def judged(given: tuple[Rung, Mapping[str, float]]) -> dict[str, tuple[float, bool, bool]]:
    """Of each detector: the largest statistic of a passage without a touch; whether there was no contact; whether the
    touch was felt, no sooner than it and within 0.5 s."""
    rung, thresholds = given
    record, found = simulate(rung), {}
    for name, settings in DETECTORS.items():
        at = thresholds.get(name, math.inf if rung.seed == SEED_SET else settings.threshold)
        detector = LevelDetector(name, settings.model_copy(update={"threshold": min(at, 1e9)}))
        events, values = [], [0.0]
        for block in (record.block, record.encoder):
            events += [event for event in detector.push(block) if isinstance(event, Contact)]
            values += [reading for reading in detector.readings[:, 1].tolist() if math.isfinite(reading)]
        felt = False
        if record.touched is not None and events:
            felt = -1e-3 <= events[0].t_s - float(record.times_s[record.touched]) <= study.LATE_S
        found[name] = (max(values), not events, felt)
    return found


def main(quick: bool = False) -> None:
    """Run the study; writes results/level_stops.json."""
    started_s, each = time.perf_counter(), QUICK if quick else FULL
    rows: dict[str, Any] = {}
    with workers() as pool:
        for motion_fs in MOVERS_FS:
            quiet = [Rung(kind, i, SEED_SET, motion_fs) for kind in KINDS[:2] for i in range(each)]
            sets = in_parallel(judged, [(rung, {}) for rung in quiet], pool)
            own = {
                name: float(np.quantile([one[name][0] for one in sets], TNR, method="higher"))
                for name in DETECTORS
            }
            work = [Rung(kind, i, SEED_JUDGED, motion_fs) for kind in KINDS for i in range(each)]
            for about, thresholds in (("as shipped", {}), ("own threshold", own)):
                found = list(
                    zip(work, in_parallel(judged, [(rung, thresholds) for rung in work], pool), strict=True)
                )
                for name in DETECTORS:
                    rows[f"{motion_fs:g} | {name} | {about}"] = {
                        "threshold": thresholds.get(name, DETECTORS[name].threshold),
                        **{
                            kind: rate(one[name][1] for rung, one in found if rung.kind == kind)
                            for kind in KINDS[:2]
                        },
                        "touch": rate(one[name][2] for rung, one in found if rung.kind == "touch"),
                        "top": rate(
                            one[name][2] for rung, one in found if rung.kind == "touch" and on_top(rung)
                        ),
                    }
    save("level_stops", {"rows": rows, "wall_s": time.perf_counter() - started_s}, quick=quick)
