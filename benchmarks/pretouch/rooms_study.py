"""Pre-touch in difficult rooms: `python -m benchmarks pretouch_rooms`.

Thresholds are set on random rooms, rates are from other rooms, one nuisance at a time and all at once.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.pretouch.rooms import ROOMS, TRAINING, UNDULATION_M, FingerRecord, Passing, passings, simulate
from benchmarks.pretouch.scenes import RATE_HZ
from benchmarks.pretouch.scoring import Rate, rate
from benchmarks.results import save, workers
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings

Floats = NDArray[np.float64]

TNR = 0.99
"""Of whole passages, on the rooms that set thresholds."""

NEEDED_M = 0.025
"""Distance from which an object must be detected."""

SEED_TRAINING, SEED_JUDGED = 61_000, 62_000
STRENGTHS_DB = (0.0, 17.0)
"""Reductions of the echo: none, and so that the paper's detector has the paper's
rate (results/pretouch.md)."""

WINDOWS_S = (0.125, 0.25, 0.5)
TURNS = (2, 3)
OURS = "pretouch"
OWN = {
    OURS: PreTouchSettings(),
    "pretouch, set for an empty room": PreTouchSettings(background_fs=0.0, obliquity=(1.0,)),
}
AS_IT_IS = "pretouch, own threshold"
EVERY = 10
"""Samples between outputs of the rival with the commanded speed."""


class RoomOutcome(NamedTuple):
    """Results of the detectors on a passage.

    Attributes:
        passing: Which.
        rising: By detector: each new largest statistic, and the distance at which it was reached, shape (2, m).
    """

    passing: Passing
    rising: dict[str, Floats]


def statistics(record: FingerRecord) -> dict[str, Floats]:
    """Each detector's statistic, sample by sample; NaN where it has none."""
    values = np.column_stack((record.z.real, record.z.imag, record.position_m))
    found = {}
    for window_s in WINDOWS_S:
        paper = PreTouchPaperDetector("paper", PreTouchPaperSettings(window_s=window_s))
        found[f"paper, {window_s:g} s"] = paper.statistic(values[:, :1], RATE_HZ)
    for turns in TURNS:
        found[f"I and Q at the commanded speed, {turns}"] = commanded(record, turns)
    waves = [commanded(record, TURNS[0], share) for share in OWN[OURS].obliquity]
    found[f"I and Q at the commanded speed, {TURNS[0]}, seven waves"] = np.fmax.reduce(waves)
    for name, settings in OWN.items():
        found[name] = PreTouchDetector(name, settings).statistic(values, RATE_HZ)
    return found


def commanded(record: FingerRecord, turns: int, share: float = 1.0) -> Floats:
    """Power of the wave that an object makes at the commanded speed times `share`, over so many undulations.

    A rival: it uses I and Q and the commanded speed, and needs no encoder. The window's level cancels,
    since it holds whole turns; a slope is estimated from its halves and removed. Shape (n,).
    """
    n = round(turns * UNDULATION_M / (share * record.speed_m_s) * RATE_HZ)
    rate_rad = 2.0 * math.pi * turns / n
    ends = np.arange(n, len(record.z) + 1, EVERY)
    found = np.full(len(record.z), np.nan)
    if not len(ends):
        return found
    level = np.concatenate(([0.0], np.cumsum(record.z)))
    half = n // 2
    late, early = level[ends] - level[ends - half], level[ends - half] - level[ends - n]
    slope = (late / half - early / (n - half)) / (n / 2.0)
    inside = np.arange(n)
    powers = []
    for sense in (1.0, -1.0):
        wave = np.exp(-1j * sense * rate_rad * np.arange(len(record.z)))
        turned = np.concatenate(([0.0], np.cumsum(record.z * wave)))
        ramp = np.sum(np.exp(-1j * sense * rate_rad * inside) * (inside - inside.mean())) * wave[ends - n]
        powers.append(np.abs((turned[ends] - turned[ends - n] - slope * ramp) / n) ** 2)
    found[ends - 1] = np.maximum(*powers)
    return found


def judged(passing: Passing) -> RoomOutcome:
    """Apply every detector to a passage."""
    record = simulate(passing)
    rising = {}
    for name, trace in statistics(record).items():
        known = np.where(np.isnan(trace), -np.inf, trace)
        largest = np.maximum.accumulate(known)
        new = np.flatnonzero(largest > np.concatenate(([-np.inf], largest[:-1])))
        rising[name] = np.vstack((largest[new], record.gap_m[new]))
    rising[AS_IT_IS] = rising[OURS]
    return RoomOutcome(passing, rising)


def largest(outcome: RoomOutcome, name: str) -> float:
    """Of a passage's statistics."""
    return float(outcome.rising[name][0, -1]) if outcome.rising[name].size else -math.inf


def seen_m(outcome: RoomOutcome, name: str, threshold: float) -> float:
    """Distance at which the object was first seen, 0 where it was not."""
    values, gaps_m = outcome.rising[name]
    first = int(np.searchsorted(values, threshold, side="right"))
    return float(gaps_m[first]) if first < len(values) else 0.0


class RoomRow(NamedTuple):
    """A detector in a room.

    Attributes:
        quiet: Passages without an object and without an event.
        seen: By strength, approaches in which the object was seen from `NEEDED_M` or farther.
        reach_m: By strength, the distance from which 95 % were seen.
    """

    quiet: Rate
    seen: dict[float, Rate]
    reach_m: dict[float, float]


class RoomsSize(NamedTuple):
    """Passages: those that set thresholds, and in each room those before nothing and to objects (half as many where
    the echo is weaker)."""

    training: int
    quiet: int
    objects: int


FULL, QUICK = RoomsSize(600, 80, 80), RoomsSize(60, 10, 10)


def work_of(size: RoomsSize) -> list[Passing]:
    """All passages."""
    work = passings(SEED_TRAINING, TRAINING, size.training, 0)
    for room in ROOMS:
        if room != TRAINING:
            work += passings(SEED_JUDGED, room, size.quiet, 0)
            for weaker_db in STRENGTHS_DB:
                objects = size.objects // 2 if weaker_db else size.objects
                work += passings(SEED_JUDGED + round(weaker_db) + 1, room, 0, objects, weaker_db)
    return work


def thresholds_of(outcomes: Sequence[RoomOutcome]) -> dict[str, float]:
    """By detector, exceeded in 1 % of the passages that set them."""
    training = [one for one in outcomes if one.passing.room == TRAINING]
    found = {
        name: float(np.quantile([largest(one, name) for one in training], TNR, method="higher"))
        for name in training[0].rising
        if name != AS_IT_IS
    }
    return found | {AS_IT_IS: PreTouchSettings().threshold}


def rows_of(
    outcomes: Sequence[RoomOutcome], thresholds: Mapping[str, float]
) -> dict[str, dict[str, RoomRow]]:
    """By room and detector."""
    found: dict[str, dict[str, RoomRow]] = {}
    for room in ROOMS:
        inside = [one for one in outcomes if one.passing.room == room]
        if room == TRAINING:
            continue
        found[room] = {}
        for name, threshold in thresholds.items():
            quiet = rate(largest(one, name) <= threshold for one in inside if not one.passing.object)
            seen, reach_m = {}, {}
            for weaker_db in STRENGTHS_DB:
                gaps_m = [
                    seen_m(one, name, threshold)
                    for one in inside
                    if one.passing.object and one.passing.weaker_db == weaker_db
                ]
                seen[weaker_db] = rate(gap_m >= NEEDED_M for gap_m in gaps_m)
                reach_m[weaker_db] = float(np.quantile(gaps_m, 0.05))
            found[room][name] = RoomRow(quiet, seen, reach_m)
    return found


def main(quick: bool = False) -> None:
    """Run the study; writes results/pretouch_rooms.json."""
    started_s, size = time.perf_counter(), QUICK if quick else FULL
    with workers() as pool:
        outcomes = list(pool.map(judged, work_of(size), chunksize=50))
    thresholds = thresholds_of(outcomes)
    rows = rows_of(outcomes, thresholds)
    save("pretouch_rooms", numbers(thresholds, rows, time.perf_counter() - started_s), quick=quick)


def numbers(
    thresholds: Mapping[str, float], rows: Mapping[str, Mapping[str, RoomRow]], took_s: float
) -> dict[str, Any]:
    """For the JSON."""
    return {
        "thresholds": dict(thresholds),
        "rooms": {
            room: {
                name: {
                    "tnr": row.quiet.share,
                    "tnr_95": row.quiet.interval,
                    "seen": {f"{db:g} dB": row.seen[db].share for db in STRENGTHS_DB},
                    "seen_95": {f"{db:g} dB": row.seen[db].interval for db in STRENGTHS_DB},
                    "reach_m": {f"{db:g} dB": row.reach_m[db] for db in STRENGTHS_DB},
                }
                for name, row in by_name.items()
            }
            for room, by_name in rows.items()
        },
        "wall_s": took_s,
    }


if __name__ == "__main__":
    main()
