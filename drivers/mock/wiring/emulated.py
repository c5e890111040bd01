"""Emulated devices on the bench that they share, as an emulator makes them: settings and bench in, far end out.

The settings are those that the profile has for the driver; what a device does not know of its driver is ignored.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivers.errors import RefusedError
from drivers.mock.devices.arm_carrier import ArmCarrier
from drivers.mock.devices.audio import EmulatedAudio, EmulatedAudioSettings
from drivers.mock.devices.barrett_hand import EmulatedBarrettHand, EmulatedBarrettHandSettings
from drivers.mock.devices.can_gripper import EmulatedCanGripper, EmulatedCanGripperSettings
from drivers.mock.devices.dsa_matrix import EmulatedDsaMatrix, EmulatedDsaMatrixSettings
from drivers.mock.devices.operator import EmulatedPerson, EmulatedPersonSettings
from drivers.mock.devices.sensor_board import EmulatedSensorBoard, EmulatedSensorBoardSettings
from drivers.mock.devices.slcan import EmulatedSlcan
from drivers.mock.devices.ur_controller.controller import UrController, UrControllerSettings
from drivers.mock.devices.ur_controller.server import UrServer
from drivers.mock.devices.zaber_stage import EmulatedZaberStage, EmulatedZaberStageSettings
from drivers.mock.physics import arm, rigid
from drivers.mock.physics.bench import Bench, part
from drivers.mock.physics.stage_axis import STAGE_M_S, STAGE_M_S2, StageAxis
from drivers.mock.wiring.far_ends import Line, Network
from drivers.mock.wiring.tcp_line import TcpLine
from drivers.ur_arm.settings import Axis, UrArmSettings

JOGGED_M = -0.005
"""Where the arm's tool is before anybody sends it home, on the approach axis (assumption: jogged near the start)."""


def zaber_stage(settings: Mapping[str, Any], bench: Bench) -> Line:
    """The stage, with the bench's probe on it."""
    axis = StageAxis(acceleration_m_s2=STAGE_M_S2, max_speed_m_s=STAGE_M_S)
    bench.mount(axis)
    return Line(EmulatedZaberStage(EmulatedZaberStageSettings(), axis, bench.on_plan))


def sensor_board(settings: Mapping[str, Any], bench: Bench) -> Line:
    """The board that is wired to the bench's sensors and drive."""
    part(bench, "streams", "board")
    return Line(EmulatedSensorBoard(EmulatedSensorBoardSettings(), bench))


def ur_arm(settings: Mapping[str, Any], bench: Bench) -> Network:
    """The controller and its arm, with what the bench has in the arm's tool.

    Raises:
        RefusedError: the arm does not reach there.
    """
    host = UrArmSettings.model_validate(settings)
    axis = Axis(host)
    usual = UrControllerSettings.model_validate({})
    try:
        joints_rad = arm.solve(rigid.matrix(axis.pose(JOGGED_M)), usual.joints_rad)
    except arm.UnreachableError as error:
        raise RefusedError(
            "arm", "being set up", f"{error} at start_pose", "choose a start_pose that a UR5e reaches"
        ) from error
    carrier = ArmCarrier(axis, bench)
    bench.mount(carrier)
    there = usual.model_copy(update={"joints_rad": tuple(joints_rad.tolist())})
    return Network(UrServer(UrController(there, carrier)))


def can_gripper(settings: Mapping[str, Any], bench: object) -> Line:
    """An adapter with the gripper on its bus, and the bench's jaws on the gripper.

    Raises:
        RefusedError: the bench has no jaws.
    """
    jaws = part(bench, "jaws", "gripper")
    gripper = EmulatedCanGripperSettings(node=settings.get("node", 0))
    return Line(EmulatedSlcan(EmulatedCanGripper(gripper, jaws)))


def barrett_hand(settings: Mapping[str, Any], bench: object) -> Line:
    """An adapter with the hand on its bus.

    Raises:
        RefusedError: the bench has no fingers.
    """
    fingers = part(bench, "fingers", "hand")
    return Line(EmulatedSlcan(EmulatedBarrettHand(EmulatedBarrettHandSettings(), fingers)))


def dsa_matrix(settings: Mapping[str, Any], bench: object) -> Line:
    """The matrices' controller, on a line as fast as the driver's.

    Raises:
        RefusedError: the bench has no taxels.
    """
    taxels = part(bench, "taxels", "matrix")
    matrix = EmulatedDsaMatrixSettings(baud=settings.get("baud", 115_200))
    return Line(EmulatedDsaMatrix(matrix, taxels))


def operator(settings: Mapping[str, Any], bench: Bench) -> Line:
    """Somebody who hangs weights on the bench's fingertip."""
    part(bench, "load", "operator")
    return Line(EmulatedPerson(EmulatedPersonSettings(), bench))


def audio(settings: Mapping[str, Any], bench: Bench) -> TcpLine:
    """A recorder on the network, wired to the bench's fingers and to their drive.

    Raises:
        RefusedError: the bench has no such fingers.
    """
    part(bench, "carrier", "audio")
    return TcpLine(EmulatedAudio(EmulatedAudioSettings(), bench))
