"""Equal false alarms first, then delays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.slip.scenes import ARMED_S, SETTLE_S, Slip
from controller.detectors.calibration import (
    SPAN_S,
    Calibration,
    Statistic,
    poisson_interval,
    span_maxima,
    threshold_for,
)

Floats = NDArray[np.float64]


RESETS_FROM_S = 2.5
"""Where in a recording the detector is first begun anew; from there every `SETTLE_S`. The arm turns round every ten
seconds: never where the pieces meet, in every other one of them."""


def first_maxima(detector: Statistic, values: Floats, rate_hz: float) -> Floats:
    """A detector that is begun anew again and again within a recording: the largest value of its statistic in each
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
    """A detector in its first seconds after a reset, when it knows little.

    Attributes:
        resets: How often it was begun anew.
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


def per_reset(counted: Mapping[str, Any]) -> tuple[float, float, float]:
    """False alarms of a reset, from when a detector decides until it has settled, and their 95 % interval (Poisson)."""
    alarms, resets = sum(counted["alarms"]), counted["resets"]
    low, high = poisson_interval(alarms)
    return alarms / resets, low / resets, high / resets


@dataclass
class Quiet:
    """Maxima of a detector's statistic on recordings without slip.

    Attributes:
        maxima: One list per half of the recordings, a detector that runs on.
        first: A detector that is begun anew within the second half.
    """

    maxima: tuple[list[Floats], list[Floats]]
    first: list[Floats]

    @classmethod
    def empty(cls) -> Quiet:
        """Nothing heard yet."""
        return cls(([], []), [])

    def hear(self, detector: Statistic, values: Floats, rate_hz: float, number: int) -> None:
        """One recording; even ones set the threshold, odd ones check it."""
        statistic = detector.statistic(values, rate_hz)
        self.maxima[number % 2].append(span_maxima(statistic[round(SETTLE_S * rate_hz) :], rate_hz))
        if number % 2:
            self.first.append(first_maxima(detector, values, rate_hz))

    def threshold(self, false_alarm_interval_s: float) -> Calibration:
        """From the first half."""
        return threshold_for(np.concatenate(self.maxima[0]), false_alarm_interval_s)

    def check(self, threshold: float) -> tuple[int, float]:
        """False alarms in the second half, and its length in hours."""
        spans = np.concatenate(self.maxima[1])
        return int(np.sum(spans > threshold)), spans.size * SPAN_S / 3600.0

    def fresh(self, threshold: float, false_alarm_interval_s: float) -> Fresh:
        """The first seconds after a reset, in the second half."""
        return fresh(np.concatenate(self.first), threshold, false_alarm_interval_s)


@dataclass(frozen=True)
class Score:
    """How a detector did on slips.

    Attributes:
        delays_s: From the first motion of the contact after the arm started to the sample that decided, infinite
        where missed, shape (trials,).
        moved_before: Which of these tips had moved before the arm started, too, shape (trials,).
        early: Trials in which it was above the threshold between the arm's start and the slip; not among the delays.
    """

    delays_s: Floats
    moved_before: NDArray[np.bool_]
    early: int

    @property
    def missed(self) -> float:
        """Share of slips missed."""
        return float(np.mean(np.isinf(self.delays_s))) if self.delays_s.size else math.nan

    @property
    def missed_moved_before(self) -> int:
        """Slips missed of tips that had moved before."""
        return int(np.sum(np.isinf(self.delays_s) & self.moved_before))


def score(
    detector: Statistic, trials: Iterable[Slip], rate_hz: float, threshold: float, missed_after_s: float
) -> Score:
    """Delays of a detector at a threshold."""
    delays, moved_before, early = [], [], 0
    for trial in trials:
        if trial.onset is None:
            continue
        above = np.nan_to_num(detector.statistic(trial.values, rate_hz), nan=-math.inf) > threshold
        if above[trial.start : trial.onset].any():
            early += 1
            continue
        found = np.flatnonzero(above[trial.onset :])
        delay_s = found[0] / rate_hz if found.size else math.inf
        delays.append(delay_s if delay_s <= missed_after_s else math.inf)
        moved_before.append(trial.moved_before)
    return Score(np.array(delays), np.array(moved_before, dtype=bool), early)


def pooled(scores: Sequence[Score]) -> Score:
    """Several populations as one."""
    return Score(
        np.concatenate([each.delays_s for each in scores]),
        np.concatenate([each.moved_before for each in scores]),
        sum(each.early for each in scores),
    )
