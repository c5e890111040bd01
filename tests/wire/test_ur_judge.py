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
import rtde_control, rtde_receive
host = sys.argv[1]
receive = rtde_receive.RTDEReceiveInterface(host)
control = rtde_control.RTDEControlInterface(host)
start = receive.getActualTCPPose()
found = {}

def down(by_m):
    return [*start[:2], start[2] - by_m, *start[3:]]

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
before = control.getAsyncOperationProgressEx().operationId()
found["begun"] = control.moveL(down(0.015), 0.01, 0.5, True)
seen(lambda: height() < -0.001)
found["during"] = seen(lambda: control.getAsyncOperationProgressEx().isAsyncOperationRunning())
found["number"] = control.getAsyncOperationProgressEx().operationId() - before
control.stopL(2.0, True)
found["ended"] = seen(lambda: not control.getAsyncOperationProgressEx().isAsyncOperationRunning())
found["height_m"] = arrived()
control.moveL(start, 0.2, 1.0)

for _ in range(20):
    control.speedL([0, 0, -0.01, 0, 0, 0], 0.5, 0.002)
    time.sleep(0.008)
sinks = lambda: abs(receive.getActualTCPSpeed()[2] + 0.01) < 1e-6
found["speed"] = seen(sinks)
time.sleep(0.2)
found["speed_alone"] = sinks()
found["speed_stop"] = control.speedStop(2.0), rests()

""",
    )


def test_moves_arrive_where_the_client_sends_them(moves: dict[str, Any]) -> None:
    assert moves["line"] == [True, pytest.approx(-0.01, abs=1e-6)]


def test_an_asynchronous_move_runs_and_stops_as_the_client_reports(moves: dict[str, Any]) -> None:
    assert moves["begun"] is True
    assert (moves["during"], moves["number"]) == (True, 1)
    assert moves["ended"] is True
    assert -0.0149 < moves["height_m"] < -0.001


def test_speeds_are_kept_without_anyone_and_stopped(moves: dict[str, Any]) -> None:
    assert (moves["speed"], moves["speed_alone"]) == (True, True)
    assert moves["speed_stop"] == [True, True]


@pytest.fixture(scope="module")
def touches(emulated: EmulatedUr) -> dict[str, Any]:
    return judged(
        emulated,
        """
force = lambda: receive.getActualTCPForce()[2]
control.moveL(down(0.0201), 0.01, 0.5)
found["pressed"] = seen(lambda: force() > 0.5)
found["zeroed"] = control.zeroFtSensor(), seen(lambda: max(map(abs, receive.getActualTCPForce())) < 1e-9)
control.moveL(down(0.015), 0.05, 0.5)
control.zeroFtSensor()

control.moveL(down(0.021), 0.01, 0.5)
found["led"] = control.teachMode(), seen(lambda: abs(force()) < 0.05)
found["led_end"] = control.endTeachMode(), rests()
""",
    )


def test_zeroing_works_as_the_client_means_it(touches: dict[str, Any]) -> None:
    assert touches["pressed"] is True
    assert touches["zeroed"] == [True, True]


def test_an_arm_that_is_led_gives_way(touches: dict[str, Any]) -> None:
    assert touches["led"] == [True, True]
    assert touches["led_end"] == [True, True]


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

""",
    )


def test_every_variable_of_the_default_list_is_where_the_client_looks_for_it(panel: dict[str, Any]) -> None:
    assert panel["payload"] == [True, [0.01, 0.02, 0.03]]
    assert panel["mode"] == [7, 1, 2]
    assert panel["joints"][1] == [253] * 6
    assert panel["last"] == [0, 0.0]


@pytest.fixture(scope="module")
def programs(emulated: EmulatedUr) -> dict[str, Any]:
    return judged(
        emulated,
        """
found["senseless"] = control.moveL(down(0.01), 0.0, 0.5), seen(lambda: not control.isProgramRunning()), again()
found["unknown"] = control.moveJ(receive.getActualQ()), seen(lambda: not control.isProgramRunning()), again()
found["set"] = control.setWatchdog(10.0)
control.speedL([0, 0, -0.01, 0, 0, 0], 0.5, 0.002)
found["tripped"] = seen(lambda: not control.isProgramRunning()) and rests()
found["again"] = again(), control.moveL(start, 0.2, 1.0)
""",
    )


def test_what_makes_no_sense_ends_the_program_and_leaves_the_client_free(programs: dict[str, Any]) -> None:
    assert programs["senseless"] == [False, True, True]
    assert programs["unknown"] == [False, True, True]


def test_a_watchdog_that_is_not_fed_stops_the_program(programs: dict[str, Any]) -> None:
    assert programs["set"] is True
    assert programs["tripped"] is True
    assert programs["again"] == [True, True]
