"""Cycles of an oscillation: from a waveform to the time and length of each period."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


class CycleCounter:
    """Rising zero crossings of a sampled waveform, with hysteresis, to a fraction of a sample.

    Does in software what comparator and period counter do in hardware, for recordings that hold the waveform alone.
    A crossing counts when the signal has been below `-hysteresis` since the last one; its instant is interpolated
    linearly between the two samples around zero. The mean is not removed: high-pass the waveform first where
    it has one.

    Args:
        hysteresis: Half-width of the dead band, in the waveform's unit.
    """

    def __init__(self, hysteresis: float) -> None:
        self._hysteresis = hysteresis
        self.reset()

    def reset(self) -> None:
        """Forget the last crossing."""
        self._armed = False
        self._last_x = math.nan
        self._last_t_s = math.nan
        self._crossing_s = math.nan
        self._pending_s = math.nan

    def push(self, times_s: NDArray[np.float64], x: NDArray[np.float64]) -> tuple[list[float], list[float]]:
        """Process the next samples.

        Args:
            times_s: Shape (n,).
            x: Shape (n,). A sample that is not finite breaks the count: the next period begins after it.

        Returns:
            The instants at which periods ended and their lengths, both in seconds.
        """
        ends: list[float] = []
        periods: list[float] = []
        for t_s, value in zip(times_s.tolist(), x.tolist(), strict=True):
            if not math.isfinite(value):
                self.reset()
                continue
            if self._last_x < 0.0 <= value:
                step = (0.0 - self._last_x) / (value - self._last_x)
                self._pending_s = self._last_t_s + step * (t_s - self._last_t_s)
            if value < -self._hysteresis:
                self._armed = True
            elif value > self._hysteresis and self._armed:
                self._armed = False
                if math.isfinite(self._crossing_s):
                    ends.append(t_s)
                    periods.append(self._pending_s - self._crossing_s)
                self._crossing_s = self._pending_s
            self._last_x, self._last_t_s = value, t_s
        return ends, periods
