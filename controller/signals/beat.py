"""The beat of a drive and a converter on separate clocks: how fast the residual of the drive turns."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

SEGMENT_S: Final = 1.0
"""Interval between phase estimates. Assumption: 40 us of two crystals 20 ppm apart are 0.8 of a turn."""

MEMORY_S: Final = 60.0
"""The weight of an estimate falls to 1/e in this time. Assumption: crystals warm up in minutes."""

QUIETEST_RAD: Final = 1e-5
"""Least phase noise of an estimate: 24-bit quantization of a tone at a hundredth of full scale."""


class Beat:
    """Estimates the beat of I + jQ, once a second, and removes it.

    A line is fitted to the phase of each second, and the slopes are averaged with the inverse of the residual variance:
    quiet seconds count for thousands of others, a contact's step for nothing. Only a steady turn about the origin is
    removed: slow drifts, undulations and steps stay, whatever their frequency.

    Attributes:
        turn_rad: The beat, radians a sample; NaN until the first second is over.
    """

    def __init__(self, rate_hz: float) -> None:
        self._size = max(8, round(SEGMENT_S * rate_hz))
        self._keep = math.exp(-self._size / (rate_hz * MEMORY_S))
        self._rate_hz = rate_hz
        place = np.arange(self._size) - 0.5 * (self._size - 1)
        self._line = place / np.sum(place**2)
        self._place = place
        self.turn_rad = math.nan
        self._weight = self._sum = 0.0
        self._begun = np.empty(0, np.complex128)
        self._next: int | None = None
        self._angle_rad = 0.0

    @property
    def hz(self) -> float:
        """The beat; positive where the drive is faster than the converter believes."""
        return self.turn_rad / (2.0 * math.pi) * self._rate_hz

    def push(self, z: Complexes, number: int) -> Complexes:
        """Process the next samples, the first of them the stream's `number`-th.

        Returns:
            The last of them, those after the first second, turned back.
        """
        if self._next is not None and number != self._next:
            passed = len(self._begun) + number - self._next
            self._begun = self._begun[:0]
            if not math.isnan(self.turn_rad):
                self._angle_rad = (self._angle_rad + self.turn_rad * passed) % (2.0 * math.pi)
        self._next = number + len(z)
        still = []
        while len(z):
            taken = z[: self._size - len(self._begun)]
            z = z[len(taken) :]
            if not math.isnan(self.turn_rad):
                # from the segment's beginning, so that blocks change nothing
                angles = self._angle_rad + self.turn_rad * np.arange(
                    len(self._begun), len(self._begun) + len(taken)
                )
                still.append(taken * np.exp(-1j * angles))
            self._begun = np.concatenate((self._begun, taken))
            if len(self._begun) == self._size:
                self._look(self._begun)
                self._begun = self._begun[:0]
        return np.concatenate(still) if still else np.empty(0, np.complex128)

    def _look(self, z: Complexes) -> None:
        if not math.isnan(self.turn_rad):
            self._angle_rad = (self._angle_rad + self.turn_rad * len(z)) % (2.0 * math.pi)
        phases = np.unwrap(np.angle(z))
        slope = float(self._line @ phases)
        rest = phases - np.mean(phases) - slope * self._place
        weight = 1.0 / (float(np.mean(rest**2)) + QUIETEST_RAD**2)
        self._weight = self._keep * self._weight + weight
        self._sum = self._keep * self._sum + weight * slope
        self.turn_rad = self._sum / self._weight
