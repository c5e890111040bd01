"""Equal false alarms first, then delays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.slip.scenes import ARMED_S, SETTLE_S
from controller.detectors.calibration import (
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


def per_reset(counted: Fresh) -> tuple[float, float, float]:
    """False alarms of a reset, from when a detector decides until it has settled, and their 95 % interval (Poisson)."""
    alarms, resets = sum(counted.alarms), counted.resets
    low, high = poisson_interval(alarms)
    return alarms / resets, low / resets, high / resets
