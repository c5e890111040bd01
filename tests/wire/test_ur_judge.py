"""The unmodified ur_rtde client, by itself, as a judge of the emulated controller.

The client runs in a process of its own: it holds the interpreter's lock while it connects, and can crash.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from tests.wire.emulated_ur import EmulatedUr

TIMEOUT_S = 40.0

PRELUDE = """
import json, sys, time
import rtde_control, rtde_receive
host = sys.argv[1]
receive = rtde_receive.RTDEReceiveInterface(host)
control = rtde_control.RTDEControlInterface(host)
start = receive.getActualTCPPose()
said = {}

def down(by_m):
    return [*start[:2], start[2] - by_m, *start[3:]]

def height():
    return receive.getActualTCPPose()[2] - start[2]
"""

POSTLUDE = """
print(json.dumps(said))
control.stopScript()
control.disconnect()
receive.disconnect()
"""

PLANE_M = 0.16
"""Two centimetres under the tool where it starts."""


@pytest.fixture(scope="module")
def emulated() -> Iterator[EmulatedUr]:
    with EmulatedUr(plane_m=PLANE_M) as one:
        yield one


def judged(emulated: EmulatedUr, script: str) -> dict[str, Any]:
    """What the client had to say of a fresh controller."""
    emulated.order(restart=True)
    ran = subprocess.run(
        [sys.executable, "-c", PRELUDE + script + POSTLUDE, emulated.host],
        capture_output=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr.decode()
    said: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return said


def test_moves_arrive_where_the_client_sends_them(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
said["line"] = control.moveL(down(0.01), 0.05, 0.5), height()
joints = control.getInverseKinematics(down(0.0))
said["joints"] = control.moveJ(joints, 0.5, 1.0), height()
said["by_pose"] = control.moveJ_IK(down(0.005), 0.5, 1.0), height()
said["there"] = max(abs(a - b) for a, b in zip(control.getForwardKinematics(), receive.getActualTCPPose()))
reachable = control.getInverseKinematicsHasSolution
said["has"] = reachable([5, 0, 0, 0, 0, 0]), reachable(start)
""",
    )
    assert said["line"] == [True, pytest.approx(-0.01, abs=1e-6)]
    assert said["joints"] == [True, pytest.approx(0.0, abs=1e-6)]
    assert said["by_pose"] == [True, pytest.approx(-0.005, abs=1e-6)]
    assert said["there"] < 1e-6
    assert said["has"] == [False, True]


def test_an_asynchronous_move_runs_and_stops_as_the_client_is_told(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
before = control.getAsyncOperationProgressEx().operationId()
said["begun"] = control.moveL(down(0.015), 0.01, 0.5, True)
time.sleep(0.3)
during = control.getAsyncOperationProgressEx()
said["during"] = during.isAsyncOperationRunning(), during.operationId() - before
control.stopL(2.0, True)
time.sleep(0.2)
said["after"] = control.getAsyncOperationProgressEx().isAsyncOperationRunning(), control.isSteady(), height()
""",
    )
    assert said["begun"] is True
    assert said["during"] == [True, 1]
    running, steady, height_m = said["after"]
    assert (running, steady) == (False, True)
    assert -0.014 < height_m < -0.001


def test_tool_speeds_are_kept_and_stopped(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
end = time.time() + 0.4
while time.time() < end:
    control.speedL([0, 0, -0.01, 0, 0, 0], 0.5, 0.002)
    time.sleep(0.008)
said["speed"] = receive.getActualTCPSpeed()[2]
said["stop"] = control.speedStop(2.0), receive.getActualTCPSpeed()[2]
""",
    )
    assert said["speed"] == pytest.approx(-0.01, abs=1e-6)
    assert said["stop"] == [True, pytest.approx(0.0, abs=1e-6)]


def test_moving_until_contact_and_zeroing_work_as_the_client_means_them(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
said["contact"] = control.moveUntilContact([0, 0, -0.02, 0, 0, 0]), receive.getActualTCPPose()[2]
control.moveL(down(0.0201), 0.01, 0.5)
said["pressed"] = receive.getActualTCPForce()[2]
said["zeroed"] = control.zeroFtSensor()
time.sleep(0.05)
said["left"] = max(map(abs, receive.getActualTCPForce()))
""",
    )
    assert said["contact"] == [True, pytest.approx(PLANE_M, abs=1e-4)]
    assert said["pressed"] > 0.5
    assert said["zeroed"] is True
    assert said["left"] < 1e-9


def test_a_watchdog_that_is_not_fed_stops_the_program(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
said["set"] = control.setWatchdog(10.0)
control.speedL([0, 0, -0.01, 0, 0, 0], 0.5, 0.002)
time.sleep(0.5)
said["after"] = control.isProgramRunning(), receive.getActualTCPSpeed()[2]
""",
    )
    assert said["set"] is True
    assert said["after"] == [False, pytest.approx(0.0, abs=1e-9)]


def test_without_a_watchdog_a_speed_goes_on_for_ever(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
control.speedL([0, 0, 0.005, 0, 0, 0], 0.5, 0.002)
time.sleep(1.0)
said["speed"] = receive.getActualTCPSpeed()[2]
control.speedStop()
""",
    )
    assert said["speed"] == pytest.approx(0.005, abs=1e-6)


def test_a_protective_stop_is_seen_and_the_script_comes_back_after_it(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
import socket
control.triggerProtectiveStop()
time.sleep(0.1)
said["stopped"] = receive.isProtectiveStopped(), control.moveL(down(0.01), 0.05, 0.5)
dashboard = socket.create_connection((host, 29999)).makefile("rw", newline="\\n")
dashboard.readline()
time.sleep(0.3)
dashboard.write("unlock protective stop\\n"); dashboard.flush()
said["reply"] = dashboard.readline()
control.reuploadScript()
while not control.isProgramRunning():
    time.sleep(0.01)
said["moved"] = control.moveL(down(0.01), 0.05, 0.5), height()
""",
    )
    assert said["stopped"] == [True, False]
    assert said["reply"] == "Protective stop releasing\n"
    assert said["moved"] == [True, pytest.approx(-0.01, abs=1e-6)]


def test_every_variable_of_the_default_list_is_where_the_client_looks_for_it(emulated: EmulatedUr) -> None:
    said = judged(
        emulated,
        """
control.setPayload(0.5, [0.01, 0.02, 0.03])
time.sleep(0.05)
said["mode"] = receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()
said["joints"] = receive.getActualQ(), receive.getJointMode()
said["payload"] = receive.getPayload(), receive.getPayloadCog()
said["last"] = receive.getOutputIntRegister(19), receive.getOutputDoubleRegister(19)
first = receive.getTimestamp()
time.sleep(0.5)
said["elapsed"] = receive.getTimestamp() - first
""",
    )
    assert said["mode"] == [7, 1, 2]
    assert said["joints"][1] == [253] * 6
    assert said["payload"] == [0.5, [0.01, 0.02, 0.03]]
    assert said["last"] == [0, 0.0]
    assert 0.3 < said["elapsed"] < 1.5
