"""Detectors that know the plant: bounds and reference, never a method. Their figures are labelled clairvoyant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from drivers.compiled import compiled

Floats = NDArray[np.float64]

ORDER = 32
"""Of the autoregressive models: longer ones do not change the figures."""


@dataclass(frozen=True)
class Model:
    """A Gaussian process as a prediction filter and the variance that it leaves."""

    taps: Floats
    variance: float

    def innovations(self, x: Floats) -> Floats:
        """Of the second difference of x, shape (n,)."""
        e: Floats = lfilter(self.taps, np.ones(1), np.diff(x, n=2, prepend=[x[0], x[0]]))
        return e


def fit(pieces: Sequence[Floats]) -> Model:
    """Model of the second difference of some recordings (Yule-Walker on their mean autocovariance)."""
    total = np.zeros(ORDER + 1)
    samples = 0
    for piece in pieces:
        d = np.diff(piece, n=2)
        for lag in range(ORDER + 1):
            total[lag] += d[lag:] @ d[: d.size - lag]
        samples += d.size
    covariance = total / samples
    # a little white noise keeps the equations regular; it is far below every sensor's
    covariance[0] *= 1.0 + 1e-9
    weights = solve_toeplitz(covariance[:-1], covariance[1:])
    return Model(np.r_[1.0, -weights], float(covariance[0] - weights @ covariance[1:]))


@dataclass(frozen=True)
class Clairvoyant:
    """Page's CUSUM on the exact log-likelihood ratio of two Gaussian models, fitted to the very plant it is scored
    on."""

    holding: Model
    slipping: Model

    def log_odds(self, x: Floats) -> Floats:
        """Log-likelihood ratio of each sample, nats, shape (n,)."""
        e0, e1 = self.holding.innovations(x), self.slipping.innovations(x)
        offset = 0.5 * math.log(self.holding.variance / self.slipping.variance)
        odds: Floats = offset + e0**2 / (2.0 * self.holding.variance) - e1**2 / (2.0 * self.slipping.variance)
        odds[: ORDER + 2] = 0.0
        return odds

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """The sum after each sample, shape (n,)."""
        return cusum(self.log_odds(values[:, 0]))


@compiled()
def cusum(odds: Floats) -> Floats:
    """Sums that are kept from falling below zero."""
    out = np.empty(odds.size)
    total = 0.0
    for i in range(odds.size):
        total = max(0.0, total + odds[i])
        out[i] = total
    return out
