"""What every chain hears: two fingers' sound, simulated, whose envelopes are known."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.signals.oscillator import Oscillator
from drivers.audio.codec import pack24

RATE_HZ = 96_000
OUTPUT_HZ = 1000
DECIMATION = RATE_HZ // OUTPUT_HZ
DRIVE_HZ = 40_000.0
FINGERS = 2

Complexes = NDArray[np.complex128]

UNDULATIONS = ((0.01, 7.0), (0.005, 70.0))
"""Full scales and Hz: a finger at 0.03 m/s, and one at 0.3 m/s. Assumption: 1 % of full scale."""

OFFSET, HUM = 0.01, (0.01, 50.0)
"""The converter's offset, and mains that gets into the cable, full scales and Hz (assumption)."""


def right(t_s: NDArray[np.float64]) -> Complexes:
    """True envelope of the right finger, full scale 1."""
    z = np.full(len(t_s), 0.25 + 0.1j)
    for size, hz in UNDULATIONS:
        z += size * np.exp(2j * np.pi * hz * t_s)
    return z


def left(t_s: NDArray[np.float64]) -> Complexes:
    """True envelope of the left finger: another bridge, the other direction."""
    z = np.full(len(t_s), -0.1 + 0.2j)
    for size, hz in UNDULATIONS:
        z += size * np.exp(-2j * np.pi * hz * t_s)
    return z


ENVELOPES: tuple[Callable[[NDArray[np.float64]], Complexes], ...] = (right, left)


class Sound(NamedTuple):
    """Two fingers' sound.

    Attributes:
        frame: Number of the first frame.
        seconds: Length.
        drive_hz: Of the drive.
        packed: 24-bit counts as they come from a converter, little-endian, shape (n, 6).
        counts: The same as int32, shape (n, 2).
    """

    frame: int
    seconds: float
    drive_hz: float
    packed: NDArray[np.uint8]
    counts: NDArray[np.int32]


def sound(seconds: float, drive_hz: float = DRIVE_HZ, frame: int = 96_000_000) -> Sound:
    """Both fingers' sound, as a converter of 24 bits hears it; the drive's phase is zero at frame 0."""
    n = round(seconds * RATE_HZ)
    wave = Oscillator(drive_hz, float(RATE_HZ)).wave(np.arange(frame, frame + n, dtype=np.int64))
    t_s = np.arange(n) / RATE_HZ
    stray = OFFSET + HUM[0] * np.sin(2.0 * np.pi * HUM[1] * t_s)
    heard = np.column_stack([(envelope(t_s) * wave).real + stray for envelope in ENVELOPES])
    counts = np.rint(heard * 2.0**23).astype(np.int32)
    packed = np.frombuffer(pack24(counts), np.uint8).reshape(n, 3 * FINGERS)
    return Sound(frame, seconds, drive_hz, packed, counts)
