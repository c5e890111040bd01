"""Opening an arm through the unmodified ur_rtde client: what only the real client can show."""

import subprocess
import sys
from typing import Any

import pytest

from drivers.core.errors import RefusedError, SilentError
from drivers.ur_arm.driver import UrArm
from tests.wire.emulated_ur import EmulatedUr
from tests.wire.ur_hand import settings


def refused(emulated: EmulatedUr, kind: type[Exception], message: str, **changes: Any) -> None:
    arm = UrArm("arm", settings(emulated, **changes), emulated.clock)
    with pytest.raises(kind, match=message) as caught:
        arm.open()
    assert "\n" not in str(caught.value)
    arm.close()


def test_a_handshake_without_a_reply_is_given_up(emulated: EmulatedUr) -> None:
    emulated.order(deaf=True)
    refused(emulated, SilentError, "sends nothing", open_timeout_s=2.0)


def test_a_controller_that_runs_no_script_is_a_refusal(emulated: EmulatedUr) -> None:
    emulated.order(accepts_scripts=False)
    refused(emulated, RefusedError, "Failed to start control script")


TOOL = {"tcp_offset": (0.0, 0.0, 0.1, 0.0, 0.0, 0.0), "payload_kg": 1.25, "payload_cog_m": (0.0, 0.0, 0.05)}


def test_an_arm_is_given_the_profile_s_tool_and_its_own_back() -> None:
    own = {"tcp_offset": (0.0, 0.0, 0.2, 0.0, 0.0, 0.0), "payload_kg": 2.0, "payload_cog_m": (0.0, 0.0, 0.04)}
    with EmulatedUr(**own) as other:
        given = settings(other, **TOOL, tool="set")
        arm = UrArm("arm", given, other.clock)
        details: dict[str, Any] = dict(arm.open().details)
        assert details["tool_found"]["payload_kg"] == pytest.approx(2.0)
        for name, value in TOOL.items():
            assert details[name] == pytest.approx(value)
        assert (details["robot_mode"], details["speed_slider"]) == ("RUNNING", 1.0)
        # a UR5e's data sheet: 360 degrees either way, 180 degrees a second
        assert details["joint_limits_rad"] == [pytest.approx([-6.2832, 6.2832], abs=1e-4)] * 6
        assert details["joint_speed_limits_rad_s"] == pytest.approx([3.1416] * 6, abs=1e-4)
        arm.close()
        again = UrArm("arm", settings(other, **own), other.clock)
        found = again.open().details
        again.close()
        for name, value in own.items():
            assert found[name] == pytest.approx(value, abs=1e-9)


OTHER_CLIENT = """
import sys, time, rtde_control
control = rtde_control.RTDEControlInterface(sys.argv[1])
if sys.argv[2] == "idle":
    control.stopScript()
print("ready", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize(("doing", "message"), [("busy", "another program runs"), ("idle", "already in use")])
def test_a_second_control_interface_is_a_refusal(emulated: EmulatedUr, doing: str, message: str) -> None:
    other = subprocess.Popen(
        [sys.executable, "-c", OTHER_CLIENT, emulated.host, doing],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert other.stdout is not None
    try:
        while (line := other.stdout.readline()) != b"ready\n":
            assert line == b"Reconnecting...\n", "what the client prints on a machine that stands still"
        refused(emulated, RefusedError, message)
    finally:
        other.kill()
        other.wait()
        other.stdout.close()
