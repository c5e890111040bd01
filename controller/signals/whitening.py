"""Innovations of a sampled signal: prediction errors, relative to those of noise and a known ring.
Compiled.

The signal's second difference, free of offset and slope, is predicted from its own last values by
weighted least squares. Free ringing of a structure is predicted, whatever its frequency and damping; a blow to it is
not.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LAST, SLOPE, NOISE, ENERGY, GAIN, BARE = range(6)
"""Places among the scalars: last sample; last first difference; variance of the white noise in the signal; mean
square of the second difference; variance of the innovation that white noise of variance 1 makes; the last squared
innovation over the variance that noise alone gives it."""

FRESH, COUNT = range(2)
"""Places among the counts: samples since the last gap; second differences received, during learning and beyond."""

SOLVE_EVERY = 8
"""The weights are solved for after so many samples: the sums behind them remember hundreds."""

RIDGE = 1e-6
"""Added to the diagonal of the normal equations, relative to their trace: bounds the condition, and with it the
rounding error of the weights, to 1e-10 after any history."""

DRIFT = 1e-4
"""Mean square of a constant part that the second difference may have, relative to its own: the weights then
predict most of a constant acceleration, as when an arm starts. Chosen on simulated starts: none alarms, and slip
is found as fast."""

LIMIT = 1000.0
"""A second difference beyond so many standard deviations of noise is cut: a glitch of 1e9 is then a knock like
others."""

SECOND_DIFFERENCE_GAIN = 6.0
"""Variance of the second difference of white noise of variance 1: 1 + 4 + 1."""

CUT = 4.0
CUT_MEAN = 0.9205369
"""The squared innovation's influence on the noise level is cut at 4 variances; the mean of a chi-square variable (1
degree of freedom) that is cut there: erf(sqrt 2) - 4 phi(2) + 4 erfc(sqrt 2)."""

KEPT = 0.75
KEPT_MEAN_SQUARE = 0.3685241
"""The first guess of the noise uses the smaller three quarters of the magnitudes; their mean square for a normal
deviate: 1 - 2 a phi(a) / 0.75 with a = 1.150349."""

BEYOND = 1e100
"""A larger magnitude counts as a missing sample: its square would overflow."""


class Predictor(NamedTuple):
    """Constants and state of one channel; times are in samples, and the arrays are advanced in place.

    Attributes:
        keep: Share of the normal equations that a sample leaves of the past.
        keep_energy: The same of the energy.
        scale: Samples in which the noise level follows by a factor e at most a third.
        model_error: Part of a ring's amplitude that the prediction may miss.
        gram: Normal equations, lower triangle, shape (order, order).
        cross: Their right side, shape (order,).
        past: Last second differences, the newest first, shape (order,).
        weights: Of the prediction, shape (order,).
        factor: Cholesky factor, scratch, shape (order, order).
        first: Magnitudes of the second differences that set the first guess of the noise, shape (learn,).
        scalars: Shape (6,).
        counts: Shape (2,).
    """

    keep: float
    keep_energy: float
    scale: float
    model_error: float
    gram: Floats
    cross: Floats
    past: Floats
    weights: Floats
    factor: Floats
    first: Floats
    scalars: Floats
    counts: Ints


def predictor(
    order: int, learn: int, *, keep: float, keep_energy: float, scale: float, model_error: float
) -> Predictor:
    """A predictor in its initial state, from `order` values, that learns from `learn`; the rest as in `Predictor`."""
    scalars = np.zeros(6)
    scalars[GAIN] = SECOND_DIFFERENCE_GAIN
    return Predictor(
        keep,
        keep_energy,
        scale,
        model_error,
        gram=np.zeros((order, order)),
        cross=np.zeros(order),
        past=np.zeros(order),
        weights=np.zeros(order),
        factor=np.zeros((order, order)),
        first=np.zeros(learn),
        scalars=scalars,
        counts=np.zeros(2, dtype=np.int64),
    )


@compiled()
def first_level(magnitudes: Floats) -> float:
    """Variance of the white noise behind second differences of these magnitudes; bumps among them do little.

    Where most samples repeat the one before (a coarse converter), the variance of its smallest step; 0 where all do.
    """
    ordered = np.sort(magnitudes)
    kept = int(KEPT * ordered.size)
    total = 0.0
    for i in range(kept):
        total += ordered[i] * ordered[i]
    if total > 0.0:
        return total / (kept * KEPT_MEAN_SQUARE * SECOND_DIFFERENCE_GAIN)
    for i in range(kept, ordered.size):
        if ordered[i] > 0.0:
            return float(ordered[i] * ordered[i] / 12.0)
    return 0.0


@compiled()
def _solve(p: Predictor) -> None:
    """Weights from the normal equations (Cholesky), and the gain of noise that goes with them."""
    gram, factor, weights = p.gram, p.factor, p.weights
    order = weights.size
    trace = 0.0
    for i in range(order):
        trace += gram[i, i]
    if trace <= 0.0:
        return
    ridge, drift = RIDGE * trace, DRIFT * trace / order
    for i in range(order):
        for j in range(i + 1):
            rest = gram[i, j] + drift
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            if i == j:
                # the ridge keeps this positive but for rounding
                factor[i, i] = math.sqrt(max(rest + ridge, ridge))
            else:
                factor[i, j] = rest / factor[j, j]
    for i in range(order):
        rest = p.cross[i] + drift
        for k in range(i):
            rest -= factor[i, k] * weights[k]
        weights[i] = rest / factor[i, i]
    for i in range(order - 1, -1, -1):
        rest = weights[i]
        for k in range(i + 1, order):
            rest -= factor[k, i] * weights[k]
        weights[i] = rest / factor[i, i]
    gain = 0.0
    older, old = 0.0, 0.0
    for i in range(order + 3):
        tap = 1.0 if i == 0 else (-weights[i - 1] if i <= order else 0.0)
        gain += (tap - 2.0 * old + older) ** 2
        older, old = old, tap
    p.scalars[GAIN] = gain


@compiled()
def innovate(p: Predictor, x: float) -> float:
    """Process one sample.

    Args:
        p: The predictor, advanced.
        x: The sample; NaN or infinity is a gap.

    Returns:
        The squared innovation over the variance that noise and the prediction's own error give it; NaN while there
        is none: in a gap, for `order` + 2 samples after one, and while learning.
    """
    v, counts, past, weights = p.scalars, p.counts, p.past, p.weights
    if not abs(x) < BEYOND:
        counts[FRESH] = 0
        return math.nan
    counts[FRESH] += 1
    slope = x - v[LAST]
    v[LAST] = x
    d = slope - v[SLOPE]
    v[SLOPE] = slope
    if counts[FRESH] < 3:
        return math.nan
    learn = p.first.size
    if counts[COUNT] < learn:
        p.first[counts[COUNT]] = abs(d)
        counts[COUNT] += 1
        if counts[COUNT] == learn:
            v[NOISE] = first_level(p.first)
            v[ENERGY] = SECOND_DIFFERENCE_GAIN * v[NOISE]
            if v[NOISE] == 0.0:
                # a constant signal gives no noise level
                counts[COUNT] = 0
        return math.nan
    bound = LIMIT * math.sqrt(SECOND_DIFFERENCE_GAIN * v[NOISE])
    d = min(max(d, -bound), bound)
    ratio = math.nan
    order = past.size
    if counts[FRESH] >= order + 3 and counts[COUNT] >= learn + order:
        e = d
        for i in range(order):
            e -= weights[i] * past[i]
        floor = v[GAIN] * v[NOISE]
        squared = e * e
        allowed = floor + p.model_error * p.model_error * v[ENERGY]
        ratio = squared / allowed
        v[BARE] = squared / floor
        # a constant signal shows nothing of its noise
        if squared > 0.0:
            v[NOISE] *= 1.0 + (min(v[BARE], CUT) - CUT_MEAN) / p.scale
            _learn(p, d, min(1.0, 1.0 / ratio))
    counts[COUNT] += 1
    if counts[COUNT] % SOLVE_EVERY == 0:
        _solve(p)
    for i in range(order - 1, 0, -1):
        past[i] = past[i - 1]
    past[0] = d
    v[ENERGY] = p.keep_energy * v[ENERGY] + (1.0 - p.keep_energy) * d * d
    return ratio if counts[COUNT] >= 2 * learn else math.nan


@compiled()
def _learn(p: Predictor, d: float, weight: float) -> None:
    """Add one row to the normal equations; large innovations count less, since a blow shows nothing of ringing."""
    gram, cross, past = p.gram, p.cross, p.past
    for i in range(past.size):
        row = weight * past[i]
        cross[i] = p.keep * cross[i] + row * d
        for j in range(i + 1):
            gram[i, j] = p.keep * gram[i, j] + row * past[j]
