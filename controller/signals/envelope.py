"""Amplitude and phase of an oscillation, period by period, from its waveform."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Envelope:
    """Mixes with one frequency and averages over its period: a constant and the harmonics vanish.

    The same to the bit however the samples are cut.

    Args:
        free_hz: The frequency.
        hops: Values wanted in a period; rounded so that a hop is whole samples.

    Attributes:
        free_hz: The frequency.
        hop_s: From one value to the next.
    """

    def __init__(self, free_hz: float, rate_hz: float, hops: int) -> None:
        self.free_hz = free_hz
        self._hop = max(1, round(rate_hz / free_hz / hops))
        self.hop_s = self._hop / rate_hz
        self._turn = free_hz / rate_hz
        period = rate_hz / free_hz
        whole = math.floor(period)
        self._window = np.full(whole + 1, 1.0 / period)
        self._window[0] = (period - whole) / period  # of the oldest sample, the part that is within a period
        self.restart()

    def restart(self) -> None:
        """Restart: the next value comes a period later."""
        self._mixed = np.empty(0, dtype=np.complex128)
        self._times = np.empty(0)
        self._count = 0
        self._last = complex(math.nan, math.nan)
        self._phase = 0.0

    def push(self, times_s: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Process the next samples.

        Args:
            times_s: Shape (n,).
            x: Shape (n,), finite.

        Returns:
            Times, logarithms of the amplitude and phases (rad, continuous) of the new values, shape (m,) each.
        """
        count = self._count + np.arange(len(x))
        self._count += len(x)
        mixed = x * np.exp(-2j * math.pi * np.mod(self._turn * count, 1.0))
        mixed, times_s = np.concatenate([self._mixed, mixed]), np.concatenate([self._times, times_s])
        size, first = len(self._window), self._count - len(mixed)
        ends = np.arange(size - 1, len(mixed))
        ends = ends[(first + ends) % self._hop == 0]
        ends = ends[ends >= len(mixed) - len(x)]
        self._mixed, self._times = mixed[-(size - 1) :], times_s[-(size - 1) :]
        if not len(ends):
            return np.empty(0), np.empty(0), np.empty(0)
        windows = mixed[ends[:, None] + np.arange(1 - size, 1)]
        values = (windows * self._window).sum(axis=1)
        before = np.concatenate([[self._last], values[:-1]])
        turned = np.angle(values * np.conj(before))
        if math.isnan(self._last.real):
            turned[0] = 0.0
        # one addition after the other: however the samples are cut
        phases = np.cumsum(np.concatenate([[self._phase], turned]))[1:]
        self._last, self._phase = complex(values[-1]), float(phases[-1])
        return times_s[ends], np.log(np.abs(values) + 1e-12), phases
