"""The real driver on an emulated gripper, in virtual time: a link without a bus."""

from collections.abc import Callable
from typing import Any

from drivers.can_gripper.codec import Order, decode_order
from drivers.can_gripper.driver import CanGripper, CanGripperSettings
from drivers.core.can_frame import CanFrame
from drivers.core.can_link import ReceivedFrame
from simulator.devices.can_gripper import EmulatedCanGripper
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import CLOSED_M, GripperBench
from tests.unit.drivers.far_end import FarClock, FarEnd

DELAY_S = 0.0002
"""From a question to its answer: what a slcan adapter was measured to take."""

FRAME_S = 0.0001
"""How long a frame is on the bus: some hundred bits at 1 Mbit/s."""


class GripperBus(FarEnd):
    """A bus with one gripper; a frame takes its time in both directions.

    Attributes:
        late_s: How much later answers come than they do.
        malformed: As of a `CanLink`.
    """

    def __init__(self, device: EmulatedCanGripper) -> None:
        super().__init__(device, lambda: 0.005)
        self.late_s = 0.0
        self.malformed = 0

    def send(self, data: CanFrame) -> float | None:
        if self.fault is None:
            self.t_s += FRAME_S
        return super().send(data)

    def receive(self) -> list[ReceivedFrame]:
        received = [one for one in self.arrived if one.arrival_s <= self.t_s]
        self.arrived = [one for one in self.arrived if one.arrival_s > self.t_s]
        return received

    def arrive(self, data: list[CanFrame]) -> None:
        for frame in filter(None, map(self.hush, data)):
            arrival_s = self.t_s + DELAY_S + self.late_s
            if self.arrived:  # none overtakes another
                arrival_s = max(arrival_s, self.arrived[-1].arrival_s)
            self.arrived.append(ReceivedFrame(frame, arrival_s))


class Bench(GripperBench):
    """A driver on an emulated gripper in virtual time, closed."""

    def __init__(self, drive: JawsDrive, **driver: Any) -> None:
        self.drive = drive
        self.bus = GripperBus(EmulatedCanGripper(drive))
        settings = {"port": "can0", "closed_width_m": CLOSED_M, **driver}
        clock = FarClock(self.bus)
        gripper = CanGripper("gripper", CanGripperSettings(**settings), clock, self.bus.connect)
        super().__init__(gripper, clock, lambda scene: scene(drive), opens=False)

    def orders(self, action: Callable[[], object]) -> list[Order]:
        """What is written meanwhile."""
        before = len(self.bus.written)
        action()
        return [decode_order(frame)[1] for frame in self.bus.written[before:]]

    def applied(self, *commands: object) -> list[Order]:
        """What is written for commands."""
        return self.orders(lambda: [self.device.apply(command) for command in commands])

    def inject(self, kind: str) -> None:
        self.bus.device.inject(kind, self.bus.t_s)
