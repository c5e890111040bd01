"""The vendor's own client, `Spectral-BLDC`, judges the emulated gripper over slcan on a pty.

It takes the two object bits for each other: no test here distinguishes 1 from 2.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from can.interfaces.slcan import slcanBus

from simulator.devices.can_gripper import EmulatedCanGripper
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import put
from tests.wire.conftest import HURRY, Hurried

spectral = pytest.importorskip("Spectral_BLDC.Spectral_BLDC", reason="the vendor's client is not installed")

pytestmark = pytest.mark.filterwarnings("ignore:.*bustype:DeprecationWarning")


class Judge:
    """The client with the emulated gripper at the other end."""

    def __init__(self, serve: Any) -> None:
        self.drive = JawsDrive(0.008)
        self.gripper = EmulatedCanGripper(self.drive, heartbeat_s=math.inf)
        self.clock = serve.clock
        port = serve(Hurried(EmulatedSlcan(self.gripper)))
        self.lock = serve.lock(port)
        self.line = spectral.CanCommunication(bustype="slcan", channel=port, bitrate=1_000_000)
        self.motor = spectral.SpectralCAN(node_id=0, communication=self.line)

    def receive(self) -> Any:
        """The next answer, unpacked; the frame's identifier as the client takes it apart."""
        message, identifier = self.line.receive_can_messages(timeout=100.0)  # on the wall's clock
        assert message is not None
        self.motor.UnpackData(message, identifier)
        return identifier

    def poll(self) -> Any:
        self.motor.Send_gripper_data_pack()
        return self.receive()

    def until(self, condition: Callable[[], bool]) -> None:
        until_s = self.clock.monotonic_s() + 10.0
        self.poll()
        while not condition():
            assert self.clock.monotonic_s() < until_s, vars(self.motor)
            self.clock.rest(0.01)
            self.poll()

    def calibrate(self) -> None:
        self.motor.Send_Clear_Error()
        self.motor.Send_gripper_calibrate()
        self.until(lambda: self.motor.gripper_calibrated == 1)

    def drive_to(self, position: int, current_ma: int = 500) -> None:
        self.motor.Send_gripper_data_pack(position, 80, current_ma, 1, 1, 0, 0)
        self.receive()


@pytest.fixture
def judge(serve: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Judge]:
    # The client cannot keep python-can from waiting two seconds when it opens the port.
    with monkeypatch.context() as opening:
        opening.setattr("can.interfaces.slcan.time.sleep", lambda seconds: None)
        made = Judge(serve)
    yield made
    assert isinstance(made.line.bus, slcanBus)
    made.line.bus.shutdown()


def test_it_calibrates_opens_and_closes(judge: Judge) -> None:
    judge.calibrate()
    assert judge.motor.gripper_position == 255
    judge.drive_to(100)
    judge.until(lambda: judge.motor.gripper_object_detection == 3)
    assert judge.motor.gripper_position in (99, 100, 101)
    assert (judge.motor.gripper_activated, judge.motor.gripper_action_status) == (1, 1)


def test_it_finds_an_object_and_its_current(judge: Judge) -> None:
    judge.calibrate()
    judge.drive_to(0)
    judge.until(lambda: judge.motor.gripper_object_detection == 3)
    with judge.lock:
        put(judge.drive, 0.030)
    judge.drive_to(255, 600)
    judge.until(
        lambda: judge.motor.gripper_object_detection in (1, 2) and judge.motor.gripper_current == -600
    )
    assert judge.motor.gripper_position < 255
    pressed_n = pytest.approx(600 * 0.0462, abs=0.6)
    judge.until(lambda: judge.drive.contact_n == pressed_n)  # the blow has to die away


def test_it_sees_a_watchdog_fault_and_clears_it(judge: Judge) -> None:
    judge.calibrate()
    judge.motor.Send_Watchdog(1000, "Hold")
    assert judge.poll().error_bit == 0
    judge.clock.rest(1.5 / HURRY)
    assert judge.poll().error_bit == 1
    assert judge.motor.gripper_timeout_error == 1
    judge.motor.Send_Respond_State_of_Errors()
    judge.receive()
    assert (judge.motor.error, judge.motor.watchdog_error, judge.motor.calibrated) == (1, 1, 1)
    judge.motor.Send_Watchdog(0)
    judge.motor.Send_Clear_Error()
    assert judge.poll().error_bit == 0
    assert judge.motor.gripper_calibrated == 1


def test_it_sees_an_emergency_stop(judge: Judge) -> None:
    judge.motor.Send_ESTOP()
    assert judge.poll().error_bit == 1
    judge.motor.Send_Respond_State_of_Errors()
    judge.receive()
    assert judge.motor.estop_error == 1


def test_its_questions_are_answered(judge: Judge) -> None:
    motor = judge.motor
    motor.Send_Respond_Device_Info()
    judge.receive()
    assert (motor.HARDWARE_VERSION, motor.SOFTWARE_VERSION, motor.SERIAL_NUMBER) == (2, 1, 4848)
    motor.Send_Respond_Temperature()
    judge.receive()
    assert motor.temperature == 31
    motor.Send_Respond_Voltage()
    judge.receive()
    assert motor.voltage == 24_000
    motor.Send_Respond_Iq_data()
    judge.receive()
    assert motor.current == 0
    motor.Send_Respond_Encoder_data()
    judge.receive()
    assert motor.position > 4321
    motor.Send_Respond_Ping()
    judge.receive()
    assert motor.ping == 1


def test_its_heartbeats_come(judge: Judge) -> None:
    judge.motor.Send_Heartbeat_Setup(200)
    for _ in range(3):
        judge.receive()
        assert judge.motor.heartbeat == 1
