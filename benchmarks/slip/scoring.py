"""Equal false alarms first, then delays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.events import BaselineRefused, Detected, SlipEnded, SlipStarted
from benchmarks.slip.rivals import OURS
from benchmarks.slip.scenes import ARMED_S, SETTLE_S
from controller.detectors.calibration import (
    Calibration,
    Statistic,
    poisson_interval,
    span_maxima,
    threshold_for,
)
from controller.detectors.slip import SlipDetector, SlipSettings
from controller.reports.counts import wilson
from drivers.messages import SampleBlock

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

MISSED_S = 0.75
RESAMPLED, EDGES = 1000, (0.025, 0.975)

THRESHOLDS = (11.0, 25.0)
"""For ours, beside those of equal false alarms: a little more than that of the recordings, and the default."""

HOLD_S = SlipSettings().hold_s
"""Slip is over for a rival, too, where its number has stayed below the threshold for so long."""


RESETS_FROM_S = 2.5
"""Where in a recording the detector is first reset; from there every `SETTLE_S`. The arm turns round every ten
seconds: never where the pieces meet, in every other one of them."""


def first_maxima(detector: Statistic, values: Floats, rate_hz: float) -> Floats:
    """A detector that is reset repeatedly within a recording: the largest value of its statistic in each
    second from `ARMED_S` to `SETTLE_S`, shape (resets, seconds)."""
    armed, size = round(ARMED_S * rate_hz), round(SETTLE_S * rate_hz)
    begins = range(round(RESETS_FROM_S * rate_hz), len(values) - size + 1, size)
    return np.array(
        [
            span_maxima(detector.statistic(values[begin : begin + size], rate_hz)[armed:], rate_hz)
            for begin in begins
        ]
    )


@dataclass(frozen=True)
class Fresh:
    """A detector in its first seconds after a reset.

    Attributes:
        resets: Number of resets.
        alarms: In each second from `ARMED_S` to `SETTLE_S`, at the threshold of a settled detector.
        calibration: The threshold that keeps the false-alarm interval in these seconds.
    """

    resets: int
    alarms: tuple[int, ...]
    calibration: Calibration


def fresh(maxima: Floats, threshold: float, false_alarm_interval_s: float) -> Fresh:
    """From what `first_maxima` found."""
    alarms = tuple(int(count) for count in np.sum(maxima > threshold, axis=0))
    return Fresh(len(maxima), alarms, threshold_for(maxima.ravel(), false_alarm_interval_s))


def per_reset(counted: Fresh) -> tuple[float, float, float]:
    """False alarms of a reset, from when a detector decides until it has settled, and their 95 % interval (Poisson)."""
    alarms, resets = sum(counted.alarms), counted.resets
    low, high = poisson_interval(alarms)
    return alarms / resets, low / resets, high / resets


def quantile(delays: Floats, share: float) -> float:
    """Of delays; infinite where so many are missed."""
    return float(np.sort(delays)[max(1, math.ceil(share * len(delays))) - 1]) if len(delays) else math.nan


def _picks(count: int) -> NDArray[np.int64]:
    """The same in each call for as many."""
    return np.random.default_rng(1).integers(0, count, (RESAMPLED, count))


def resampled(delays: Floats, share: float) -> Floats:
    """A quantile of delays resampled, the same slips in each call of as many, shape (RESAMPLED,)."""
    place = max(1, math.ceil(share * len(delays))) - 1
    found: Floats = np.partition(np.minimum(delays, MISSED_S)[_picks(len(delays))], place, axis=1)[:, place]
    return found


def mean_95(shares: Floats) -> list[float]:
    """The 95 % interval of the mean of pieces resampled."""
    found: list[float] = np.quantile(shares[_picks(len(shares))].mean(axis=1), EDGES).tolist()
    return found


def first_above(statistic: Floats, threshold: float) -> float:
    """Samples to the first value above; infinite without."""
    above = np.flatnonzero(np.nan_to_num(statistic, nan=-math.inf) > threshold)
    return float(above[0]) if above.size else math.inf


def _pushed(values: Floats, rate_hz: float, **settings: float) -> Sequence[Detected]:
    """Our detector's events on a stretch."""
    detector = SlipDetector(OURS, SlipSettings.model_validate(settings))
    return detector.push(SampleBlock("board.tangential", 0, 0.0, values[:, None], rate_hz=rate_hz))


def refusals(quiet: Sequence[Floats], slipping: Sequence[Floats], rate_hz: float) -> dict[str, Any]:
    """Ours, with the level of each quiet stored, on a slip that runs while it begins: how often it refuses the baseline
    or detects the slip, and how often it reports anything."""
    detected = something = 0
    for calm, each in zip(quiet, slipping, strict=True):
        events = _pushed(each, rate_hz, quiet_rms=_pushed(calm, rate_hz)[0].value)
        detected += any(isinstance(event, BaselineRefused | SlipStarted) for event in events)
        something += bool(events)
    row = {
        "stored": True,
        "slips": len(quiet),
        "detected": detected,
        "detected_95": wilson(detected, len(quiet)),
    }
    return {**row, "something_reported": something}


def called(name: str, values: Floats, statistic: Floats, rate_hz: float, threshold: float) -> Bools:
    """Where a detector reports slip, shape (n,): ours by its events, a rival from a number above the threshold until
    none has been for `HOLD_S`.

    A number at the end of a block stands until the next. A CUSUM is capped just above its threshold, so that old
    evidence does not delay the end.
    """
    if name == OURS:
        marks = np.zeros(len(values) + 1)
        for event in _pushed(values, rate_hz, threshold=threshold):
            if isinstance(event, SlipStarted | SlipEnded):
                marks[round(event.t_s * rate_hz)] += 1.0 if isinstance(event, SlipStarted) else -1.0
        ours: Bools = np.cumsum(marks)[:-1] > 0.0
        return ours
    places = np.arange(len(statistic))
    known = np.maximum.accumulate(np.where(np.isnan(statistic), 0, places))
    held = np.nan_to_num(statistic[known])
    if name.endswith("CUSUM"):
        held = _held(held, 1.01 * threshold)
    last = np.maximum.accumulate(np.where(held > threshold, places, -len(places)))
    found: Bools = places - last <= HOLD_S * rate_hz
    return found


def _held(total: Floats, ceiling: float) -> Floats:
    """A sum that is kept from falling below zero, kept from rising above a ceiling as well."""
    found, value = np.empty_like(total), 0.0
    for place, step in enumerate(np.diff(total, prepend=0.0).tolist()):
        value = 0.0 if total[place] <= 0.0 else min(ceiling, max(0.0, value + step))
        found[place] = value
    return found
