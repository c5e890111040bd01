"""Opening a driver on a bus with another device, or without the port: one error each."""

from typing import Any

import pytest

from drivers.barrett_hand.driver import BarrettHand, BarrettHandSettings
from drivers.can_gripper.driver import CanGripper, CanGripperSettings
from drivers.core.clock import Clock
from drivers.core.errors import ProtocolError
from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from drivers.operator.driver import Person, PersonSettings
from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from drivers.zaber_stage.driver import ZaberStage
from drivers.zaber_stage.mounting import ZaberStageSettings

DRIVERS: dict[str, tuple[Any, Any]] = {
    "board": (SensorBoard, SensorBoardSettings),
    "dsa": (DsaMatrix, DsaMatrixSettings),
    "gripper": (CanGripper, CanGripperSettings),
    "hand": (BarrettHand, BarrettHandSettings),
    "operator": (Person, PersonSettings),
    "stage": (ZaberStage, ZaberStageSettings),
}


def open_at(name: str, port: str, clock: Clock) -> None:
    driver, settings = DRIVERS[name]
    driver(name, settings(port=port), clock).open()


class Other:
    """Answers everything with a line."""

    def __init__(self, line: bytes) -> None:
        self._line = line

    def receive(self, data: bytes, t_s: float) -> bytes:
        return self._line

    def step(self, t_s: float) -> bytes:
        return b""


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("gripper", b"t@01 0 RJ IDLE -- BADCOMMAND\r\n", "malformed"),
        ("hand", b"t0780\r", "is a BarrettHand on this bus"),
    ],
)
def test_another_device_on_the_bus_is_not_opened(serve: Any, name: str, line: bytes, message: str) -> None:
    port = serve(Other(line))
    with pytest.raises(ProtocolError, match=message):
        open_at(name, port, serve.clock)
