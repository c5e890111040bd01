"""How the emulator lets bench time pass: with the wall, but never past a client that takes part."""

from __future__ import annotations

import math

from drivers.core.clock import monotonic_s
from simulator.wiring.bench_clock import LOOK_S, PATIENCE_S, ClockPage

AHEAD_S = 0.004
"""How far time may go beyond the devices' last step: they are this much late at the most (assumption: two steps)."""

UNREAD_S = 0.004
"""How long bytes may lie unread at the host before time waits for them (assumption: as long as a thread may sleep)."""


PUNCTUAL_S = 0.01
"""How much later than meant the emulator turns on a machine that serves it (assumption: a busy one delays it by up to
this)."""


class Pace:
    """Writes the time of a bench.

    Args:
        free: Time passes with the wall, however late the clients: to measure what a machine can do.

    Attributes:
        page: Where it is written.
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

    def wait_s(self, due_s: float) -> float:
        """How long of the wall's time to wait until bench time may be `due_s`."""
        left_s = due_s - self.page.time_s(monotonic_s())
        wait_s = max(left_s, LOOK_S if due_s > self._limit_s else 0.0)
        self._meant_s += wait_s
        return wait_s
