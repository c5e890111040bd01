"""What mock drivers share, those over a line in memory and those by hand; faults begin when the scene sets them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from drivers.core.clock import Clock
from drivers.core.messages import SampleBlock, Status
from drivers.core.wire import Driver, WireDriver
from simulator.devices.faults import FaultSchedule
from simulator.devices.memory_line import MemoryLine


class OverMemory(WireDriver[Any]):
    """A real driver as the mock of its device, over a line in memory: `class MockX(OverMemory, X)`.

    Its far end is switched on anew at each trial, and the driver opened. That takes none of the trial's time where the
    far end answers at once. Faults begin after it.

    Args:
        settings: `MockXSettings`: the real one's, without a port.
        bench: What the far end is wired to.
        faults: What goes wrong, and when.
    """

    _far_end: Callable[[Any, Any], Any]
    """Makes the far end of the settings and the bench."""

    def __init__(
        self, name: str, settings: Any, clock: Clock, bench: Any, faults: FaultSchedule | None = None
    ) -> None:
        self._bench = bench
        self._faults = faults or FaultSchedule()
        super().__init__(name, settings, clock, self._switch_on)

    def _switch_on(self, *_: object) -> MemoryLine:
        self._twin = type(self)._far_end(self._settings, self._bench)
        return MemoryLine(self._twin, self._clock, self._faults)

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        if self._link is not None:
            faults, self._faults = self._faults, FaultSchedule()
            self.open()
            self._faults = self._link.faults = faults


class MockDriver(Driver):
    """A device in the process.

    Args:
        settings: Of the device: `MockXSettings` beside `MockX`.
        bench: What the device is wired to.
        faults: What goes wrong, and when.

    Raises:
        RefusedError: the bench has not what the device needs.
    """

    def __init__(
        self, name: str, settings: Any, clock: Clock, bench: Any, faults: FaultSchedule | None = None
    ) -> None:
        super().__init__(name, clock)
        self._settings, self._bench = settings, bench
        self._faults = faults or FaultSchedule()
        self._wire()
        self.restart()

    def _wire(self) -> None:
        """Be wired to the bench; raises `RefusedError`."""

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._statuses = []
        self._faults.restart()

    def close(self) -> None:
        """Nothing to release."""

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        failed = self._faults.failure(self._clock.now(), self.name)
        if failed is not None:
            self._cut_off(failed.t_s)
            self._report(failed)
        return super().poll()

    def _cut_off(self, now_s: float) -> None:
        """What the device does by itself once its link is gone."""

    def _gone(self, now_s: float) -> bool:
        """Whether nothing passes its link."""
        return self._faults.active(now_s, "silent") or self._faults.active(now_s, "unplug")

    def _garbled(self, now_s: float) -> bool:
        """Whether nothing that it sends arrives whole."""
        return self._faults.active(now_s, "lose") or self._faults.active(now_s, "corrupt")


class MockSensor(MockDriver):
    """A sensor in the process: what it samples may be lost on the way."""

    def _arrived(self, blocks: Sequence[SampleBlock], now_s: float) -> Sequence[SampleBlock]:
        """What the faults let through of what was sampled."""
        if self._gone(now_s):
            return ()
        if self._garbled(now_s):
            for block in blocks:
                self._lost(now_s, block.stream, len(block))
            return ()
        return blocks
