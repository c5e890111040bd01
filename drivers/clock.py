"""The only place that asks what time it is."""

from __future__ import annotations

import math
import time
from datetime import UTC, datetime
from typing import Protocol


class Clock(Protocol):
    """Bench time: seconds since the present trial began."""

    virtual: bool
    """True where nothing happens unless the loop says so, and waiting costs nothing."""

    def now(self) -> float:
        """Bench time in seconds."""

    def wait_until(self, t_s: float) -> None:
        """Come back at bench time `t_s`, at once where that has passed."""

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""


class WallClock:
    """The host's monotonic clock."""

    virtual = False

    def __init__(self) -> None:
        self._origin_s = time.monotonic()

    def now(self) -> float:
        """Bench time in seconds."""
        return time.monotonic() - self._origin_s

    def from_monotonic(self, monotonic_s: float) -> float:
        """Bench time of a reading of `time.monotonic` (`CLOCK_MONOTONIC`)."""
        return monotonic_s - self._origin_s

    def wait_until(self, t_s: float) -> None:
        """Sleep until bench time `t_s`."""
        remaining_s = t_s - self.now()
        if remaining_s > 0:
            time.sleep(remaining_s)

    def restart(self) -> None:
        """Bench time is zero again."""
        self._origin_s = time.monotonic()


class VirtualClock:
    """Time that jumps: waiting sets the clock."""

    virtual = True

    def __init__(self) -> None:
        self._now_s = 0.0

    def now(self) -> float:
        """Bench time in seconds."""
        return self._now_s

    def wait_until(self, t_s: float) -> None:
        """Jump to bench time `t_s`."""
        self._now_s = max(self._now_s, t_s)

    def restart(self) -> None:
        """Bench time is zero again."""
        self._now_s = 0.0


def utc_now() -> datetime:
    """Calendar time: for the names of run folders and manifests, never for measurements."""
    return datetime.now(UTC)


def monotonic_s() -> float:
    """The host's monotonic clock: for arrivals in reader threads and for progress bars."""
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
