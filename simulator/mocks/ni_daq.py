"""A device with analog inputs on the mock bench: the real driver on its emulated twin, without the maker's library."""

from typing import Any

from drivers.core.messages import Command, Excite, Listen, Tone
from drivers.ni_daq.driver import NiDaq
from drivers.ni_daq.link import DaqBlock
from simulator.devices.ni_daq import EmulatedNiDaq
from simulator.mocks.base import MemoryLine, OverMemory


class DaqMemory(MemoryLine):
    """What `drivers.ni_daq.link.DaqLink` and its `DaqOutput` are, to an emulated device in the process."""

    found = ("simulated analog inputs", "")

    def __init__(self, device: EmulatedNiDaq, settings: Any, clock: Any, faults: Any) -> None:
        super().__init__(device, clock, faults)
        self._settings = settings
        self.least_v = -settings.drive.limit_v if settings.drive else 0.0
        self.range_v = -device.range_v, device.range_v
        self._done: list[tuple[Command, float]] = []

    @property
    def output(self) -> Any:
        """See `DaqLink.output`."""
        return self if self._settings.drive else None

    def order(self, command: Command) -> None:
        """See `DaqOutput.order`."""
        drive, now_s = self._settings.drive, self._clock.now()
        match command:
            case Excite(on=on):
                self._device.drive(drive.on_v if on else 0.0, now_s)
            case Tone(level=level):
                self._device.drive(drive.limit_v * level, now_s)
        self._done.append((command, self._clock.monotonic_s()))

    def done(self) -> list[tuple[Command, float]]:
        """See `DaqOutput.done`."""
        done, self._done = self._done, []
        return done

    def off(self) -> None:
        """See `DaqLink.off`."""
        self._device.drive(0.0, self._clock.now())

    def close(self) -> None:
        """See `DaqLink.close`."""
        self.off()

    def receive(self) -> Any:
        """See `DaqLink.receive`."""
        t_s, blocks, n = self._fail(), [], self._settings.block
        while self.fault is None and (due_s := self._device.due_s(n)) <= t_s:
            first, values = self._device.next, self._device.take(due_s)
            if self.faults.active(t_s, "full_scale"):
                values[:] = self._device.range_v
            if not self.faults.active(t_s, "silent", "lose", "corrupt"):
                blocks.append(DaqBlock(first, values, self._clock.monotonic_s() - (t_s - due_s)))
        return blocks


class MockNiDaq(OverMemory, NiDaq):
    """The real driver in virtual time; its device samples only while it is listened to."""

    _far_end = EmulatedNiDaq

    def _switch_on(self, *_: object) -> Any:
        self._twin = EmulatedNiDaq(self._settings, self._bench)
        self._twin.take(self._clock.now())
        self._twin.watch(False, self._clock.now())
        return DaqMemory(self._twin, self._settings, self._clock, self._faults)

    def _carry_out(self, command: Command) -> None:
        super()._carry_out(command)
        if isinstance(command, Listen):
            self._twin.watch(bool(self._listening), self._clock.now())
