"""Peaks of the spectra of consecutive blocks of a stream, however the samples arrive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Peaks(NamedTuple):
    """One row per completed block, one column per channel.

    Attributes:
        ends: Number of the sample that completed each block, counted from the first of the present push, shape (m,).
        power: Largest |Phi(k)|^2 / N over k = 1 … N // 2, the signal's unit squared, shape (m, channels).
        frequency_hz: Where it is, shape (m, channels). Both NaN for a block that holds a value that is not finite.
    """

    ends: NDArray[np.int64]
    power: Floats
    frequency_hz: Floats


class SpectrumBlocks:
    """Cuts a stream into blocks of N samples and finds each block's spectral peak, the DC term left out.

    Args:
        size: N, samples in a block, at least 2.

    Example:
        >>> blocks = SpectrumBlocks(4)
        >>> blocks.push(np.array([[1.0], [-1.0], [1.0], [-1.0]]), rate_hz=1000.0).frequency_hz
        array([[500.]])
    """

    def __init__(self, size: int) -> None:
        if size < 2:
            raise ValueError(f"a block of {size} samples has no frequency; make it longer or sample faster")
        self.size = size
        self.reset()

    def reset(self) -> None:
        """Drop the block begun: the next sample is the first of a new one."""
        self._begun: Floats | None = None

    def push(self, values: Floats, rate_hz: float) -> Peaks:
        """Process the next samples.

        Args:
            values: Shape (n, channels), without a gap to those before.
            rate_hz: Sample rate.
        """
        waiting = 0 if self._begun is None else len(self._begun)
        joined = values if self._begun is None else np.concatenate((self._begun, values))
        count = len(joined) // self.size
        self._begun = joined[count * self.size :].copy()
        ends = self.size * np.arange(1, count + 1) - 1 - waiting
        blocks = joined[: count * self.size].reshape(count, self.size, joined.shape[1])
        return Peaks(ends, *block_peaks(np.moveaxis(blocks, 1, 2), rate_hz))


def block_peaks(blocks: Floats, rate_hz: float) -> tuple[Floats, Floats]:
    """Peak of the power spectrum of each block and its frequency.

    Args:
        blocks: Shape (..., N).
        rate_hz: Sample rate.

    Returns:
        Power and frequency, shape (...,); NaN where a block holds a value that is not finite.
    """
    size = blocks.shape[-1]
    usable = np.asarray(np.isfinite(blocks).all(axis=-1))
    spectrum = np.fft.rfft(np.where(usable[..., None], blocks, 0.0), axis=-1)[..., 1:]
    # a number so large that its square overflows is above every threshold, as is infinity
    with np.errstate(over="ignore", invalid="ignore"):
        powers = (spectrum.real**2 + spectrum.imag**2) / size
    k = np.argmax(powers, axis=-1)
    power = np.take_along_axis(powers, k[..., None], axis=-1)[..., 0]
    return np.where(usable, power, np.nan), np.where(usable, (k + 1) * (rate_hz / size), np.nan)
