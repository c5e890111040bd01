"""The real driver on an emulated gripper, in virtual time: a link without a bus."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivers.can_gripper.brackets import CanGripperSettings
from drivers.can_gripper.driver import CanGripper
from drivers.core.can_frame import CanFrame
from drivers.core.can_link import PeriodicQuestion, ReceivedFrame
from drivers.core.clock import WallClock
from drivers.core.messages import Command, DeviceInfo, SampleBlock, Status
from simulator.devices.can_gripper import EmulatedCanGripper
from simulator.physics.jaws_drive import JawsDrive

TURN_S = 0.005
DELAY_S = 0.0002
"""From a question to its answer: what a slcan adapter was measured to take."""

FRAME_S = 0.0001
"""How long a frame is on the bus: some hundred bits at 1 Mbit/s."""


class Host:
    """Time, and the far end of the link."""

    def __init__(self, gripper: EmulatedCanGripper, begin_s: float) -> None:
        self.gripper = gripper
        self.now_s = begin_s
        self.sent: list[CanFrame] = []
        self.spoil: Callable[[CanFrame], CanFrame | None] = lambda frame: frame
        self.late_s = 0.0
        """How much later answers come than they do."""

        self.fault: str | None = None
        self.malformed = 0
        self.closed = False
        self._due: list[ReceivedFrame] = []

    def open(self, *_: object) -> Any:
        self.closed = False
        return self

    def advance(self, seconds: float) -> None:
        self.now_s += seconds
        self._keep(self.gripper.step(self.now_s))

    def send(self, frame: CanFrame) -> float | None:
        if self.fault is not None:
            return None
        self.sent.append(frame)
        self.now_s += FRAME_S
        self._keep(self.gripper.receive(frame, self.now_s))
        return self.now_s

    def receive(self) -> list[ReceivedFrame]:
        received = [one for one in self._due if one.arrival_s <= self.now_s]
        self._due = [one for one in self._due if one.arrival_s > self.now_s]
        return received

    def ask(self, question: PeriodicQuestion | None) -> None:
        raise AssertionError("the gripper does not poll by the link's thread")

    def close(self) -> None:
        self.closed = True

    def _keep(self, frames: list[CanFrame]) -> None:
        for frame in frames:
            spoilt = self.spoil(frame)
            if spoilt is not None:
                arrival_s = self.now_s + DELAY_S + self.late_s
                if self._due:  # none overtakes another
                    arrival_s = max(arrival_s, self._due[-1].arrival_s)
                self._due.append(ReceivedFrame(spoilt, arrival_s))


class HostClock(WallClock):
    """Bench time that begins with the host's."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._origin_s = host.now_s

    def now(self) -> float:
        return self._host.now_s - self._origin_s

    def monotonic_s(self) -> float:
        return self._host.now_s

    def rest(self, seconds: float) -> None:
        self._host.advance(seconds)


class Bench:
    """Driver, emulated gripper, jaws."""

    def __init__(self, host: Host, drive: JawsDrive, settings: CanGripperSettings) -> None:
        self.host = host
        self.drive = drive
        self.clock = HostClock(host)
        self.driver = CanGripper("gripper", settings, self.clock, host.open)
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def open(self) -> DeviceInfo:
        return self.driver.open()

    def apply(self, command: Command) -> None:
        self.driver.apply(command)

    def turn(self, seconds: float) -> None:
        until_s = self.host.now_s + seconds
        while self.host.now_s < until_s:
            self.host.advance(TURN_S)
            self.blocks += self.driver.read()
            self.statuses += self.driver.poll()

    def take(self, kind: type[Status]) -> list[Status]:
        found = [status for status in self.statuses if isinstance(status, kind)]
        self.statuses = [status for status in self.statuses if not isinstance(status, kind)]
        return found

    def place(self, name: str | None) -> None:
        self.drive.jaws.place(name)
        self.drive.disturb()
