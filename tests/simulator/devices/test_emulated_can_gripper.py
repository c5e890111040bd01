"""The emulated gripper's habits, in the bytes of docs/reference/grippers.md."""

import math

import pytest

from drivers.core.can_frame import CanFrame
from simulator.devices.can_gripper import EmulatedCanGripper
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import put

POLL = CanFrame(0x7A)
CLEAR = CanFrame(0x02)
CALIBRATE = CanFrame(0x7C)
CLOSE = CanFrame(0x7A, bytes.fromhex("FF 40 01 F4 C0"))
OPEN = CanFrame(0x7A, bytes.fromhex("00 40 01 F4 C0"))


class Bus:
    """One gripper, and time."""

    def __init__(self) -> None:
        self.drive = JawsDrive(0.008)
        self.gripper = EmulatedCanGripper(self.drive, heartbeat_s=math.inf)
        self.t_s = 100.0
        self.gripper.step(self.t_s)

    def send(self, frame: CanFrame) -> list[CanFrame]:
        return self.gripper.receive(frame, self.t_s)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self.t_s += 0.01
            assert self.gripper.step(self.t_s) == []

    def poll(self) -> CanFrame:
        (answer,) = self.send(POLL)
        return answer


@pytest.fixture
def bus() -> Bus:
    made = Bus()
    assert made.send(CALIBRATE) == []
    made.wait(3.0)
    return made


def flags(frame: CanFrame) -> int:
    return frame.data[3]


def test_a_drive_is_answered_with_the_state_before_it(bus: Bus) -> None:
    (answer,) = bus.send(OPEN)
    assert (answer.id, answer.data[0]) == (0x78, 255)


def test_a_grip_ends_in_the_object_bit_that_the_firmware_sets_first(bus: Bus) -> None:
    bus.send(OPEN)
    bus.wait(1.0)
    assert bus.poll().data == bytes([0, 0, bus.poll().data[2], 0xF1])
    put(bus.drive, 0.040)
    bus.send(CLOSE)
    bus.wait(1.0)
    state = bus.poll()
    assert flags(state) == 0xE1
    assert int.from_bytes(state.data[1:3], "big", signed=True) == -500


def test_neither_calibration_nor_clearing_feeds_the_watchdog(bus: Bus) -> None:
    bus.send(CanFrame(0x1E, bytes.fromhex("00 00 01 F4 00")))
    for order in (CLEAR, CALIBRATE):
        bus.wait(0.2)
        bus.send(order)
    bus.wait(0.2)
    assert bus.poll().id == 0x79


def test_an_emergency_stop_in_a_drive_stays_until_a_drive_without_it(bus: Bus) -> None:
    bus.send(CanFrame(0x7A, bytes.fromhex("00 40 01 F4 E0")))
    assert flags(bus.poll()) & 0x02
    bus.send(CLEAR)
    assert bus.poll().id == 0x79
    bus.send(CanFrame(0x7A, bytes.fromhex("00 40 01 F4 00")))
    bus.send(CLEAR)
    assert bus.poll().id == 0x78


def test_no_order_moves_a_gripper_with_a_fault(bus: Bus) -> None:
    bus.gripper.inject("overheat", bus.t_s)
    bus.send(OPEN)
    bus.wait(0.5)
    assert bus.poll().data[0] == 255
    assert flags(bus.poll()) & 0x08


def test_a_drive_breaks_a_calibration_off() -> None:
    bus = Bus()
    bus.send(CALIBRATE)
    bus.wait(0.5)
    bus.send(CLOSE)
    bus.wait(4.0)
    assert flags(bus.poll()) & 0x01 == 0


def test_a_heartbeat_comes_when_nothing_else_has_been_sent_for_a_second() -> None:
    gripper = EmulatedCanGripper(JawsDrive(0.008), node=2)
    assert gripper.step(0.0) == []
    assert gripper.step(0.9) == []
    assert gripper.step(1.0) == [CanFrame(0x112)]
    gripper.receive(CanFrame(0x17A), 1.5)
    assert gripper.step(2.4) == []
    assert gripper.step(2.5) == [CanFrame(0x112)]


def test_frames_for_other_nodes_and_truncated_ones_are_passed_over(bus: Bus) -> None:
    assert bus.send(CanFrame(0xFA)) == []
    assert bus.send(CanFrame(0x7A, bytes(4))) == []
