"""The drive of the fingers' transducers, as a function of the converter's frame. Pure.

A tone is `level * cos(2 pi f n / rate)` at frame n: its phase is zero at frame 0, whenever it began, so that the
frame's number alone is the in-phase reference. Frequencies are whole millihertz: the phase is then a ratio of whole
numbers, exact at every frame for ever, with no memory.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.audio.settings import RATE_HZ

STEPS_PER_HZ: Final = 1000
"""Frequencies are kept in whole millihertz."""

WHOLE: Final = RATE_HZ * STEPS_PER_HZ
"""Frames after which every such tone is where it began; also the steps of a cycle. The product of two steps is below
2^53."""


def tone(first: int, n: int, frequency_hz: float, level: float) -> NDArray[np.float64]:
    """One frequency, rounded to whole millihertz, at frames `first` to `first + n - 1`, full scale 1, shape (n,)."""
    step = round(frequency_hz * STEPS_PER_HZ)
    frames = np.arange(first % WHOLE, first % WHOLE + n, dtype=np.int64) % WHOLE
    return np.asarray(level * np.cos(step * frames % WHOLE * (2.0 * np.pi / WHOLE)))


def chirp(
    first: int, n: int, begin: int, from_hz: float, to_hz: float, frames: int, level: float
) -> NDArray[np.float64]:
    """A linear sweep of so many frames from frame `begin` on, with phase zero there; silence before and after.

    Returns:
        Frames `first` to `first + n - 1`, full scale 1, shape (n,).
    """
    k = np.arange(first - begin, first - begin + n)
    t_s = k / RATE_HZ
    slope_hz_s = (to_hz - from_hz) * RATE_HZ / frames
    cycles = t_s * (from_hz + 0.5 * slope_hz_s * t_s)
    wave = level * np.cos(2.0 * np.pi * (cycles % 1.0))
    return np.where((k >= 0) & (k < frames), wave, 0.0)
