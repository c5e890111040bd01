"""The comparison itself: thresholds from some passages, rates from others, one process for each core."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Contact, Detected, PreTouch
from benchmarks.pretouch.scenes import (
    POSITIVE,
    RATE_HZ,
    Event,
    PassageRecord,
    events,
    passage,
    passage_by_carrier,
    template,
)
from benchmarks.pretouch.scoring import LATE_S, ScoredTouch, alarmed, seen_at, threshold_at, touch
from controller.detectors.level import LevelDetector, LevelPaperDetector, LevelPaperSettings, LevelSettings
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings
from drivers.messages import SampleBlock

Floats = NDArray[np.float64]
T = TypeVar("T")
R = TypeVar("R")

PRETOUCH_TNR, CONTACT_TNR = 0.953, 0.987
"""At which all detectors are compared (Rupavatharam et al., IV.B)."""

PAPER_TPR = 0.924
"""Of the paper's pre-touch (IV.B.1)."""

SEED_CALIBRATION, SEED_TEST, SEED_MATCH = 21_000, 22_000, 23_000
"""Keys of passages: no noise is used twice, nor in developing the detectors."""

BOTH = "pretouch.paper on I and Q"
CLAIRVOYANT = "clairvoyant"
STATISTICS = (BOTH, CLAIRVOYANT)
"""Not detectors that anyone can use: compared with their thresholds here."""

AS_IT_IS = ", own threshold"
"""Ours with default settings, not calibrated."""

IN_MOTION = ", in motion"
SET_OUT_S = 0.3
"""The paper's z-score once more, of the approach alone, begun only this long after the arm's start: in a window that
begins at rest the noise of the start is the largest z. The paper gives no procedure for that."""

EMPTY = PreTouchSettings(background_fs=0.0, obliquity=(1.0,))
"""Ours, as set for a room without echoes and a straight path to the object."""

ONE_IN = 4
"""One in so many passages is given to the clairvoyant, which costs as much as the rest."""


class Judge(Protocol):
    """A detector of this study."""

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process a block."""

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """The number compared with the threshold."""


def pretouch_judges(thresholds: Mapping[str, float]) -> dict[str, Judge]:
    """Fresh detectors of pre-touch by name; thresholds that are not given stay as they are."""
    made: dict[str, Judge] = {}
    for window_s in (0.25, 0.5, 1.0):
        name = f"pretouch.paper, {window_s:g} s"
        made[name] = PreTouchPaperDetector(
            name, PreTouchPaperSettings(window_s=window_s, **_at(thresholds, name))
        )
    name = "pretouch.paper, 0.5 s, DC kept"
    made[name] = PreTouchPaperDetector(name, PreTouchPaperSettings(remove_dc=False, **_at(thresholds, name)))
    made["pretouch"] = PreTouchDetector("pretouch", EMPTY.model_copy(update=_at(thresholds, "pretouch")))
    made[f"pretouch{AS_IT_IS}"] = PreTouchDetector("pretouch", EMPTY)
    return made


def contact_judges(thresholds: Mapping[str, float]) -> dict[str, Judge]:
    """Fresh detectors of contact by name."""
    made: dict[str, Judge] = {}
    for window_s in (0.5, 1.0, 2.0, 5.0):
        name = f"level.paper, {window_s:g} s"
        made[name] = LevelPaperDetector(name, LevelPaperSettings(window_s=window_s, **_at(thresholds, name)))
    for window_s in (0.5, 1.0):
        name = f"level.paper, {window_s:g} s{IN_MOTION}"
        made[name] = LevelPaperDetector(name, LevelPaperSettings(window_s=window_s, **_at(thresholds, name)))
    made["level"] = LevelDetector("level", LevelSettings(**_at(thresholds, "level")))
    made[f"level{AS_IT_IS}"] = LevelDetector("level", LevelSettings())
    return made


def _at(thresholds: Mapping[str, float], name: str) -> dict[str, Any]:
    return {"threshold": thresholds[name]} if name in thresholds else {}


# --- thresholds ----------------------------------------------------------------------------------


def loudest(event: Event) -> dict[str, float]:
    """Largest statistic of each detector in a passage without an event: for pre-touch one without an object, for
    contact one without a touch."""
    record = passage(event)
    values = np.column_stack([record.z.real, record.z.imag, record.position_m])
    found: dict[str, float] = {}
    if event.kind not in POSITIVE:
        for name, judge in pretouch_judges({}).items():
            if not name.endswith(AS_IT_IS):
                found[name] = _largest(judge.statistic(values, RATE_HZ))
        found[BOTH] = _largest(both(values))
        if event.number % ONE_IN == 0:
            found[CLAIRVOYANT] = _largest(clairvoyant(record))
    if event.kind != "touch":
        for name, judge in contact_judges({}).items():
            if not name.endswith(AS_IT_IS):
                found[name] = _largest(judge.statistic(values[_part(record, name), :2], RATE_HZ))
    return found


def _part(record: PassageRecord, name: str) -> slice:
    """The samples of a passage that a contact detector receives."""
    if not name.endswith(IN_MOTION):
        return slice(0, len(record.z))
    return slice(record.begun + round(SET_OUT_S * RATE_HZ), record.arrived + round(LATE_S * RATE_HZ))


def _largest(statistic: Floats) -> float:
    known = statistic[~np.isnan(statistic)]
    return float(known.max()) if known.size else -math.inf


def both(values: Floats) -> Floats:
    """The paper's statistic, windows of 0.5 s, summed over I and Q."""
    judge = PreTouchPaperDetector("both", PreTouchPaperSettings())
    return judge.statistic(values[:, :1], RATE_HZ) + judge.statistic(values[:, 1:2], RATE_HZ)


def clairvoyant(record: PassageRecord) -> Floats:
    """The matched filter that knows the plant: echo, imbalance, drift and noise levels of this very passage.

    After each sample since the approach began, the optimum in white noise: the signal, projected on what the object
    would add, in standard deviations. Shape (n,).
    """
    echo, bare, sigma_fs = template(record.event)
    weights = 1.0 / sigma_fs**2
    weights[: record.begun] = 0.0
    projected = np.cumsum(weights * (np.conj(echo) * (record.z - bare)).real)
    energy = np.cumsum(weights * np.abs(echo) ** 2)
    found: Floats = np.full(len(echo), np.nan)
    np.divide(projected, np.sqrt(energy), out=found, where=energy > 0.0)
    return found


def thresholds_of(calibration: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """By detector, at the paper's true-negative rates."""
    maxima: dict[str, list[float]] = {}
    for found in calibration:
        for name, value in found.items():
            maxima.setdefault(name, []).append(value)
    return {
        name: max(threshold_at(values, CONTACT_TNR if name.startswith("level") else PRETOUCH_TNR), 1e-300)
        for name, values in maxima.items()
    }


# --- rates ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """Results of all detectors on one passage.

    Attributes:
        event: Of which.
        seen_m: Of an approach: distance at which pre-touch was detected, NaN where it was not, by detector.
        near: Of a passage without an object: whether pre-touch was reported, by detector.
        touch: Of a touch: its score, by detector.
        touched: Of a passage without touch: whether contact was reported, by detector.
    """

    event: Event
    seen_m: dict[str, float]
    near: dict[str, bool]
    touch: dict[str, ScoredTouch]
    touched: dict[str, bool]


def judge(event: Event, thresholds: Mapping[str, float], carrier: bool = False) -> Verdict:
    """Apply all detectors to one passage."""
    record = passage_by_carrier(event) if carrier else passage(event)
    found = Verdict(event, {}, {}, {}, {})
    for name, detector in pretouch_judges(thresholds).items():
        reported = [*detector.push(record.encoder), *detector.push(record.block)]
        if event.kind in POSITIVE:
            until = record.arrived if record.touched is None else min(record.touched, record.arrived)
            t_s = seen_at(reported, float(record.times_s[record.begun]), float(record.times_s[until]))
            found.seen_m[name] = (
                float(np.interp(t_s, record.times_s, record.gap_m)) if math.isfinite(t_s) else math.nan
            )
        else:
            found.near[name] = alarmed(reported, PreTouch)
    if not carrier:
        _judge_statistics(record, thresholds, found)
    for name, detector in contact_judges(thresholds).items():
        part, block = _part(record, name), record.block
        t0_s = float(record.times_s[part.start])
        reported = list(detector.push(replace(block, seq=part.start, t0_s=t0_s, values=block.values[part])))
        if record.touched is not None and record.released is not None:
            touched_s, released_s = record.times_s[record.touched], record.times_s[record.released]
            found.touch[name] = touch(reported, float(touched_s), float(released_s))
        else:
            found.touched[name] = alarmed(reported, Contact)
    return found


def _judge_statistics(record: PassageRecord, thresholds: Mapping[str, float], found: Verdict) -> None:
    values = np.column_stack([record.z.real, record.z.imag])
    traces = {BOTH: both(values)}
    if record.event.number % ONE_IN == 0:
        traces[CLAIRVOYANT] = clairvoyant(record)
    for name, trace in traces.items():
        if name not in thresholds:
            continue
        above = np.flatnonzero(trace > thresholds[name])
        if record.event.kind in POSITIVE:
            until = record.arrived if record.touched is None else min(record.touched, record.arrived)
            inside = above[(above >= record.begun) & (above <= until)]
            found.seen_m[name] = float(record.gap_m[inside[0]]) if len(inside) else math.nan
        else:
            found.near[name] = bool(len(above))


# --- all of it -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class PretouchSize:
    """How many passages.

    Attributes:
        touches: For each object, side and speed.
        nears: Likewise.
        others: Of each other kind, for each side and speed.
        plain: The same three at the plant's default echo.
        soft: Touches, and as many nears, of each soft object, side and speed.
        calibration: Nears and others that set the thresholds.
        match: Nears that find the strength of the echo.
        afar: Approaches from afar of each object at each speed.
        carrier: One of so many is simulated at carrier level too.
    """

    touches: int
    nears: int
    others: int
    plain: tuple[int, int, int]
    soft: int
    calibration: tuple[int, int]
    match: int
    afar: int
    carrier: int


FULL = PretouchSize(62, 38, 80, (8, 4, 12), 5, (12, 60), 6, 8, 100)
QUICK = PretouchSize(2, 2, 6, (1, 1, 3), 1, (1, 16), 1, 1, 100)


def run_all(worker: Callable[[T], R], work: Sequence[T], pool: ProcessPoolExecutor | None) -> list[R]:
    """In order, on all cores if there is a pool."""
    if pool is None:
        return [worker(item) for item in work]
    return list(pool.map(worker, work, chunksize=max(1, min(32, len(work) // 8))))


def calibrate(weaker_db: float, size: PretouchSize, pool: ProcessPoolExecutor | None) -> dict[str, float]:
    """Thresholds at an echo's strength, from passages of their own."""
    nears, others = size.calibration
    work = list(events(SEED_CALIBRATION, 0, nears, others, weaker_db=weaker_db))
    return thresholds_of(run_all(loudest, work, pool))


MATCHED = "pretouch.paper, 0.5 s"
"""The paper's variant to whose printed rate the echo is matched."""


def matched_db(
    thresholds: Mapping[str, float], size: PretouchSize, pool: ProcessPoolExecutor | None
) -> tuple[int, dict[int, float]]:
    """By how many dB the echo must be weaker for the paper's own detector to have the paper's own rate.

    Found by halving between 0 and 40 dB, on passages of its own, by the paper's detector alone.

    Returns:
        Whole decibels, and the rates found in the search.
    """
    rates: dict[int, float] = {}

    def rate_at(weaker_db: int) -> float:
        if weaker_db not in rates:
            work = list(events(SEED_MATCH, 0, size.match, 0, weaker_db=float(weaker_db)))
            seen = run_all(partial(_paper_sees, threshold=thresholds[MATCHED]), work, pool)
            rates[weaker_db] = float(np.mean(seen))
        return rates[weaker_db]

    low, high = 0, 40
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if rate_at(middle) >= PAPER_TPR else (low, middle)
    best = min((low, high), key=lambda db: abs(rate_at(db) - PAPER_TPR))
    return best, dict(sorted(rates.items()))


def _paper_sees(event: Event, threshold: float) -> bool:
    record = passage(event)
    detector = PreTouchPaperDetector("paper", PreTouchPaperSettings(threshold=threshold))
    until_s = float(record.times_s[record.arrived])
    return not math.isnan(seen_at(detector.push(record.block), float(record.times_s[record.begun]), until_s))


def judged(
    work: Sequence[Event],
    thresholds: Mapping[str, float],
    pool: ProcessPoolExecutor | None,
    carrier: bool = False,
) -> list[Verdict]:
    """Verdicts on many passages."""
    return run_all(partial(judge, thresholds=dict(thresholds), carrier=carrier), work, pool)
