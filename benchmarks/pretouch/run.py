"""The pre-touch study (C5): `python -m benchmarks pretouch [--quick]`; results/pretouch.md is written by hand."""

from __future__ import annotations

import resource
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.pretouch.rates import RatesStudy, numbers
from benchmarks.pretouch.scenes import (
    DRIVE_HZ,
    LEVEL,
    RATE_HZ,
    SPEEDS_M_S,
    Event,
    course,
    events,
    passage,
    plant_of,
)
from benchmarks.pretouch.study import (
    FULL,
    QUICK,
    SEED_MATCH,
    SEED_TEST,
    PretouchSize,
    Verdict,
    calibrate,
    contact_judges,
    judged,
    matched_db,
    pretouch_judges,
)
from benchmarks.results import progress, save, workers
from drivers.mock.physics.aura_objects import SIDES, SIX, SOFT

SWEEP_DB = (0, 5, 10, 15, 20, 25, 30, 35, 40)
AFAR_M = 0.12


def main(quick: bool = False) -> None:
    """Run the study, print its progress; writes results/pretouch.json."""
    started_s, size = time.perf_counter(), QUICK if quick else FULL
    with workers() as pool:
        study = _study(size, pool)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = time.process_time() + children.ru_utime + children.ru_stime
    study = replace(study, cost_ns=costs(), wall_s=time.perf_counter() - started_s, cpu_s=cpu_s)
    save("pretouch", numbers(study), quick=quick)


def _study(size: PretouchSize, pool: ProcessPoolExecutor) -> RatesStudy:
    plain_thresholds = calibrate(0.0, size, pool)
    progress("thresholds at the plant's default echo")
    weaker_db, found_db = matched_db(plain_thresholds, size, pool)
    progress(f"the paper's own rate comes out of the paper's detector {weaker_db} dB below")
    thresholds = calibrate(float(weaker_db), size, pool)
    work = list(events(SEED_TEST, size.touches, size.nears, size.others, weaker_db=float(weaker_db)))
    matched = judged(work, thresholds, pool)
    progress(f"{len(work)} passages at that echo")
    plain = judged(list(events(SEED_TEST + 1, *size.plain)), plain_thresholds, pool)
    soft = {
        db: judged(
            list(events(SEED_TEST + 2, size.soft, size.soft, 0, SOFT, float(db))),
            thresholds if db else plain_thresholds,
            pool,
        )
        for db in (0, weaker_db)
    }
    sweep = {db: _sweep(db, size, plain_thresholds, pool) for db in SWEEP_DB}
    afar = judged(_from_afar(size), plain_thresholds, pool)
    progress("plain, soft, weaker and from afar")
    sampled = work[:: size.carrier]
    by_carrier = judged(sampled, thresholds, pool, carrier=True)
    progress(f"{len(sampled)} of them at carrier level")
    return RatesStudy(
        size=size,
        weaker_db=weaker_db,
        found_db=found_db,
        thresholds=thresholds,
        plain_thresholds=plain_thresholds,
        matched=matched,
        plain=plain,
        soft=soft,
        sweep=sweep,
        afar=afar,
        by_envelope=matched[:: size.carrier],
        by_carrier=by_carrier,
        blind=blind_spots(),
    )


def _sweep(
    db: int, size: PretouchSize, thresholds: dict[str, float], pool: ProcessPoolExecutor
) -> list[Verdict]:
    """Approaches at one strength of the echo."""
    work = list(events(SEED_MATCH + 1, 0, max(1, size.match // 4), 0, weaker_db=float(db)))
    return judged(work, thresholds, pool)


def _from_afar(size: PretouchSize) -> list[Event]:
    """Approaches with the normal side that begin beyond every detection range."""
    return [
        Event(SEED_TEST + 3, number, "near", name, "normal", speed_m_s, 0.0, AFAR_M)
        for number, (name, speed_m_s, _) in enumerate(
            (name, speed_m_s, again) for name in SIX for speed_m_s in SPEEDS_M_S for again in range(size.afar)
        )
    ]


def blind_spots() -> dict[str, float]:
    """Shares of places between 1 and 5 cm, before the pipe, where a small motion changes the in-phase channel by less
    than 30 and 10 % of the change of I and Q together; and the same for I and Q."""
    low = {"in-phase, below 30 %": [], "in-phase, below 10 %": [], "I and Q, below 30 %": []}  # type: dict[str, list[float]]
    for number, side in enumerate(SIDES):
        event = Event(SEED_MATCH, number, "near", "pipe", side, 0.01)
        times_s = np.arange(0.0, 8.0, 1.0 / RATE_HZ)
        found = course(event, times_s)
        n = len(times_s)
        field = plant_of(event).field(found.motion, times_s, np.full(n, DRIVE_HZ), np.full(n, LEVEL), (0,))
        gap_m = found.motion.gap_m[:, 0]
        moving = (np.diff(gap_m) < 0.0) & (gap_m[1:] > 0.01) & (gap_m[1:] < 0.05)
        slope = np.diff(field[:, 0])[moving] / np.diff(gap_m)[moving]
        share = np.abs(slope.real) / np.abs(slope)
        low["in-phase, below 30 %"].append(float(np.mean(share < 0.3)))
        low["in-phase, below 10 %"].append(float(np.mean(share < 0.1)))
        # against the largest within an undulation to either side
        around = np.array([np.abs(slope)[max(0, i - 430) : i + 430].max() for i in range(len(slope))])
        low["I and Q, below 30 %"].append(float(np.mean(np.abs(slope) < 0.3 * around)))
    return {name: float(np.mean(shares)) for name, shares in low.items()}


def costs() -> dict[str, float]:
    """Nanoseconds a sample (I and Q of one finger at 1 kHz, blocks of 64): median of five runs over one passage."""
    record = passage(Event(SEED_MATCH, 0, "touch", "mug", "normal", 0.01))
    whole, encoder = record.block, record.encoder
    pieces: list[Any] = []
    for first in range(0, len(whole), 64):
        pieces.append(
            replace(
                whole, seq=first, t0_s=whole.t0_s + first / RATE_HZ, values=whole.values[first : first + 64]
            )
        )
        pieces.append(
            replace(
                encoder,
                seq=first // 2,
                t0_s=first / RATE_HZ,
                values=encoder.values[first // 2 : first // 2 + 32],
            )
        )
    found = {}
    for name, judge in {**pretouch_judges({}), **contact_judges({})}.items():
        taken: Sequence[float] = [_timed(judge, pieces) for _ in range(5)]
        found[name] = float(np.median(taken)) / len(whole)
    return found


def _timed(judge: Any, pieces: Sequence[Any]) -> float:
    judge.reset()
    started = time.process_time_ns()
    for piece in pieces:
        if piece.stream in judge.inputs:
            judge.push(piece)
    return float(time.process_time_ns() - started)
