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

LAST, SLOPE, NOISE, ENERGY, GAIN, BARE, STEP = range(7)
"""Places among the scalars: last sample; last first difference; variance of the white noise in the signal; mean
square of the second difference; variance of the innovation that white noise of variance 1 makes; the last squared
innovation over the variance that noise alone gives it; least change from a sample to the next, the converter's step."""

FRESH, COUNT, LOST = range(3)
"""Places among the counts: samples since the last gap; second differences received, during learning and beyond; samples
lost since the last one."""

BRIDGED = 2
"""So many lost samples in a row are no gap: what was predicted takes their place."""

ROUNDED = 0.25
"""The least variance of noise, in squared steps of the converter: no noise, however small, has more between two
neighbouring codes. A channel at rest may go from one code, where its level would fall without end, to the edge of two;
with 1/12, rounding's mean over all places, that is three times the variance. A sensor without a converter has changes
so small that it means nothing."""

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
        scalars: Shape (7,).
        counts: Shape (3,).
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
    scalars = np.zeros(7)
    scalars[GAIN], scalars[STEP] = SECOND_DIFFERENCE_GAIN, math.inf
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
        counts=np.zeros(3, dtype=np.int64),
    )


@compiled()
def first_level(magnitudes: Floats) -> float:
    """Variance of the white noise behind second differences of these magnitudes; bumps among them do little."""
    ordered = np.sort(magnitudes)
    kept = int(KEPT * ordered.size)
    total = 0.0
    for i in range(kept):
        total += ordered[i] * ordered[i]
    return total / (kept * KEPT_MEAN_SQUARE * SECOND_DIFFERENCE_GAIN)


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
def _pass(p: Predictor, d: float) -> None:
    """Take a second difference into the past."""
    past = p.past
    for i in range(past.size - 1, 0, -1):
        past[i] = past[i - 1]
    past[0] = d
    p.scalars[ENERGY] = p.keep_energy * p.scalars[ENERGY] + (1.0 - p.keep_energy) * d * d


@compiled()
def _lose(p: Predictor) -> None:
    """A sample is lost. Of up to `BRIDGED` in a row each is what the past predicts; where too little is known, the last
    one before."""
    v, counts, past, weights = p.scalars, p.counts, p.past, p.weights
    counts[LOST] += 1
    if counts[LOST] > BRIDGED or counts[FRESH] < 3 or counts[COUNT] < p.first.size:
        counts[FRESH] = 0
        return
    d = -v[SLOPE]
    if counts[FRESH] >= past.size + 2 and weights[0] != 0.0:
        d = 0.0
        for i in range(past.size):
            d += weights[i] * past[i]
    v[SLOPE] += d
    v[LAST] += v[SLOPE]
    counts[FRESH] += 1
    _pass(p, d)


@compiled()
def _receive(p: Predictor, x: float) -> float:
    """Take a sample; returns the second difference."""
    v, counts = p.scalars, p.counts
    slope = x - v[LAST]
    # after a lost one it is a change from what was predicted
    if counts[FRESH] > 0 and counts[LOST] == 0 and 0.0 < abs(slope) < v[STEP]:
        v[STEP] = abs(slope)
    d = float(slope - v[SLOPE])
    v[LAST], v[SLOPE] = x, slope
    counts[FRESH] += 1
    counts[LOST] = 0
    return d


@compiled()
def _begin(p: Predictor, magnitude: float) -> None:
    """Take a second difference's magnitude into the first guess of the noise."""
    v, counts = p.scalars, p.counts
    p.first[counts[COUNT]] = magnitude
    counts[COUNT] += 1
    if counts[COUNT] < p.first.size:
        return
    if v[STEP] == math.inf:
        # a constant signal gives no noise level
        counts[COUNT] = 0
        return
    v[NOISE] = max(first_level(p.first), ROUNDED * v[STEP] * v[STEP])
    v[ENERGY] = SECOND_DIFFERENCE_GAIN * v[NOISE]


@compiled()
def innovate(p: Predictor, x: float) -> float:
    """Process one sample.

    Args:
        p: The predictor, advanced.
        x: The sample; NaN or infinity is a gap.

    Returns:
        The squared innovation over the variance that noise and the prediction's own error give it; NaN while there
        is none: in a gap, for `order` + 2 samples after one, while learning, and for a lost sample, of which up to
        `BRIDGED` in a row are no gap.
    """
    v, counts, past, weights = p.scalars, p.counts, p.past, p.weights
    if not abs(x) < BEYOND:
        _lose(p)
        return math.nan
    lost, d = counts[LOST], _receive(p, x)
    if counts[FRESH] < 3:
        return math.nan
    learn = p.first.size
    if counts[COUNT] < learn:
        _begin(p, abs(d))
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
        if lost > 0:
            # the variance of a prediction by two samples, or three, over that by one
            one = 2.0 + weights[0]
            two = one * one - 1.0 - 2.0 * weights[0] + weights[1] if lost > 1 else 0.0
            squared /= 1.0 + one * one + two * two
        allowed = floor + p.model_error * p.model_error * v[ENERGY]
        ratio = squared / allowed
        v[BARE] = squared / floor
        # a constant signal shows nothing of its noise
        if squared > 0.0:
            v[NOISE] *= 1.0 + (min(v[BARE], CUT) - CUT_MEAN) / p.scale
            v[NOISE] = max(v[NOISE], ROUNDED * v[STEP] * v[STEP])
            _learn(p, d, min(1.0, 1.0 / ratio))
    counts[COUNT] += 1
    if counts[COUNT] % SOLVE_EVERY == 0:
        _solve(p)
    _pass(p, d)
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
