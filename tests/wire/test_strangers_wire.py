"""Opening a driver at a port with another device, with none, or without the port: one error each."""

from typing import Any

import pytest

from drivers.barrett_hand.driver import BarrettHand, BarrettHandSettings
from drivers.can_gripper.driver import CanGripper, CanGripperSettings
from drivers.core.clock import Clock, WallClock
from drivers.core.errors import PortError, ProtocolError, SilentError
from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from drivers.operator.driver import Person, PersonSettings
from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from drivers.zaber_stage.driver import ZaberStage
from drivers.zaber_stage.mounting import ZaberStageSettings

DRIVERS: dict[str, tuple[Any, Any, dict[str, float]]] = {
    "board": (SensorBoard, SensorBoardSettings, {"reply_timeout_s": 0.1}),
    "dsa": (DsaMatrix, DsaMatrixSettings, {"reply_timeout_s": 0.1, "power_up_s": 0.3}),
    "gripper": (CanGripper, CanGripperSettings, {}),
    "hand": (BarrettHand, BarrettHandSettings, {}),
    "operator": (Person, PersonSettings, {"hello_timeout_s": 0.2}),
    "stage": (ZaberStage, ZaberStageSettings, {}),
}
LINE = b"@01 0 RJ IDLE -- BADCOMMAND\r\n"


def open_at(name: str, port: str, clock: Clock) -> None:
    driver, settings, timeouts = DRIVERS[name]
    driver(name, settings(port=port, **timeouts), clock).open()


class Other:
    """Answers everything with a line, or with nothing."""

    def __init__(self, line: bytes) -> None:
        self._line = line

    def receive(self, data: bytes, t_s: float) -> bytes:
        return self._line

    def step(self, t_s: float) -> bytes:
        return b""


@pytest.mark.parametrize(
    ("name", "line", "error", "message"),
    [
        ("board", LINE, ProtocolError, "no hello of a sensor board while asking who is at {port}"),
        ("board", b"", SilentError, "no answer in 3 s while asking who is at {port}"),
        ("dsa", LINE, ProtocolError, "BADCOMMAND.* while asking who is at {port}"),
        ("dsa", b"", SilentError, "no answer in 0.3 s while asking who is at {port}"),
        ("gripper", b"t" + LINE, ProtocolError, "malformed"),
        ("hand", b"t0780\r", ProtocolError, "is a BarrettHand on this bus"),
        (
            "operator",
            b"",
            SilentError,
            r"^operator: no answer in 0.2 s while saying hello; is their program running\?"
            ' for a person at this terminal write port = "console"$',
        ),
    ],
)
def test_another_device_or_none_is_not_opened(
    serve: Any, name: str, line: bytes, error: type[Exception], message: str
) -> None:
    port = serve(Other(line))
    with pytest.raises(error, match=message.format(port=port)):
        open_at(name, port, serve.clock)


@pytest.mark.parametrize("name", DRIVERS)
def test_an_absent_port_is_an_error(name: str) -> None:
    with pytest.raises(PortError, match="/dev/ttyNONE0 does not exist"):
        open_at(name, "/dev/ttyNONE0", WallClock())
