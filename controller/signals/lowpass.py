"""Low-passes before the rate goes down from a carrier's to an envelope's."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SPAN: Final = 6
"""Length of the low-pass in periods of the output: 6 ms at 1 kHz, 576 taps at 96 kHz."""

COSINES: Final = (1.0, 1.99419295, 1.79909967, 1.05147552, 0.25617692, 0.00966375353, 0.000187100534)
"""Amplitudes of the harmonics of the low-pass, relative to its mean. Found by minimax (weighted least squares, iterated
on a grid of frequencies) for: flat up to a tenth of the output rate, nothing within a tenth of it around its multiples,
which fold onto that band, and -130 dB beyond 10 times the output rate, where the mixer's images are. Whole harmonics of
the window's length are nulls beyond the sixth: at 40 kHz the images fall on one."""

CIC_STAGES: Final = 3

CIC_DECIMATION_MAX: Final = 256
"""Most frames an output of three sums: the mixer's whole numbers then still have an amplitude of 2^16."""


def cosine_taps(decimation: int) -> Floats:
    """The low-pass of `COSINES` for a decimation, sum 1, shape (6 decimation,).

    At an output of 1 kHz: within 0.0006 dB from 0 to 100 Hz, -0.07 dB at 200 Hz, -5.6 dB at 500 Hz; what folds onto 0
    to 100 Hz is down by at least 80 dB (93 dB from 3 kHz on, 130 dB from 10 kHz on).
    """
    n = SPAN * decimation
    k = np.arange(n) - 0.5 * (n - 1)
    taps = sum(a * np.cos(2.0 * np.pi * j / n * k) for j, a in enumerate(COSINES))
    return np.asarray(taps / np.sum(taps))


def cic_taps(decimation: int) -> NDArray[np.int64]:
    """Impulse response of three sums over `decimation` frames in a row, whole numbers, shape (3 decimation - 2,)."""
    taps = np.ones(1, np.int64)
    for _ in range(CIC_STAGES):
        taps = np.convolve(taps, np.ones(decimation, np.int64))
    return taps
