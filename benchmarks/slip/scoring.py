"""Equal false alarms first, then delays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.slip.scenes import SETTLE_S, Slip
from controller.detectors.calibration import SPAN_S, Calibration, Statistic, span_maxima, threshold_for

Floats = NDArray[np.float64]


@dataclass
class Quiet:
    """Maxima of a detector's statistic on recordings without slip, one list per half of them."""

    maxima: tuple[list[Floats], list[Floats]]

    @classmethod
    def empty(cls) -> Quiet:
        """Nothing heard yet."""
        return cls(([], []))

    def hear(self, statistic: Floats, rate_hz: float, number: int) -> None:
        """One recording; even ones set the threshold, odd ones check it."""
        self.maxima[number % 2].append(span_maxima(statistic[round(SETTLE_S * rate_hz) :], rate_hz))

    def threshold(self, false_alarm_interval_s: float) -> Calibration:
        """From the first half."""
        return threshold_for(np.concatenate(self.maxima[0]), false_alarm_interval_s)

    def check(self, threshold: float) -> tuple[int, float]:
        """False alarms in the second half, and its length in hours."""
        spans = np.concatenate(self.maxima[1])
        return int(np.sum(spans > threshold)), spans.size * SPAN_S / 3600.0


@dataclass(frozen=True)
class Score:
    """How a detector did on slips.

    Attributes:
        delays_s: From the first motion of the contact to the sample that decided, infinite where missed, shape
        (trials,). early: Trials in which it was above the threshold between the arm's start and the slip; not among
        the delays.
    """

    delays_s: Floats
    early: int

    def quantile_s(self, share: float) -> float:
        """A quantile of the delay; infinite where so many are missed."""
        if not self.delays_s.size:
            return math.nan
        rank = math.ceil(share * self.delays_s.size)
        return float(np.sort(self.delays_s)[max(1, rank) - 1])

    @property
    def missed(self) -> float:
        """Share of slips missed."""
        return float(np.mean(np.isinf(self.delays_s))) if self.delays_s.size else math.nan


def score(
    detector: Statistic, trials: Iterable[Slip], rate_hz: float, threshold: float, missed_after_s: float
) -> Score:
    """Delays of a detector at a threshold."""
    delays, early = [], 0
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
    return Score(np.array(delays), early)


def pooled(scores: Sequence[Score]) -> Score:
    """Several populations as one."""
    return Score(np.concatenate([each.delays_s for each in scores]), sum(each.early for each in scores))
