"""The phase of a tone that was sampled on its own clock: a ratio of whole numbers, exact at every frame for ever."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

STEPS_PER_HZ: Final = 1000
"""Frequencies are whole millihertz, as the drive's are."""

TABLE_MAX: Final = 96_000
"""Longest period that is kept as a table, frames: any whole number of hertz at 96 kHz; 1.5 MB."""

TWELFTHS: Final = 826_806
"""Amplitude of the whole-number wave where the period divides 12: its half is whole, and its half times the square root
of 3 is 716,035 less 7e-7 (413,403 / 716,035 is a convergent of 1 / sqrt 3), so that rounding leaves 1e-12."""


class Oscillator:
    """cos and sin of 2 pi f n / rate at frame n, zero phase at frame 0.

    Args:
        frequency_hz: Rounded to whole millihertz.
        rate_hz: Frames a second, a whole number.

    Attributes:
        step: Of the phase from frame to frame, in steps.
        whole: Steps of a cycle; also frames after which any such tone is where it began.
        period: Frames after which this one is.

    Raises:
        ValueError: the frequency is not between 0 and half the rate, or the rate is no whole number.

    Example:
        >>> Oscillator(40_000.0, 96_000.0).period
        12
    """

    def __init__(self, frequency_hz: float, rate_hz: float) -> None:
        if not rate_hz > 0.0 or rate_hz != round(rate_hz):
            raise ValueError(f"{rate_hz:g} frames a second are no whole number")
        if not 0.0 < frequency_hz < 0.5 * rate_hz:
            raise ValueError(f"{frequency_hz:g} Hz are not between 0 and half of {rate_hz:g} frames a second")
        self.step = round(frequency_hz * STEPS_PER_HZ)
        self.whole = round(rate_hz) * STEPS_PER_HZ
        self.period = self.whole // math.gcd(self.step, self.whole)

    def steps(self, frames: Ints) -> Ints:
        """Phase at each frame, steps of 1/`whole` of a cycle, shape (n,)."""
        # both factors are below 2^30 at any rate up to 1 MHz
        return np.asarray(self.step * (frames % self.whole) % self.whole)

    def wave(self, frames: Ints) -> NDArray[np.complex128]:
        """cos + j sin at each frame, shape (n,)."""
        return np.asarray(np.exp(2j * np.pi / self.whole * self.steps(frames)))

    def table(self, amplitude: int) -> Ints:
        """One period of cos and of minus sin in whole numbers, shape (2, period); the period is at most `TABLE_MAX`."""
        return whole_numbers(self.wave(np.arange(self.period, dtype=np.int64)), amplitude)

    def coarse_and_fine(self, amplitude: int) -> tuple[Ints, Ints]:
        """Two tables whose product is the wave at any phase: of `amplitude`, and of 2^30.

        The phase in steps is `a` times the length of the second, plus `b`: indices into the tables.

        Returns:
            cos and minus sin at the coarse phases, shape (2, A), and at the fine ones, shape (2, B); A B = `whole`.
        """
        fine = max(k for k in range(1, math.isqrt(self.whole) + 1) if self.whole % k == 0)
        angle = 2j * np.pi / self.whole
        coarse_wave = np.exp(angle * fine * np.arange(self.whole // fine))
        return whole_numbers(coarse_wave, amplitude), whole_numbers(np.exp(angle * np.arange(fine)), 1 << 30)


def whole_numbers(wave: NDArray[np.complex128], amplitude: int) -> Ints:
    """cos and minus sin, times an amplitude, rounded, shape (2, n)."""
    return np.rint(amplitude * np.stack([wave.real, -wave.imag])).astype(np.int64)
