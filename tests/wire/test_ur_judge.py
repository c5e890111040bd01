"""The unmodified ur_rtde client, by itself, as a judge of the emulated controller.

The client runs in a process of its own: it holds the interpreter's lock while it connects, and can crash. To connect
costs most of the time, so that checks of a kind share a connection.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from tests.wire.emulated_ur import EmulatedUr

TIMEOUT_S = 60.0
"""Longest life of a client; some seconds on a machine that does nothing else."""

PRELUDE = """
import json, socket, sys, time
import rtde_control, rtde_io, rtde_receive
host = sys.argv[1]
receive = rtde_receive.RTDEReceiveInterface(host)
control = rtde_control.RTDEControlInterface(host)
start, home = receive.getActualTCPPose(), receive.getActualQ()
found = {}

def down(by_m):
    return [*start[:2], start[2] - by_m, *start[3:]]

def turned(by_rad):
    return [home[0] + by_rad, *home[1:]]

def height():
    return receive.getActualTCPPose()[2] - start[2]

def pace():
    return max(map(abs, receive.getActualQd()))

def rests():
    "Whether it comes to rest: what the receive interface has may be older than what the control interface was sent."
    return seen(lambda: pace() < 1e-9)

def arrived():
    "Where it stands."
    assert rests()
    return height()

def seen(what, limit_s=20.0):
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        if what():
            return True
        time.sleep(0.005)
    return False

def again():
    "Unlock what is locked, and run the script anew."
    line = socket.create_connection((host, 29999)).makefile("rw", newline="\\n")
    line.readline()
    def unlocked():
        line.write("unlock protective stop\\n"); line.flush()
        return line.readline() == "Protective stop releasing\\n"
    assert seen(unlocked)
    assert seen(lambda: receive.getSafetyMode() == 1)
    control.kickWatchdog()  # a command that is left in the registers would be obeyed again
    control.reuploadScript()
    return seen(control.isProgramRunning)
"""

POSTLUDE = """
print(json.dumps(found))
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
    """What the client finds on a fresh controller."""
    emulated.order(restart=True)
    ran = subprocess.run(
        [sys.executable, "-c", PRELUDE + script + POSTLUDE, emulated.host],
        capture_output=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert ran.returncode == 0, f"{ran.stderr.decode()}\n{emulated.order()['log']}"
    found: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return found


@pytest.fixture(scope="module")
def moves(emulated: EmulatedUr) -> dict[str, Any]:
    return judged(
        emulated,
        """
found["line"] = control.moveL(down(0.01), 0.2, 1.0), arrived()
found["joints"] = control.moveJ(control.getInverseKinematics(down(0.0)), 1.0, 2.0), arrived()
found["by_pose"] = control.moveJ_IK(down(0.005), 1.0, 2.0), arrived()
found["there"] = max(abs(a - b) for a, b in zip(control.getForwardKinematics(), receive.getActualTCPPose()))
reachable = control.getInverseKinematicsHasSolution
found["has"] = reachable([5, 0, 0, 0, 0, 0]), reachable(start)
found["back"] = control.moveJ(home, 1.0, 2.0)

before = control.getAsyncOperationProgressEx().operationId()
found["begun"] = control.moveL(down(0.015), 0.01, 0.5, True)
seen(lambda: height() < -0.001)
found["during"] = seen(lambda: control.getAsyncOperationProgressEx().isAsyncOperationRunning())
found["number"] = control.getAsyncOperationProgressEx().operationId() - before
control.stopL(2.0, True)
found["ended"] = seen(lambda: not control.getAsyncOperationProgressEx().isAsyncOperationRunning())
found["after"] = control.isSteady(), arrived()
control.moveL(start, 0.2, 1.0)

for _ in range(20):
    control.speedL([0, 0, -0.01, 0, 0, 0], 0.5, 0.002)
    time.sleep(0.008)
sinks = lambda: abs(receive.getActualTCPSpeed()[2] + 0.01) < 1e-6
found["speed"] = seen(sinks)
time.sleep(0.2)
found["speed_alone"] = sinks()
found["speed_stop"] = control.speedStop(2.0), rests()

control.speedJ([0.1, 0, 0, 0, 0, 0], 0.05, 0.002)  # for two seconds
seen(lambda: found.update(acceleration=receive.getTargetQdd()[0]) or found["acceleration"] > 0.04)
control.speedJ([0.1, 0, 0, 0, 0, 0], 1.0, 0.002)
seen(lambda: receive.getActualQd()[0] > 0.0999)
found["joint_speed"] = receive.getActualQd()
found["joint_stop"] = control.speedStop(2.0), rests()
control.moveJ(home, 1.0, 2.0)

control.servoJ(turned(0.1), 0.0, 0.0, 0.002, 0.1, 300)
found["servo"] = seen(lambda: abs(receive.getActualQ()[0] - home[0] - 0.1) < 1e-4)
found["servo_stop"] = control.servoStop(10.0), rests()
""",
    )


def test_moves_arrive_where_the_client_sends_them(moves: dict[str, Any]) -> None:
    assert moves["line"] == [True, pytest.approx(-0.01, abs=1e-6)]
    assert moves["joints"] == [True, pytest.approx(0.0, abs=1e-6)]
    assert moves["by_pose"] == [True, pytest.approx(-0.005, abs=1e-6)]
    assert moves["there"] < 1e-6
    assert moves["has"] == [False, True]
    assert moves["back"] is True


def test_an_asynchronous_move_runs_and_stops_as_the_client_reports(moves: dict[str, Any]) -> None:
    assert moves["begun"] is True
    assert (moves["during"], moves["number"]) == (True, 1)
    assert moves["ended"] is True
    steady, height_m = moves["after"]
    assert steady is True
    assert -0.0149 < height_m < -0.001


def test_speeds_are_kept_without_anyone_and_stopped(moves: dict[str, Any]) -> None:
    assert (moves["speed"], moves["speed_alone"]) == (True, True)
    assert moves["speed_stop"] == [True, True]
    assert moves["acceleration"] == pytest.approx(0.05, rel=1e-6)
    assert moves["joint_speed"] == [pytest.approx(0.1, abs=1e-4), *[pytest.approx(0.0, abs=1e-6)] * 5]
    assert moves["joint_stop"] == [True, True]


def test_a_servo_target_is_followed(moves: dict[str, Any]) -> None:
    assert moves["servo"] is True
    assert moves["servo_stop"] == [True, True]


@pytest.fixture(scope="module")
def touches(emulated: EmulatedUr) -> dict[str, Any]:
    return judged(
        emulated,
        """
force = lambda: receive.getActualTCPForce()[2]
found["contact"] = control.moveUntilContact([0, 0, -0.05, 0, 0, 0]), start[2] + arrived()
control.moveL(down(0.0201), 0.01, 0.5)
found["pressed"] = seen(lambda: force() > 0.5)
found["zeroed"] = control.zeroFtSensor(), seen(lambda: max(map(abs, receive.getActualTCPForce())) < 1e-9)
control.moveL(down(0.015), 0.05, 0.5)
control.zeroFtSensor()

control.forceMode([0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -12, 0, 0, 0], 2, [0.1, 0.1, 0.05, 1, 1, 1])
found["pushes"] = seen(lambda: abs(force() - 12.0) < 0.05)
found["force_stop"] = control.forceModeStop(), rests()

found["freedrive"] = control.freedriveMode([1] * 6), control.getFreedriveStatus()
found["led"] = seen(lambda: abs(force()) < 0.05)
found["freedrive_end"] = control.endFreedriveMode(), rests()

control.moveL(down(0.01), 0.05, 0.5)
found["watching"] = control.startContactDetection()
control.moveL(down(0.03), 0.02, 0.5, True)
found["stopped"] = seen(lambda: abs(height() + 0.02) < 1e-4 and pace() == 0.0)
time.sleep(0.05)  # what is asked in the cycle in which the script is back where it touched, it takes for done
found["found"] = control.readContactDetection(), control.stopContactDetection()
""",
    )


def test_moving_until_contact_and_zeroing_work_as_the_client_means_them(touches: dict[str, Any]) -> None:
    assert touches["contact"] == [True, pytest.approx(PLANE_M, abs=1e-4)]
    assert touches["pressed"] is True
    assert touches["zeroed"] == [True, True]


def test_force_mode_pushes_as_hard_as_it_is_set(touches: dict[str, Any]) -> None:
    assert touches["pushes"] is True
    assert touches["force_stop"] == [True, True]


def test_an_arm_in_freedrive_gives_way(touches: dict[str, Any]) -> None:
    assert touches["freedrive"] == [True, 0]
    assert touches["led"] is True
    assert touches["freedrive_end"] == [True, True]


def test_contact_detection_ends_a_move_where_it_touched(touches: dict[str, Any]) -> None:
    assert touches["watching"] is True
    assert touches["stopped"] is True
    assert touches["found"] == [True, True]


@pytest.fixture(scope="module")
def stops(emulated: EmulatedUr) -> dict[str, Any]:
    return judged(
        emulated,
        """
before = receive.getActualQ()
control.moveJ(turned(-0.5), 0.2, 1.0, True)
found["moves"] = seen(lambda: max(abs(a - b) for a, b in zip(receive.getActualQ(), before)) > 1e-4)
control.triggerProtectiveStop()
found["stopped"] = seen(receive.isProtectiveStopped) and rests()
where = receive.getActualQ()
found["refused"] = not control.moveL(start, 0.05, 0.5)
found["stays"] = receive.getActualQ() == where
found["again"] = again()
found["comes back"] = control.moveJ(home, 1.0, 2.0)
""",
    )


def test_a_protective_stop_stops_a_motion_and_the_script_comes_back(stops: dict[str, Any]) -> None:
    """In which motions: tests/simulator/devices/test_ur_motions.py."""
    assert stops == dict.fromkeys(("moves", "stopped", "refused", "stays", "again", "comes back"), True)


@pytest.fixture(scope="module")
def panel(emulated: EmulatedUr) -> dict[str, Any]:
    return judged(
        emulated,
        """
control.setPayload(0.5, [0.01, 0.02, 0.03])
found["payload"] = seen(lambda: receive.getPayload() == 0.5), receive.getPayloadCog()
found["mode"] = receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()
found["joints"] = receive.getActualQ(), receive.getJointMode()
found["last"] = receive.getOutputIntRegister(19), receive.getOutputDoubleRegister(19)

io = rtde_io.RTDEIOInterface(host)
found["set"] = io.setStandardDigitalOut(3, True), io.setConfigurableDigitalOut(1, True), io.setToolDigitalOut(0, True)
found["bits"] = seen(lambda: receive.getActualDigitalOutputBits() == 0x1_02_08), receive.getDigitalOutState(3)
io.setStandardDigitalOut(3, False)
found["cleared"] = seen(lambda: receive.getActualDigitalOutputBits() == 0x1_02_00)
found["analog"] = io.setAnalogOutputVoltage(0, 0.25), io.setAnalogOutputCurrent(1, 0.5)
found["volts"] = seen(lambda: abs(receive.getStandardAnalogOutput0() - 2.5) < 1e-9)
found["amperes"] = seen(lambda: abs(receive.getStandardAnalogOutput1() - 0.012) < 1e-9)

found["slider"] = io.setSpeedSlider(0.5), seen(lambda: receive.getTargetSpeedFraction() == 0.5)
control.moveL(down(0.015), 0.01, 0.5, True)  # three seconds of travel
found["slower"] = seen(lambda: abs(receive.getActualTCPSpeed()[2] + 0.005) < 1e-6), receive.getSpeedScaling()
found["there"] = seen(lambda: abs(height() + 0.015) < 1e-6)
io.disconnect()
""",
    )


def test_every_variable_of_the_default_list_is_where_the_client_looks_for_it(panel: dict[str, Any]) -> None:
    assert panel["payload"] == [True, [0.01, 0.02, 0.03]]
    assert panel["mode"] == [7, 1, 2]
    assert panel["joints"][1] == [253] * 6
    assert panel["last"] == [0, 0.0]


def test_outputs_are_seen_as_they_are_set(panel: dict[str, Any]) -> None:
    assert panel["set"] == [True, True, True]
    assert panel["bits"] == [True, True]
    assert panel["cleared"] is True
    assert panel["analog"] == [True, True]
    assert (panel["volts"], panel["amperes"]) == (True, True)


def test_the_slider_halves_the_speed_of_a_move(panel: dict[str, Any]) -> None:
    assert panel["slider"] == [True, True]
    assert panel["slower"] == [True, 0.5]
    assert panel["there"] is True


@pytest.fixture(scope="module")
def programs(emulated: EmulatedUr) -> dict[str, Any]:
    return judged(
        emulated,
        """
past = lambda: control.getActualJointPositionsHistory(2)
found["history"] = seen(lambda: max(abs(a - b) for a, b in zip(past(), home)) < 1e-6)

found["senseless"] = control.moveL(down(0.01), 0.0, 0.5), seen(lambda: not control.isProgramRunning()), again()
found["set"] = control.setWatchdog(10.0)
control.speedL([0, 0, -0.01, 0, 0, 0], 0.5, 0.002)
found["tripped"] = seen(lambda: not control.isProgramRunning()) and rests()
found["again"] = again(), control.moveL(start, 0.2, 1.0)
""",
    )


def test_the_joints_of_the_last_cycles_are_kept(programs: dict[str, Any]) -> None:
    assert programs["history"] is True


def test_what_makes_no_sense_ends_the_program_and_leaves_the_client_free(programs: dict[str, Any]) -> None:
    assert programs["senseless"] == [False, True, True]


def test_a_watchdog_that_is_not_fed_stops_the_program(programs: dict[str, Any]) -> None:
    assert programs["set"] is True
    assert programs["tripped"] is True
    assert programs["again"] == [True, True]
