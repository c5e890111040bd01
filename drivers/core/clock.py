"""The only module that reads the time."""

import math
import time
from datetime import UTC, datetime


class Clock:
    """Time on a bench. Everything that waits, times out or time-stamps an arrival is given the bench's clock.

    Pickled for another process of this machine, it has the same monotonic time there.

    It counts twice: bench time restarts with every trial, monotonic time never does. Drivers and their threads keep
    monotonic times, which outlive a trial, and turn them into bench time where they hand samples and statuses out.

    Attributes:
        virtual: True where time advances only when the loop waits, and waiting costs nothing.
    """

    virtual = False

    def __init__(self) -> None:
        self._origin_s = self.monotonic_s()

    def monotonic_s(self) -> float:
        """Seconds since some instant before the first trial."""
        raise NotImplementedError

    def rest(self, seconds: float) -> None:
        """Come back after so many seconds of the bench."""
        raise NotImplementedError

    def now(self) -> float:
        """Bench time: seconds since the present trial began."""
        return self.monotonic_s() - self._origin_s

    def from_monotonic(self, monotonic_s: float) -> float:
        """Bench time of a monotonic time."""
        return monotonic_s - self._origin_s

    def wait_until(self, t_s: float) -> None:
        """Come back at bench time `t_s`, at once where that has passed."""
        self.rest(t_s - self.now())

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._origin_s = self.monotonic_s()

    def hold(self, t_s: float) -> None:
        """This thread makes its next call by monotonic `t_s`; a clock that can wait goes no further before it.

        `wait_until` and `rest` say this themselves, with a margin of a few milliseconds. Call it from a thread that
        waits for something else, or whose own work needs bench time to pass.
        """

    def leave(self) -> None:
        """Time may go on without this thread, until it waits or holds again."""


class WallClock(Clock):
    """The host's monotonic clock (`CLOCK_MONOTONIC`); nothing holds it."""

    def monotonic_s(self) -> float:
        """See `Clock.monotonic_s`."""
        return time.monotonic()

    def rest(self, seconds: float) -> None:
        """See `Clock.rest`."""
        if seconds > 0.0:
            time.sleep(seconds)


class VirtualClock(Clock):
    """Time that jumps: waiting sets the clock. Bench time is what is counted, exactly."""

    virtual = True

    def __init__(self) -> None:
        self._now_s = self._origin_s = 0.0

    def now(self) -> float:
        """See `Clock.now`."""
        return self._now_s

    def monotonic_s(self) -> float:
        """See `Clock.monotonic_s`."""
        return self._origin_s + self._now_s

    def wait_until(self, t_s: float) -> None:
        """See `Clock.wait_until`: time jumps there."""
        self._now_s = max(self._now_s, t_s)

    def rest(self, seconds: float) -> None:
        """See `Clock.rest`: time jumps there."""
        self.wait_until(self._now_s + seconds)

    def restart(self) -> None:
        """See `Clock.restart`."""
        self._origin_s += self._now_s
        self._now_s = 0.0


def utc_now() -> datetime:
    """Calendar time: for the names of run folders and manifests, never for measurements."""
    return datetime.now(UTC)


def monotonic_s() -> float:
    """The host's monotonic clock: for progress bars and writing to a disk, never for what happens on a bench."""
    return time.monotonic()


def last_tick(t_s: float, rate_hz: float) -> int:
    """Largest k with k / rate_hz <= t_s, to the last bit: a product would be off by one now and then."""
    k = math.floor(t_s * rate_hz)
    if (k + 1) / rate_hz <= t_s:
        return k + 1
    return k if k / rate_hz <= t_s else k - 1


def rest(seconds: float) -> None:
    """Do nothing for a while of real time: for a program that waits for a person or a port, not for a bench."""
    time.sleep(seconds)
