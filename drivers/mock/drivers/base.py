"""What mock drivers share: commands are carried out at once, and faults begin when the scene says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivers.clock import Clock
from drivers.messages import SampleBlock, Status
from drivers.mock.devices.faults import FaultSchedule
from drivers.wire import Driver


class MockDriver(Driver):
    """A device in the process.

    Args:
        name: In the profile.
        settings: Of the device: `MockXSettings` beside `MockX`.
        clock: Bench time.
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
        """Nothing to let go of."""

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        failed = self._faults.failure(self._clock.now(), self.name)
        if failed is not None:
            self._cut_off(failed.t_s)
            self._say(failed)
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
