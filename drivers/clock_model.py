"""From a device's microseconds to the host's monotonic seconds, by the lower envelope of arrivals.

A block arrives when its last sample was taken, plus a delay that is never negative, mostly tiny and sometimes
long. A least-squares line through arrivals leans on the long ones; the line *under* them all that is nearest
to them on average touches only the quick ones (Moon, Skelly, Towsley: Estimation and removal of clock skew
from network delay measurements, INFOCOM 1999). It is the edge of the lower convex hull above the mean time.

What one-way arrivals cannot tell is the least delay itself: host times are late by that much (on a pty some
microseconds; on a serial line the time that the frame takes).

Error: a line through quick arrivals on both sides is late by no more than the slower of the two was; a single
touched arrival adds at most twice `max_drift_ppm` times the time since. With 100 frames a second, the delays
measured on a pty (22 us p50, 3.6 ms p99, 16 ms max) and drifts within 100 ppm the tests hold it to: 0.1 ms
after 1 s; 0.03 ms, and 3 ppm in the drift, after 10 s.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]

BUCKET_S: Final = 0.25
"""Of each quarter second only the quickest arrival is kept. Assumption: 10 frames or more a second."""

WINDOW_S: Final = 60.0
"""Older arrivals are forgotten: 240 points at most. Assumption: a crystal's drift is steady for a minute."""

SPAN_MIN_S: Final = 0.5
"""Under this span the drift is kept as it was: 22 us (the median delay) over 0.5 s are already 44 ppm."""

CREEP: Final = 1e-3
"""Host seconds that pass at least for each device second where a `Timeline` holds (assumption)."""


class ClockModel:
    """A line under the arrivals. Pure: it asks no clock; memory and time for a step are bounded.

    Args:
        max_drift_ppm: Bound on the drift. A crystal is within 100 ppm; the default allows for two of them.
    """

    def __init__(self, max_drift_ppm: float = 200.0) -> None:
        self._max_slope = max_drift_ppm * 1e-6
        self._anchor: tuple[int, float] | None = None
        # Of the quickest arrivals: device seconds since the anchor, and by how much host time has gained on
        # them. Small numbers, exact differences; no absolute time enters a product or a sum.
        self._points: deque[Point] = deque()
        self._slope = 0.0
        self._pivot: Point = (0.0, 0.0)

    @property
    def ready(self) -> bool:
        """Whether anything has been observed; before, there are no times to be had."""
        return self._anchor is not None

    @property
    def drift_ppm(self) -> float:
        """By how much the device's clock runs faster than the host's, in ppm; 0 until it is known."""
        return -self._slope / (1.0 + self._slope) * 1e6

    def observe(self, device_us: int, arrival_s: float) -> None:
        """Learn from one arrival.

        Args:
            device_us: Device time of the block's last sample, extended (it never wraps).
            arrival_s: Monotonic time in seconds at which the block was in hand.
        """
        self._anchor = self._anchor or (device_us, arrival_s)
        x_s = (device_us - self._anchor[0]) * 1e-6
        point = (x_s, (arrival_s - self._anchor[1]) - x_s)
        bucket = x_s // BUCKET_S
        latest = self._points[-1][0] // BUCKET_S if self._points else -np.inf
        if bucket > latest:
            self._points.append(point)
            while x_s - self._points[0][0] > WINDOW_S:
                self._points.popleft()
            self._fit()
        elif bucket == latest and point[1] < self._points[-1][1]:
            self._points[-1] = point
            if point[1] < self._pivot[1] + self._slope * (x_s - self._pivot[0]):
                self._fit()

    def host_s(self, device_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Monotonic host times in seconds of extended device times, as seen now; same shape."""
        assert self._anchor is not None, "no arrival has been observed yet"
        x_s = (device_us - self._anchor[0]) * 1e-6
        return self._anchor[1] + (x_s + (self._pivot[1] + self._slope * (x_s - self._pivot[0])))

    def device_us(self, host_s: float) -> int:
        """Extended device time at a monotonic host time: the inverse of `host_s`."""
        assert self._anchor is not None, "no arrival has been observed yet"
        since_s = host_s - self._anchor[1] - self._pivot[0] - self._pivot[1]
        return self._anchor[0] + round((self._pivot[0] + since_s / (1.0 + self._slope)) * 1e6)

    def _fit(self) -> None:
        newest_s = self._points[-1][0]
        local = [(x_s - newest_s, gain_s) for x_s, gain_s in self._points]
        if -local[0][0] >= SPAN_MIN_S:
            slope = _slope_at_mean(local)
            self._slope = min(max(slope, -self._max_slope), self._max_slope)
        self._pivot = (newest_s, min(gain_s - self._slope * x_s for x_s, gain_s in local))


def _slope_at_mean(points: list[Point]) -> float:
    """Slope of the lower hull's edge above the mean of the points' x; x ascends."""
    mean_s = sum(x_s for x_s, _ in points) / len(points)
    hull = _lower_hull(points)
    (x0_s, y0_s), (x1_s, y1_s) = next(edge for edge in pairwise(hull) if edge[1][0] >= mean_s)
    return (y1_s - y0_s) / (x1_s - x0_s)


def _lower_hull(points: Iterable[Point]) -> list[Point]:
    """Lower convex hull of points with ascending x (Andrew's monotone chain)."""
    hull: list[Point] = []
    for point in points:
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    return hull


def _turns_right(a: Point, b: Point, c: Point) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (c[0] - a[0]) * (b[1] - a[1])


class Timeline:
    """Host times of one stream: a model that thinks better of the past never turns them back.

    Args:
        model: The model of the device's clock.
    """

    def __init__(self, model: ClockModel) -> None:
        self._model = model
        self._floor_us = 0
        self._floor_s = -np.inf

    def host_s(self, device_us: NDArray[np.int64]) -> NDArray[np.float64]:
        """Monotonic host times in seconds of extended device times that ascend; none before what is held."""
        least_s = self._floor_s + CREEP * 1e-6 * np.maximum(device_us - self._floor_us, 0)
        return np.maximum(self._model.host_s(device_us), least_s)

    def hold(self, device_us: int, host_s: float) -> None:
        """Times up to `device_us` have been given out, the last of them as `host_s`."""
        self._floor_us, self._floor_s = device_us, host_s

    def restart(self, model: ClockModel) -> None:
        """The device counts from anew, by another model; host time goes on."""
        self._model = model
        self._floor_us = 0
