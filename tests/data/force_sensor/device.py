"""The force sensor of a mock or emulated bench: its far end, and the real driver on that in one process."""

import math
from typing import Any

import numpy as np

from touchbench import LineBuffer, OverMemory

from .driver import COUNTER_MODULUS, ForceSensor, encode, text_of

RATE_HZ = 100.0

NEWTON_PER_COUNT = 0.0001

TOWARDS = (-1.0, 0.0, 0.0)
"""Direction in which the tool presses on it, unit vector: compression is positive."""


class EmulatedForceSensor:
    """Answers as the sensor does: bytes in, bytes out, time from outside. It feels what the bench does to its tool."""

    def __init__(self, settings: object, bench: Any) -> None:
        self._bench = bench
        self._lines = LineBuffer(64)
        self._next: int | None = None

    @property
    def due_s(self) -> float:
        """When its next sample is due."""
        return math.inf if self._next is None else self._next / RATE_HZ

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take bytes from the host at `t_s`; returns its answers."""
        sent = self.step(t_s)
        for line in self._lines.feed(data):
            command = text_of(line)
            if command == "id":
                sent += encode(f"id FS1 0042 {RATE_HZ:g} {NEWTON_PER_COUNT:g}")
            else:
                self._bench.feel(command == "go")
                self._next = math.floor(t_s * RATE_HZ) + 1 if command == "go" else None
                sent += encode(f"ok {command}")
        return sent

    def step(self, t_s: float) -> bytes:
        """Samples sent by `t_s`."""
        sent = b""
        while self._next is not None and self.due_s <= t_s:
            self._bench.advance(self.due_s)
            force_n = self._bench.wrench(np.array([self.due_s]), TOWARDS)[0, 0]
            counter, time_ms = self._next % COUNTER_MODULUS, round(self._next * 1e3 / RATE_HZ)
            sent += encode(f"s {counter} {time_ms} {round(force_n / NEWTON_PER_COUNT)}")
            self._next += 1
        return sent

    def inject(self, kind: str, t_s: float) -> None:
        """It simulates no faults."""
        raise ValueError(f"a force sensor has no fault {kind}")


class MockForceSensor(OverMemory, ForceSensor):
    """The real driver on the emulated sensor."""

    _far_end = EmulatedForceSensor
