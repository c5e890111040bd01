"""The drive of the fingers' transducers, as a function of the converter's frame. Pure.

A tone is `level * cos(2 pi f n / rate)` at frame n: its phase is zero at frame 0, whenever it began, so that the
frame's number alone is the in-phase reference. Frequencies are whole millihertz: the phase is then a ratio of whole
numbers, exact at every frame for ever, with no memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.audio.settings import RATE_HZ

STEPS_PER_HZ: Final = 1000
"""Frequencies are kept in whole millihertz."""

WHOLE: Final = RATE_HZ * STEPS_PER_HZ
"""Frames after which every such tone is where it began; also the steps of a cycle. The product of two steps is below
2^53."""


class Wave(Protocol):
    """A drive."""

    @property
    def end(self) -> int | None:
        """The frame from which it is silent for good; None where it goes on."""

    def at(self, first: int, n: int) -> NDArray[np.float64]:
        """The drive at frames `first` to `first + n - 1`, full scale 1, shape (n,)."""


@dataclass(frozen=True)
class Silence:
    """No drive."""

    end: int | None = None

    def at(self, first: int, n: int) -> NDArray[np.float64]:
        """See `Wave.at`."""
        return np.zeros(n)


@dataclass(frozen=True)
class ToneWave:
    """One frequency.

    Attributes:
        frequency_hz: Rounded to whole millihertz.
        level: Amplitude, a share of full scale.
    """

    frequency_hz: float
    level: float
    end: int | None = None

    def at(self, first: int, n: int) -> NDArray[np.float64]:
        """See `Wave.at`."""
        step = round(self.frequency_hz * STEPS_PER_HZ)
        frames = np.arange(first % WHOLE, first % WHOLE + n, dtype=np.int64) % WHOLE
        return np.asarray(self.level * np.cos(step * frames % WHOLE * (2.0 * np.pi / WHOLE)))


@dataclass(frozen=True)
class ChirpWave:
    """A linear sweep that begins with phase zero, and silence before and after.

    Attributes:
        from_hz: Frequency at its beginning.
        to_hz: Frequency at its end.
        frames: Its length.
        level: Amplitude, a share of full scale.
        begin: Its first frame.
    """

    from_hz: float
    to_hz: float
    frames: int
    level: float
    begin: int

    @property
    def end(self) -> int | None:
        """See `Wave.end`."""
        return self.begin + self.frames

    def at(self, first: int, n: int) -> NDArray[np.float64]:
        """See `Wave.at`."""
        k = np.arange(first - self.begin, first - self.begin + n)
        t_s = k / RATE_HZ
        slope_hz_s = (self.to_hz - self.from_hz) * RATE_HZ / self.frames
        cycles = t_s * (self.from_hz + 0.5 * slope_hz_s * t_s)
        wave = self.level * np.cos(2.0 * np.pi * (cycles % 1.0))
        return np.where((k >= 0) & (k < self.frames), wave, 0.0)
