"""From a device's clock to the host's: the line under the arrivals.

A block is in hand when its last sample was taken, plus a delay that is never negative, mostly tiny and sometimes
long. A least-squares line through arrivals leans on the long ones. With delays of an exponential distribution the
likeliest line is the one *under* all arrivals that is nearest to them on average: it is the edge of their lower
convex hull above their mean time, and touches only the quick ones (Moon, Skelly, Towsley: Estimation and removal of
clock skew from network delay measurements, INFOCOM 1999). To this we add what is known of crystals, a normal
distribution of the drift, which keeps a burst of late arrivals from tilting a line that is young.

One-way arrivals cannot show the least delay itself: host times are late by that much (on a pty some
microseconds; on a serial line the time that the frame takes).

Error, with the delays measured on a pty (22 us p50, 3.6 ms p99, 16 ms max), 100 frames a second and a drift within
100 ppm: 0.02 ms after 1 s; 0.01 ms, and 1 ppm in the drift, after 10 s; 0.05 ms where bursts of late arrivals fill half
of the time. The tests hold it to these.
"""

from typing import Final

Point = tuple[float, float]

WINDOW_S: Final = 60.0
"""Arrivals older than this are forgotten, half a window at a time. Assumption: a drift is steady for a minute."""

FIT_S: Final = 0.1
"""The line is fitted this often, and whenever an arrival lies below it (assumption)."""

SETTLING_S: Final = 1.0
"""For so long the line has few arrivals to rest on; times may step to follow it (assumption)."""

DELAY_S: Final = 0.01
"""Delay assumed before any is known, with the weight of one arrival (assumption)."""

LATE_S: Final = 1e-3
LATE_DELAYS: Final = 8.0
"""An arrival that is later than both, in seconds and in mean delays, belongs to a burst, and is not
used. Assumptions: one in 3,000 exponential delays is as long; a clock of milliseconds alone makes 1 ms."""

PATIENCE_S: Final = 10.0
"""Where all arrivals are late for so long, the least delay has changed: the line restarts (assumption)."""

AT_BOUND_S: Final = 5e-3
"""A drift at its bound is worth a warning once it has made this much: less a busy host makes too (assumption)."""

DRIFT_SIGMAS: Final = 3.0
"""Standard deviations of a drift that the bound on it is taken for (assumption)."""


class _Hull:
    """Lower convex hull of arrivals, their mean time and delay: all that the likeliest line depends on.

    An arrival is a point: device time since the anchor, and by how much host time has gained on it, both in
    seconds. These are small numbers and exact differences; no absolute time enters a product or a sum.
    """

    def __init__(self, begun_s: float) -> None:
        self.begun_s = begun_s
        self._vertices: list[Point] = []
        self._count = 0
        self._times_s = 0.0
        self._delays_s = DELAY_S

    @property
    def delay_s(self) -> float:
        """Mean delay."""
        return self._delays_s / self._count

    def add(self, x_s: float, gain_s: float, delay_s: float) -> None:
        """Take an arrival later than all before it (Andrew's monotone chain: constant time on average)."""
        vertices = self._vertices
        while len(vertices) > 1:
            (x0_s, gain0_s), (x1_s, gain1_s) = vertices[-2:]
            if (x1_s - x0_s) * (gain_s - gain0_s) > (gain1_s - gain0_s) * (x_s - x0_s):
                break
            vertices.pop()
        vertices.append((x_s, gain_s))
        self._count += 1
        self._times_s += x_s - self.begun_s
        self._delays_s += delay_s

    def touched(self, slope: float) -> Point:
        """Where a line of this slope touches the hull from below."""
        return min(self._vertices, key=lambda point: point[1] - slope * point[0])

    def slope(self, expected: float, sigma: float) -> float:
        """Of the likeliest line under the points, where the slope is known as `expected` with deviation `sigma`.

        With n exponential delays of mean tau, and the line of slope b through the vertex v(b) that it touches, the
        log-likelihood is n (gain_v + b (x_mean - x_v)) / tau - (b - expected)^2 / (2 sigma^2) and a constant. It is
        concave; its derivative changes sign where x_v(b) + stiffness (b - expected) passes x_mean, with
        stiffness = tau / (n sigma^2).
        """
        mean_s = self.begun_s + self._times_s / self._count
        stiffness = self.delay_s / (self._count * sigma * sigma)
        x0_s, gain0_s = self._vertices[0]
        for x1_s, gain1_s in self._vertices[1:]:
            edge = (gain1_s - gain0_s) / (x1_s - x0_s)
            if x1_s + stiffness * (edge - expected) >= mean_s:
                return min(edge, expected + (mean_s - x0_s) / stiffness)
            x0_s, gain0_s = x1_s, gain1_s
        return expected + (mean_s - x0_s) / stiffness


class DeviceClock:
    """The clock of a device, shared by all its streams: a line under the arrivals.

    Pure: it asks no other clock; an arrival takes constant time on average.

    Args:
        max_drift_ppm: Bound on the drift. A crystal is within 100 ppm; the default allows for two of them.
        wrap_s: When the clock wraps to zero; None where it never does.
    """

    def __init__(self, max_drift_ppm: float = 200.0, wrap_s: float | None = None) -> None:
        self.restarts = 0
        self._max_slope = max_drift_ppm * 1e-6
        self._wrap_s = wrap_s
        self._forget()

    def restart(self) -> None:
        """The clock has restarted: nothing is known of it."""
        self.restarts += 1
        self._forget()

    def _forget(self) -> None:
        self._anchor: Point | None = None
        self._hulls: list[_Hull] = []
        self._begun_s = self._latest_s = self._quick_s = self._fitted_s = 0.0
        self._late_s = 0.0
        self._slope = self._expected = 0.0
        self._touched: Point = (0.0, 0.0)

    @property
    def ready(self) -> bool:
        """Whether anything has been observed; before that there are no times."""
        return self._anchor is not None

    @property
    def settled(self) -> bool:
        """Whether arrivals have been observed for `SETTLING_S`."""
        return self._latest_s - self._begun_s >= SETTLING_S

    @property
    def pace(self) -> float:
        """Host seconds for each second of the device."""
        return 1.0 + self._slope

    @property
    def drift_ppm(self) -> float:
        """By how much the device's clock runs faster than the host's, in ppm; 0 until it is known."""
        return -self._slope / (1.0 + self._slope) * 1e6

    def account(self, device: str) -> dict[str, object]:
        """For the account of a driver: `drift_ppm`, and a `warning` where it is at its bound; `device` is its name."""
        found: dict[str, object] = {"drift_ppm": self.drift_ppm}
        since_s = self._latest_s - self._begun_s
        if self.settled and abs(self._slope) >= self._max_slope and since_s * self._max_slope >= AT_BOUND_S:
            found["warning"] = (
                f"{device}: its clock runs {1e6 * self._max_slope:g} ppm from this computer's or more, and "
                "max_drift_ppm allows no more: its samples are dated worse and worse; raise max_drift_ppm"
            )
        return found

    def extended(self, shown_s: float, arrival_s: float) -> tuple[float, float]:
        """Device time with wraps undone, and by how much it is ahead of the time expected from the arrival (s)."""
        if not self.ready:
            return shown_s, 0.0
        expected_s = self.device_s(arrival_s)
        if self._wrap_s is not None:
            shown_s += self._wrap_s * round((expected_s - shown_s) / self._wrap_s)
        return shown_s, shown_s - expected_s

    def observe(self, device_s: float, arrival_s: float) -> None:
        """Learn from one arrival; one that is no newer than those before is ignored.

        Args:
            device_s: Device time in seconds of the block's last sample, extended (it never wraps).
            arrival_s: Monotonic time in seconds at which the block was in hand.
        """
        if self._anchor is None:
            self._anchor = (device_s, arrival_s)
        x_s = device_s - self._anchor[0]
        gain_s = (arrival_s - self._anchor[1]) - x_s
        if not self._hulls or x_s - self._latest_s > WINDOW_S:
            self._begin(x_s, gain_s)
            self._begun_s = x_s
        elif x_s <= self._latest_s:
            return
        self._latest_s = x_s
        delay_s = gain_s - (self._touched[1] + self._slope * (x_s - self._touched[0]))
        if delay_s > self._late_s and x_s - self._quick_s < PATIENCE_S:
            return
        if abs(delay_s) > self._late_s:
            self._begin(x_s, gain_s)
            delay_s = 0.0
        self._quick_s = x_s
        if x_s - self._hulls[-1].begun_s > WINDOW_S / 2:
            self._hulls = [self._hulls[-1], _Hull(x_s)]
        for hull in self._hulls:
            hull.add(x_s, gain_s, delay_s if delay_s > 0.0 else 0.0)
        if delay_s < 0.0 or x_s - self._fitted_s >= FIT_S:
            self._fit(x_s)

    def _begin(self, x_s: float, gain_s: float) -> None:
        """Forget all arrivals; keep what is known of the drift."""
        self._hulls = [_Hull(x_s)]
        self._expected = self._slope
        self._touched = (x_s, gain_s)
        self._quick_s = self._fitted_s = x_s
        self._late_s = LATE_DELAYS * DELAY_S

    def host_s(self, device_s: float) -> float:
        """Monotonic host time in seconds of an extended device time, as seen now."""
        assert self._anchor is not None, "no arrival has been observed yet"
        x_s = device_s - self._anchor[0]
        return self._anchor[1] + (x_s + (self._touched[1] + self._slope * (x_s - self._touched[0])))

    def device_s(self, host_s: float) -> float:
        """Extended device time in seconds at a monotonic host time: the inverse of `host_s`."""
        assert self._anchor is not None, "no arrival has been observed yet"
        touched_s, gain_s = self._touched
        since_s = host_s - self._anchor[1] - touched_s - gain_s
        return self._anchor[0] + (touched_s + since_s / self.pace)

    def _fit(self, x_s: float) -> None:
        hull = self._hulls[0]
        slope = hull.slope(self._expected, self._max_slope / DRIFT_SIGMAS)
        self._slope = min(max(slope, -self._max_slope), self._max_slope)
        self._touched = hull.touched(self._slope)
        self._fitted_s = x_s
        self._late_s = max(LATE_S, LATE_DELAYS * hull.delay_s)


class HostClock(DeviceClock):
    """The host's own clock, of samples that it asks for at times that it knows: nothing is to be learnt."""

    def observe(self, device_s: float, arrival_s: float) -> None:
        """Nothing to observe: it shows the host's time."""

    def account(self, device: str) -> dict[str, object]:
        """Nothing: it does not drift."""
        return {}

    def host_s(self, device_s: float) -> float:
        """What it shows."""
        return device_s
