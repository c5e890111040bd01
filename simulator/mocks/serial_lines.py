"""A board of the mock bench that prints lines: the real driver on its emulated twin."""

from typing import Any

from drivers.core.messages import Command, DeviceInfo
from drivers.serial_lines.driver import SerialLines
from simulator.devices.serial_lines import EmulatedSerialLines
from simulator.mocks.base import OverMemory


class MockSerialLines(OverMemory, SerialLines):
    """The real driver in virtual time; its board prints only while it is listened to."""

    _far_end = EmulatedSerialLines
    settled = (0.0, 1)

    def _identify(self, link: Any) -> DeviceInfo:
        info = super()._identify(link)
        self._watch()
        return info

    def _carry_out(self, command: Command) -> None:
        super()._carry_out(command)
        self._watch()

    def _watch(self) -> None:
        self._twin.watch(bool(self._listening), self._clock.now())
