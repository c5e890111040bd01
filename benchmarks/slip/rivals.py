"""Textbook rivals of the slip detectors, each a function from a recording to a statistic.

None knows the sensor. Where one needs a level of its own, it takes it from the first second, as ours does; its output
before is NaN. All are causal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi

from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings

Floats = NDArray[np.float64]
Rival = Callable[[Floats, float], Floats]
"""From samples, shape (n,), and their rate to the statistic, shape (n,)."""

LEARN_S = 1.0
OURS = "slip"
ORDER = 16
"""Past values that the prediction uses, as ours."""


def _mean(values: Floats, size: int) -> Floats:
    """Of the last `size` values; of fewer at the beginning."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    begins = np.maximum(0, ends - size)
    found: Floats = np.maximum(0.0, total[ends] - total[begins]) / (ends - begins)
    return found


def _armed(statistic: Floats, rate_hz: float) -> Floats:
    statistic[: round(LEARN_S * rate_hz)] = np.nan
    return statistic


def highpass_rms(values: Floats, rate_hz: float, *, window_s: float) -> Floats:
    """Root mean square above 20 Hz (Butterworth, second order)."""
    sections = butter(2, 20.0, "highpass", fs=rate_hz, output="sos")
    above, _ = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])
    return _armed(np.sqrt(_mean(above**2, round(window_s * rate_hz))), rate_hz)


def difference_rms(values: Floats, rate_hz: float, *, window_s: float = 0.008) -> Floats:
    """Root mean square of the second difference."""
    second = np.diff(values, n=2, prepend=[values[0], values[0]])
    return _armed(np.sqrt(_mean(second**2, round(window_s * rate_hz))), rate_hz)


def teager_kaiser(values: Floats, rate_hz: float, *, window_s: float = 0.01) -> Floats:
    """Mean of the Teager-Kaiser energy of the signal above 20 Hz (J. F. Kaiser, ICASSP 1990)."""
    sections = butter(2, 20.0, "highpass", fs=rate_hz, output="sos")
    x, _ = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])
    energy = np.zeros_like(x)
    energy[2:] = x[1:-1] ** 2 - x[2:] * x[:-2]
    return _armed(_mean(np.abs(energy), round(window_s * rate_hz)), rate_hz)


def _residual(values: Floats, rate_hz: float) -> Floats:
    """What sixteen coefficients, fitted to the first second (Yule-Walker), leave; in standard deviations of then."""
    learn = round(LEARN_S * rate_hz)
    x = values - values[:learn].mean()
    lags = np.array([np.dot(x[: learn - k], x[k:learn]) for k in range(ORDER + 1)]) / learn
    lags[0] = lags[0] * (1.0 + 1e-9) + 1e-300
    taps = np.concatenate([[1.0], -solve_toeplitz(lags[:-1], lags[1:])])
    left = np.asarray(lfilter(taps, np.ones(1), x), dtype=np.float64)
    found: Floats = left / max(float(left[ORDER:learn].std()), 1e-300)
    return found


def residual_glr(values: Floats, rate_hz: float, *, longest_s: float = 0.032) -> Floats:
    """Generalized likelihood ratio of a larger variance in the last 1, 2, 4 ... samples of the residual."""
    squared = _residual(values, rate_hz) ** 2
    best = np.zeros_like(squared)
    size = 1
    while size <= longest_s * rate_hz:
        ratio = np.maximum(1.0, _mean(squared, size))
        best = np.maximum(best, 0.5 * size * (ratio - 1.0 - np.log(ratio)))
        size *= 2
    return _armed(best, rate_hz)


def _cusum(gains: Floats, first: int) -> Floats:
    """Page's sum from a sample on, kept from falling below zero."""
    gains[:first] = 0.0
    total = np.cumsum(gains)
    found: Floats = total - np.minimum(0.0, np.minimum.accumulate(total))
    return found


def residual_cusum(values: Floats, rate_hz: float, *, ratio: float = 4.0) -> Floats:
    """CUSUM for a residual of four times the variance."""
    squared = _residual(values, rate_hz) ** 2
    gains = 0.5 * (1.0 - 1.0 / ratio) * squared - 0.5 * np.log(ratio)
    return _armed(_cusum(gains, round(LEARN_S * rate_hz)), rate_hz)


def knock_cusum(
    values: Floats,
    rate_hz: float,
    *,
    beyond: float = 4.0,
    dead_s: float = 0.009,
    slip_hz: float = 100.0,
    rest_hz: float = 1.0,
) -> Floats:
    """Poisson CUSUM of knocks: residuals beyond four standard deviations, one in 9 ms."""
    candidates = np.flatnonzero(np.abs(_residual(values, rate_hz)) > beyond)
    gains = np.full(len(values), -(slip_hz - rest_hz) / rate_hz)
    free, worth = -1.0, np.log(slip_hz / rest_hz)
    for place in candidates.tolist():
        if place >= free:
            gains[place] += worth
            free = place + dead_s * rate_hz
    return _armed(_cusum(gains, round(LEARN_S * rate_hz)), rate_hz)


RIVALS: Mapping[str, Rival] = {
    "high-pass RMS, 10 ms": partial(highpass_rms, window_s=0.01),
    "high-pass RMS, 20 ms": partial(highpass_rms, window_s=0.02),
    "second-difference RMS, 8 ms": difference_rms,
    "Teager-Kaiser, 10 ms": teager_kaiser,
    "AR(16) residual, GLR": residual_glr,
    "AR(16) residual, CUSUM": residual_cusum,
    "whitened knocks, Poisson CUSUM": knock_cusum,
}


def _paper(block_s: float) -> Rival:
    detector = SlipPaperDetector("paper", SlipPaperSettings(block_s=block_s))
    return lambda values, rate_hz: _armed(detector.statistic(values[:, None], rate_hz), rate_hz)


def _ours() -> Rival:
    detector = SlipDetector("ours", SlipSettings())
    return lambda values, rate_hz: detector.statistic(values[:, None], rate_hz)


def judges() -> Mapping[str, Rival]:
    """Every detector, as a function."""
    return {OURS: _ours(), "slip.paper, 64 ms": _paper(0.064), "slip.paper, 32 ms": _paper(0.032), **RIVALS}
