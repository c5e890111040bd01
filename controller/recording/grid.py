"""From the times that a file gives to samples at a regular rate, with gaps where rows are missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUNDING = 0.25
"""Rows are regular samples where their times are within this share of a period of a common grid: times that were
rounded when they were written, as 1 ms at 400 Hz (assumption)."""

STEPS = (0.2, 1.8)
"""A step between two rows in this range of periods is one of a sampler that wanders; a longer one is a gap."""

WANDERING = 0.95
"""So large a share of the steps must be in that range for the rows to be samples at all (assumption)."""


class Regular(NamedTuple):
    """A recording at one rate.

    Attributes:
        pieces: Samples in a row, in order: number of the first one on the grid, values (n, channels), times (n,); a
            jump of the numbers is a gap.
        jitter_s: How far the file's times are from the grid, at most.
        resampled: Whether the values were interpolated to the grid.
    """

    rate_hz: float
    pieces: Sequence[tuple[int, Floats, Floats]]
    jitter_s: float
    resampled: bool


def regular(times_s: Floats, values: Floats) -> Regular | None:
    """Samples at a regular rate, or None where the times are those of events, not of samples.

    Times on a grid are kept as they are. Times that wander about one are interpolated to it by cubic splines,
    each stretch between two gaps by itself.

    Args:
        times_s: Rising, shape (n,).
        values: Shape (n, channels).
    """
    if len(times_s) < 2:
        return None
    steps_s = np.diff(times_s)
    median_s = float(np.median(steps_s))
    places = np.concatenate(([0], np.cumsum(np.rint(steps_s / median_s).astype(np.int64))))
    period_s = float(times_s[-1] - times_s[0]) / max(1, int(places[-1]))
    off_s = np.abs(times_s - times_s[0] - period_s * places)
    if np.diff(places).min() >= 1 and off_s.max() <= ROUNDING * period_s:
        starts = np.flatnonzero(np.diff(places, prepend=-2) != 1)
        pieces = [
            (int(places[first]), values[first:last], times_s[first:last])
            for first, last in zip(starts, [*starts[1:], len(values)], strict=True)
        ]
        return Regular(1.0 / period_s, pieces, float(off_s.max()), False)
    return _resampled(times_s, values, median_s)


def _resampled(times_s: Floats, values: Floats, median_s: float) -> Regular | None:
    steps_s = np.diff(times_s)
    usual = (steps_s >= STEPS[0] * median_s) & (steps_s <= STEPS[1] * median_s)
    if usual.mean() < WANDERING:
        return None
    period_s = float(steps_s[usual].mean())
    starts = [0, *(np.flatnonzero(steps_s > STEPS[1] * median_s) + 1)]
    pieces: list[tuple[int, Floats, Floats]] = []
    jitter_s, seq = 0.0, 0
    for first, last in zip(starts, [*starts[1:], len(times_s)], strict=True):
        since_s, rows = times_s[first:last], values[first:last]
        seq = max(seq, round(float(since_s[0] - times_s[0]) / period_s))
        count = 1 + int((since_s[-1] - since_s[0]) / period_s + 1e-9)
        grid_s = since_s[0] + period_s * np.arange(count)
        pieces.append((seq, _interpolated(grid_s, since_s, rows), grid_s))
        drift_s = since_s - since_s[0] - period_s * np.arange(len(since_s))
        jitter_s = max(jitter_s, float(np.abs(drift_s - np.median(drift_s)).max()))
        seq += count + 1  # a gap stays one, however the rounding falls
    return Regular(1.0 / period_s, pieces, jitter_s, True)


def _interpolated(grid_s: Floats, times_s: Floats, values: Floats) -> Floats:
    if len(times_s) < 4 or not np.isfinite(values).all():
        found = [np.interp(grid_s, times_s, values[:, channel]) for channel in range(values.shape[1])]
        return np.column_stack(found)
    from scipy.interpolate import CubicSpline

    spline: Floats = CubicSpline(times_s, values)(grid_s)
    return spline
