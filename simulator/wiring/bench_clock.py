"""The clock of an emulated bench: a page of memory that the program, the arm's process and the emulator share.

The emulator advances bench time with wall time (`simulator.wiring.bench_clock`), but no further than every participant
allows. So a machine that delays a process or a thread slows the bench down, and no watchdog, timeout or limit counts
that delay.

A thread that waits on the clock takes part from then on: each call sets how far time may advance before its next one.
A thread that makes none for `PATIENCE_S` of wall time no longer holds time back, until it calls again: a loop that
hangs is caught by the guard and by the devices' watchdogs as on a real bench.
"""

from __future__ import annotations

import fcntl
import math
import mmap
import os
import threading

from drivers.core.clock import Clock, monotonic_s, rest

SLACK_S = 0.004
"""How far bench time may go beyond the instant for which a thread waits, or at which it came back. Assumption: less
than a turn of a loop of 200 Hz, more than a thread needs to wake up on a machine that is not busy."""

PATIENCE_S = 1.0
"""How long, in wall time, the bench waits for a thread that does not turn, not counting the time for which the emulator
itself is held up. Assumption: longer than a busy machine holds one process up and
serves another, and short enough for a watching person."""

PREPARING_S = 20.0
"""How long it waits for a trial that is being prepared (assumption: nothing moves, and a plant may have to be made)."""

ABSENCE_S = 5.0
"""How long time stands still for an emulator that is away: one that is dead must not hold the loop for ever, one that
rebuilds a plant (1 s, measured) has lost no time."""

FORGOTTEN_S = 10.0
"""A place whose thread has been silent for so long is given to another (assumption)."""

LOOK_S = 0.0005
"""Time between two looks at a bench time that is behind the wall's (assumption: a tenth of a turn at 200 Hz)."""

RENEW_S = 0.25
"""A waiting thread renews its limit this often: a quarter of the patience."""

PLACES = 32
"""How many threads may take part (assumption: four times what the largest profile has)."""

_AWAY, _FIRST = 7, 8
# Doubles before the first place: count, two copies of (bench time, wall time, limit), how long the emulator was away.


class ClockPage:
    """Bench time as a function of wall time, and the limits that the participating threads set.

    One process writes the time, each thread writes its own place. The time is written beside the copy that is read,
    and then the count that selects the copy: no reader waits, and a writer that was killed leaves the page whole.

    Args:
        path: Of a page that another process has made; "" makes one, which lives as long as its maker.

    Attributes:
        path: Where another process finds it.

    Raises:
        OSError: it is not there.
    """

    def __init__(self, path: str = "") -> None:
        if path:
            self._file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            self.path = path
        else:
            self._file = os.memfd_create("touchbench-clock")
            os.ftruncate(self._file, mmap.PAGESIZE)
            self.path = f"/proc/{os.getpid()}/fd/{self._file}"
        # Aligned writes of eight bytes are atomic: no reader sees half a number.
        self._cells = memoryview(mmap.mmap(self._file, mmap.PAGESIZE)).cast("d")
        if not path:
            self.write(0.0, monotonic_s(), 0.0)
            for place in range(PLACES):
                self.allow(place, math.inf)

    def time_s(self, wall_s: float) -> float:
        """Bench time at a time of the wall's."""
        cells = self._cells
        while True:
            count = cells[0]
            at = 1 + 3 * (int(count) & 1)
            t_s, written_s, limit_s = cells[at], cells[at + 1], cells[at + 2]
            if cells[0] == count:
                passed_s = wall_s - written_s
                return min(t_s + passed_s, limit_s + max(0.0, passed_s - ABSENCE_S))

    def write(self, t_s: float, wall_s: float, limit_s: float) -> None:
        """It is bench time `t_s`, and time passes with the wall as far as `limit_s`."""
        cells, count = self._cells, self._cells[0] + 1.0
        at = 1 + 3 * (int(count) & 1)
        cells[at], cells[at + 1], cells[at + 2] = t_s, wall_s, limit_s
        cells[0] = count

    def served_s(self, wall_s: float) -> float:
        """The wall's time without what passed while the emulator was held up: in it patience is counted."""
        return wall_s - self._cells[_AWAY]

    def away(self, seconds: float) -> None:
        """The emulator was held up for so long."""
        self._cells[_AWAY] += seconds

    def limit_s(self, wall_s: float) -> float:
        """How far all participants let bench time advance; infinity without any."""
        served_s = self.served_s(wall_s)
        limits = self._cells[_FIRST : _FIRST + 2 * PLACES].tolist()
        return min(
            (limits[k] for k in range(0, 2 * PLACES, 2) if limits[k] < math.inf and limits[k + 1] > served_s),
            default=math.inf,
        )

    def take(self) -> int:
        """Take a free place."""
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            served_s = self.served_s(monotonic_s())
            for place in range(PLACES):
                at = _FIRST + 2 * place
                if self._cells[at] == math.inf or self._cells[at + 1] < served_s - FORGOTTEN_S:
                    self.allow(place, served_s)
                    return place
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)
        raise RuntimeError(f"more than {PLACES} threads wait on this bench")

    def allow(self, place: int, horizon_s: float, patience_s: float = PATIENCE_S) -> None:
        """Let bench time advance to `horizon_s`, and no further before the next call; infinity leaves the place."""
        at = _FIRST + 2 * place
        self._cells[at + 1] = self.served_s(monotonic_s()) + patience_s
        self._cells[at] = horizon_s

    def __reduce__(self) -> tuple[type[ClockPage], tuple[str]]:
        return ClockPage, (self.path,)


class BenchClock(Clock):
    """Bench time of an emulated bench."""

    def __init__(self, page: ClockPage) -> None:
        self._page = page
        self._mine = threading.local()
        self._taking = threading.Lock()
        super().__init__()

    def __reduce__(self) -> tuple[type[BenchClock], tuple[ClockPage]]:
        return BenchClock, (self._page,)

    def monotonic_s(self) -> float:
        """See `Clock.monotonic_s`."""
        return self._page.time_s(monotonic_s())

    def wait_until(self, t_s: float) -> None:
        """See `Clock.wait_until`."""
        self._wait(self._origin_s + t_s)

    def rest(self, seconds: float) -> None:
        """See `Clock.rest`."""
        self._wait(self.monotonic_s() + seconds)

    def restart(self) -> None:
        """See `Clock.restart`: no time passes until the loop's first turn, for a trial is still being prepared."""
        self._origin_s = self.monotonic_s()
        self.hold(self._origin_s + SLACK_S, PREPARING_S)

    def hold(self, t_s: float, patience_s: float = PATIENCE_S) -> None:
        """See `Clock.hold`; the bench waits for `patience_s` of the wall's time."""
        place = getattr(self._mine, "place", None)
        if place is None:
            with self._taking:  # the lock on the page is between processes
                place = self._mine.place = self._page.take()
        self._page.allow(place, t_s, patience_s)

    def leave(self) -> None:
        """See `Clock.leave`."""
        place = getattr(self._mine, "place", None)
        if place is not None:
            self._page.allow(place, math.inf)
            self._mine.place = None

    def _wait(self, until_s: float) -> None:
        while (remaining_s := until_s - self.monotonic_s()) > 0.0:
            self.hold(until_s + SLACK_S)
            rest(min(max(remaining_s, LOOK_S), RENEW_S))
        self.hold(self.monotonic_s() + SLACK_S)


AHEAD_S = 0.004
"""How far time may go beyond the emulator's last turn (assumption: two steps). The devices' last step may be one step
older, for a turn that comes too early for the next one makes none: they are three steps late at the most."""

UNREAD_S = 0.004
"""How long bytes may lie unread at the host before time waits for them (assumption: as long as a thread may sleep)."""


PUNCTUAL_S = 0.01
"""How much later than meant the emulator turns on a machine that serves it (assumption: a busy one delays it by up to
this)."""


class Pace:
    """Writes the time of a bench.

    Args:
        free: Time passes with the wall, however late the clients: to measure what a machine can do.
    """

    def __init__(self, free: bool = False) -> None:
        self.page = ClockPage()
        self._free = free
        self._limit_s = 0.0
        self._meant_s = monotonic_s()
        """When it was to turn next."""
        self._unread: dict[str, tuple[float, float]] = {}
        """For each line with bytes that its host has not read: since when, in bench time and in served time."""

    @property
    def attended(self) -> bool:
        """Whether somebody waits on this clock."""
        return self.page.limit_s(monotonic_s()) < math.inf

    def turn(self, unread: frozenset[str] = frozenset()) -> float:
        """Let time go on.

        Args:
            unread: Lines at whose host's end bytes lie unread.

        Returns:
            Bench time.
        """
        wall_s = monotonic_s()
        t_s = self.page.time_s(wall_s)
        self.page.away(max(0.0, wall_s - self._meant_s - PUNCTUAL_S))
        self._meant_s = wall_s
        served_s = self.page.served_s(wall_s)
        self._unread = {line: self._unread.get(line, (t_s, served_s)) for line in unread}
        if self._free:
            limit_s = math.inf
        else:
            readers_s = (
                since_s + UNREAD_S
                for since_s, noticed_s in self._unread.values()
                if served_s - noticed_s < PATIENCE_S
            )
            limit_s = min(t_s + AHEAD_S, self.page.limit_s(wall_s), *readers_s)
        # What was allowed stays allowed: time never turns back.
        self._limit_s = max(self._limit_s, t_s, limit_s)
        self.page.write(t_s, wall_s, self._limit_s)
        return t_s

    def wait_s(self, due_s: float, least_s: float = 0.0) -> float:
        """How long of the wall's time to wait until bench time may be `due_s`, and `least_s` at least."""
        left_s = due_s - self.page.time_s(monotonic_s())
        wait_s = max(left_s, LOOK_S if due_s > self._limit_s else 0.0, least_s)
        self._meant_s += wait_s
        return wait_s
