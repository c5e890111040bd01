"""Limits of the joints from a controller's configuration data: golden bytes by the client interface's manual."""

import struct

import pytest

from drivers.ur_arm.limits import joint_limits, limits_in
from simulator.devices.ur_controller.controller import UrController, UrControllerSettings
from simulator.devices.ur_controller.primary import PrimarySession, greeting

DEGREES_180 = bytes.fromhex("400921fb54442d18")
MINUS_360, PLUS_360 = bytes.fromhex("c01921fb54442d18"), bytes.fromhex("401921fb54442d18")
FORTY = bytes.fromhex("4044000000000000")

CONFIGURATION = (
    bytes.fromhex("000001bd 06") + (MINUS_360 + PLUS_360) * 6 + (DEGREES_180 + FORTY) * 6 + bytes(248)
)
"""445 bytes: limits, speeds and accelerations; usual speeds, dimensions and types, which are not read."""

KINEMATICS = bytes.fromhex("00000007 05 0102")
STATE = bytes.fromhex("000001c9 10") + KINEMATICS + CONFIGURATION
MESSAGE = bytes.fromhex("00000008 14 ffffff")


def test_limits_are_found_behind_messages_and_other_parts() -> None:
    found = limits_in(MESSAGE + STATE)
    assert found is not None
    assert found["joint_limits_rad"] == [pytest.approx([-6.283185307, 6.283185307])] * 6
    assert found["joint_speed_limits_rad_s"] == pytest.approx([3.141592654] * 6)


@pytest.mark.parametrize("data", [b"", MESSAGE, STATE[:-1], bytes(5), STATE[:4] + b"\x14" + STATE[5:]])
def test_what_has_no_whole_configuration_has_no_limits(data: bytes) -> None:
    assert limits_in(data) is None


def test_a_controller_without_that_port_is_recorded_as_such() -> None:
    assert "30001" in str(joint_limits("127.0.0.254")["joint_limits_rad"])


def test_the_emulated_controller_sends_its_version_and_ten_states_a_second() -> None:
    controller = UrController(UrControllerSettings.model_validate({}))
    size, kind, _, _, message, length = struct.unpack_from(">IBQbbB", first := greeting(controller))
    assert (size, kind, message) == (len(first), 20, 3)
    assert struct.unpack_from(">BBi", first, 16 + length) == (5, 11, 1)
    session = PrimarySession(controller)
    states = [state for state in (session.step() for _ in range(500)) if state]
    assert len(states) == 10
    places, at = {}, 5
    while at < len(states[0]):
        size, kind = struct.unpack_from(">IB", states[0], at)
        places[kind], at = (at + 5, size), at + size
    # sizes of version 5 (client interface manual)
    assert {kind: size for kind, (_, size) in places.items()} == {0: 47, 1: 251, 4: 101, 6: 445}
    assert struct.unpack_from(">7?B", states[0], places[0][0] + 8) == (*[True] * 3, *[False] * 4, 7)
    joints = [struct.unpack_from(">d", states[0], places[1][0] + 41 * joint)[0] for joint in range(6)]
    assert joints == pytest.approx(list(controller.settings.joints_rad))
    assert struct.unpack_from(">6d", states[0], places[4][0]) == pytest.approx(controller.arm.pose)
    assert limits_in(states[0]) is not None
