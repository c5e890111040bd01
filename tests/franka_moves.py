"""The Franka arm's driver through franky, against franka-sim: python -m tests.franka_moves PYTHON

PYTHON is that of an environment with franka-sim, a twin that others wrote: MuJoCo behind the robot's own protocol, in
real time. It listens on every interface while this runs. Its arm is made here of the maker's printed kinematics, with
masses of our own.
"""

import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from drivers.core.clock import WallClock
from drivers.core.errors import CommandError
from drivers.core.messages import (
    Command,
    Home,
    Listen,
    Lost,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    SampleBlock,
    Sent,
    Stalled,
    Standstill,
    Status,
    Stop,
    Tare,
    Twist,
)
from drivers.franka_arm.driver import FrankaArm
from drivers.franka_arm.settings import FrankaArmSettings

HOST, PORT = "127.0.0.1", 1337

JOINTS = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -0.5),
    (0.0, 0.316, 0.5),
    (0.0825, 0.0, 0.5),
    (-0.0825, 0.384, -0.5),
    (0.0, 0.0, 0.5),
    (0.088, 0.0, 0.5),
)
"""Denavit and Hartenberg's a (m), d (m) and alpha (pi rad) of each joint, after Craig (the maker's documentation)."""

FLANGE_M = 0.107

START = (0.5, 0.0, 0.65, 0.9239 * math.pi, -0.3827 * math.pi, 0.0)
"""Where approaches start: in front of the arm, the flange down, turned as the twin begins."""

PATIENCE_S = 60.0
"""Longest wait for an answer: on a busy machine the twin runs far behind real time."""


def scene() -> str:
    """The arm in MuJoCo's format, with the names that franka-sim looks for."""
    inside = f'<body name="fr3v2_link8" pos="0 0 {FLANGE_M}"/>'
    for number, (a, d, alpha) in reversed(list(enumerate(JOINTS, 1))):
        half = 0.5 * math.pi * alpha
        place = f"{a} {-math.sin(2.0 * half) * d} {math.cos(2.0 * half) * d}"
        inside = (
            f'<body name="fr3v2_link{number}" pos="{place}" quat="{math.cos(half)} {math.sin(half)} 0 0">'
            f'<joint name="fr3v2_joint{number}" axis="0 0 1" damping="10" armature="1"/>'
            f'<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>{inside}</body>'
        )
    return (
        '<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>'
        f'<worldbody><body name="fr3v2_link0">{inside}</body></worldbody></mujoco>'
    )


class Bench:
    """Drives the arm as the loop does: one thread that never waits inside the driver."""

    def __init__(self) -> None:
        settings = FrankaArmSettings(
            host=HOST,
            start_pose=START,
            travel_min_m=-0.03,
            travel_max_m=0.06,
            leash_m=0.3,
            home_speed_m_s=0.1,
            enforce_realtime=False,
            link_timeout_s=1.0,
            open_timeout_s=PATIENCE_S,
            reconnect_s=PATIENCE_S,
        )
        self.arm = FrankaArm("arm", settings, WallClock())
        self.info = self.arm.open()
        self.arm.apply(Listen("arm", frozenset({"arm.position", "arm.force"})))
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    @property
    def position_m(self) -> float:
        """The latest sample of the position; waits for one."""
        count = len(self.blocks)
        self.until(lambda: any(block.stream == "arm.position" for block in self.blocks[count:]))
        return float(next(b for b in reversed(self.blocks) if b.stream == "arm.position").values[-1, 0])

    def turn(self) -> None:
        """One look at the arm."""
        self.blocks += self.arm.read()
        self.statuses += self.arm.poll()
        time.sleep(0.002)

    def until(self, condition: Callable[[], bool]) -> None:
        """Look until something holds."""
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end_s, [
                str(status) for status in self.statuses if not isinstance(status, Lost)
            ][-5:]
            self.turn()

    def do(self, command: Command, kind: type[Status]) -> Status:
        """Apply, and wait for what comes of it."""
        count = len(self.statuses)
        self.arm.apply(command)
        self.until(lambda: any(isinstance(status, kind) for status in self.statuses[count:]))
        return next(status for status in self.statuses[count:] if isinstance(status, kind))


def told(what: str, fact: object) -> None:
    """One line of the record."""
    sys.stdout.write(f"{what:<64}{fact}\n")


def main(python: str) -> None:
    """Start the twin, drive it, end it."""
    _hurry()
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder, "arm.xml")
        model.write_text(scene(), encoding="utf-8")
        with Path(folder, "log").open("wb") as log:
            server = subprocess.Popen(
                [python, "-m", "franka_sim.run_server", "--port", str(PORT), "--no-gripper"],
                env={**os.environ, "FR3_MJCF": str(model)},
                stdout=log,
                stderr=log,
            )
        try:
            _answers()
            drive()
        finally:
            server.kill()
            server.wait()


def drive() -> None:
    """Everything that an approach needs, and what stops it."""
    bench = Bench()
    told("opened", f"{bench.info.model}, mover {bench.info.mover}")
    bench.do(Home("arm"), Reached)
    told("Home, m from the start", f"{bench.position_m:.5f}")
    assert abs(bench.position_m) < 1e-3

    reached = bench.do(MoveAt("arm", 0.03, 0.02), Reached)
    assert isinstance(reached, Reached)
    told("an approach at 30 mm/s to 20 mm ends at, mm", f"{1e3 * reached.position_m:.2f}")
    assert 0.0195 <= reached.position_m <= 0.0202

    bench.do(MoveTo("arm", 0.0, 0.05), Reached)
    bench.arm.apply(MoveAt("arm", 0.02, 0.05))
    bench.until(lambda: bench.position_m > 0.01)
    sent_m = bench.position_m
    stood = bench.do(Stop("arm"), Standstill)
    assert isinstance(stood, Standstill)
    told("a stop at 20 mm/s: travel after it, mm", f"{1e3 * (stood.position_m - sent_m):.2f}")
    assert 0.0 <= stood.position_m - sent_m < 0.004

    bench.do(MoveTo("arm", -0.02, 0.05), Reached)
    assert abs(bench.position_m + 0.02) < 1e-3
    bench.do(MovePose("arm", (0.01, 0.02, 0.0, 0.0, 0.0, 0.1), 0.05), Reached)
    bench.do(Twist("arm", (0.0, 0.0, 0.01, 0.0, 0.0, 0.0), 0.5), Reached)
    bench.do(Tare("arm", "arm.force"), Sent)
    told("moved along the axis, off it, by a twist; tared", "yes")

    try:
        bench.arm.apply(MoveTo("arm", 0.07, 0.05))
    except CommandError as error:
        told("beyond travel_max_m", error)
    else:
        raise AssertionError("a move beyond the travel was taken")

    bench.do(Home("arm"), Reached)
    bench.arm.apply(MoveAt("arm", 0.01, 0.05))
    bench.until(lambda: bench.position_m > 0.005)
    time.sleep(2.0)  # the program hangs: nobody looks at the arm
    bench.until(lambda: any(isinstance(status, Stalled) for status in bench.statuses))
    hung_m = bench.position_m
    told("a program that hangs for 2 s at 10 mm/s: the arm stands at, mm", f"{1e3 * hung_m:.1f}")
    assert hung_m < 0.02, "it would have been 25 mm"

    bench.do(Home("arm"), Reached)
    bench.arm.apply(MoveAt("arm", 0.01, 0.05))
    bench.until(lambda: bench.position_m > 0.005)
    killed_m = bench.position_m
    os.kill(_process(), signal.SIGKILL)
    count = len(bench.blocks)
    bench.until(lambda: len(bench.blocks) > count + 5 and np.ptp(_positions(bench)[-50:]) < 1e-5)
    told(
        "its process is killed at 10 mm/s: travel until it stands, mm",
        f"{1e3 * (bench.position_m - killed_m):.2f}",
    )
    assert bench.position_m - killed_m < 0.003
    bench.do(Home("arm"), Reached)
    told("and goes Home with a new one", "yes")
    bench.arm.close()


def _positions(bench: Bench) -> np.ndarray:
    return np.concatenate([b.values[:, 0] for b in bench.blocks[-200:] if b.stream == "arm.position"])


def _process() -> int:
    """The arm's process: the one child that runs its module."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
                words = (entry / "cmdline").read_text(errors="replace")
            except OSError:
                continue
            if parent == os.getpid() and "drivers.arm.process" in words:
                return int(entry.name)
    raise AssertionError("the arm has no process")


def _hurry() -> None:
    """Before all other work of the machine, where that is allowed: the twin has a cycle each millisecond."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(5))


def _answers() -> None:
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        try:
            socket.create_connection((HOST, PORT), 1.0).close()
        except OSError:
            time.sleep(0.2)
        else:
            return
    raise AssertionError("franka-sim does not start")


if __name__ == "__main__":
    main(sys.argv[1])
