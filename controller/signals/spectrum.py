"""Spectra of short records, and of consecutive blocks of a stream."""

import numpy as np

from drivers.core.messages import Floats, Ints


def dominant_frequency(x: Floats, rate_hz: float) -> float:
    """Frequency of the largest peak of a record's spectrum.

    Hann window, zero-padded eightfold; the peak is refined by a parabola through the logarithm of its three
    largest bins, exact for a Gaussian-like main lobe and within 0.01 bins for a Hann one.

    Args:
        x: Shape (n,), any unit.

    Returns:
        Frequency in hertz; NaN for a record without variance or with values that are not finite.
    """
    from scipy.signal import periodogram  # takes half a second to load

    if len(x) < 8 or not np.isfinite(x).all() or np.ptp(x) == 0.0:
        return float("nan")
    frequencies_hz, power = periodogram(x, rate_hz, window="hann", nfft=8 * len(x), detrend="constant")
    k = int(np.argmax(power[1:-1])) + 1
    low, peak, high = np.log(power[k - 1 : k + 2] + np.finfo(float).tiny)
    curvature = low - 2.0 * peak + high
    shift = 0.5 * (low - high) / curvature if curvature < 0.0 else 0.0
    return float(frequencies_hz[k] + shift * (frequencies_hz[1] - frequencies_hz[0]))


class BlockCutter:
    """Cuts a stream without gaps into blocks of N samples, however they arrive.

    Args:
        size: N, samples in a block, at least 2.

    Raises:
        ValueError: a block has fewer samples.
    """

    def __init__(self, size: int) -> None:
        if size < 2:
            raise ValueError(f"a block of {size} samples has no frequency; make it longer or sample faster")
        self.size = size
        self.reset()

    def reset(self) -> None:
        """Drop the block begun: the next sample is the first of a new one."""
        self._begun: Floats | None = None

    def push(self, values: Floats) -> tuple[Ints, Floats]:
        """Process the next samples, shape (n, channels).

        Returns:
            Number of the sample that completed each block, counted from the first of these, shape (m,); and the
            blocks, shape (m, N, channels).
        """
        waiting = 0 if self._begun is None else len(self._begun)
        joined = values if self._begun is None else np.concatenate((self._begun, values))
        count = len(joined) // self.size
        self._begun = joined[count * self.size :].copy()
        ends = self.size * np.arange(1, count + 1) - 1 - waiting
        return ends, joined[: count * self.size].reshape(count, self.size, joined.shape[1])


def block_peaks(blocks: Floats, rate_hz: float) -> tuple[Floats, Floats]:
    """Peak of each block's power spectrum, the DC term left out; of several channels that with the highest frequency.

    Args:
        blocks: Shape (m, N, channels).

    Returns:
        Largest |Phi(k)|^2 / N over k = 1 … N // 2, the signal's unit squared, and its frequency, Hz, shape (m,) each;
        a channel of which a value is not finite does not count, and without any other both are NaN.
    """
    if not len(blocks):
        return np.empty(0), np.empty(0)
    channels = np.moveaxis(blocks, 1, 2)
    size = channels.shape[-1]
    usable = np.asarray(np.isfinite(channels).all(axis=-1))
    spectrum = np.fft.rfft(np.where(usable[..., None], channels, 0.0), axis=-1)[..., 1:]
    # a number so large that its square overflows is above every threshold, as is infinity
    with np.errstate(over="ignore", invalid="ignore"):
        powers = (spectrum.real**2 + spectrum.imag**2) / size
    k = np.argmax(powers, axis=-1)
    # of equal frequencies the first channel decides
    deciding = np.argmax(np.where(usable, k, -1), axis=1)
    rows = np.arange(len(blocks))
    k, usable = k[rows, deciding], usable[rows, deciding]
    power = np.where(usable, powers[rows, deciding, k], np.nan)
    return power, np.where(usable, (k + 1) * (rate_hz / size), np.nan)
