"""A real driver and an emulated device in one process, in virtual time: each write is answered at once."""

from __future__ import annotations

import math
from typing import Any

from drivers.core.clock import Clock
from simulator.devices.faults import FaultSchedule, corrupted, inject_begun


class MemoryLine:
    """What `drivers.core.links.SerialLink` is, to an emulated device without a port.

    The device lives in bench time, which begins anew with every trial; what it sends arrives in monotonic time: when it
    is read, or where the device has a `due_s`, the time at which it next sends on its own, at that time, however
    seldom it is read.

    Args:
        device: The far end: `receive(data, t_s)` and `step(t_s)`, both bytes out, and `inject(kind, t_s)`.
        clock: Of both ends.
        faults: What goes wrong with the device and its line, and when.

    Attributes:
        faults: The same.
        fault: Why the line is gone, or None.
    """

    def __init__(self, device: Any, clock: Clock, faults: FaultSchedule | None = None) -> None:
        self.fault: str | None = None
        self._device = device
        self._clock = clock
        self.faults = faults or FaultSchedule()
        self._arrived: list[tuple[float, bytes]] = []

    def connect(self, *_: object) -> Any:
        """What `open_serial` is, for this line; it is whole again."""
        self.fault = None
        self._arrived = []
        return self

    def send(self, data: bytes) -> float | None:
        """See `SerialLink.send`."""
        t_s = self._fail()
        if self.fault is not None:
            return None
        self._catch_up(t_s)
        self._take(self._device.receive(data, t_s), t_s)
        return self._clock.monotonic_s()

    def receive(self) -> list[tuple[float, bytes]]:
        """See `SerialLink.receive`."""
        t_s = self._fail()
        if self.fault is None:
            self._catch_up(t_s)
            self._take(self._device.step(t_s), t_s)
        taken, self._arrived = self._arrived, []
        return taken

    def close(self) -> None:
        """See `SerialLink.close`."""

    def _fail(self) -> float:
        """Let the faults happen that have begun; what time it is."""
        t_s = self._clock.now()
        if self.faults.begun(t_s, "unplug"):
            self.fault = "the port was taken away"
        inject_begun(self.faults, self._device, t_s, t_s)
        return t_s

    def _catch_up(self, t_s: float) -> None:
        """Take what was sent before `t_s`, each at its time."""
        while (due_s := getattr(self._device, "due_s", math.inf)) < t_s:
            self._take(self._device.step(due_s), due_s)

    def _take(self, data: bytes, t_s: float) -> None:
        data = corrupted(self.faults, data, t_s)
        if data:
            self._arrived.append((self._clock.monotonic_s() - (self._clock.now() - t_s), data))
