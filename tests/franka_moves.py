"""The Franka arm's driver through franky, against franka-sim: python -m tests.franka_moves PYTHON

PYTHON is that of an environment with franka-sim, a twin that others wrote: MuJoCo behind the robot's own protocol, in
real time. It listens on every interface while this runs. Its arm is made here of the maker's printed kinematics, with
masses of our own. It estimates no external force; the one it sends here is MuJoCo's between its flange and a plate.
"""

import math
import os
import re
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

from config.script import run_trials
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

TOUCH_M, STIFFNESS_N_M = 0.070, 2000.0
"""Where the flange meets a plate on a spring, beyond the travel of all other motions here, and how hard that is."""

TWIN = """
from franka_sim import mujoco_franka_sim, run_server
arm = mujoco_franka_sim.MujocoFrankaSim
publish = arm._read_and_publish_state
def with_force(self):
    publish(self)
    self._state_snapshot["O_F_ext_hat_K"] = [0.0, 0.0, -float(self.data.qfrc_constraint[-1]), 0.0, 0.0, 0.0]
arm._read_and_publish_state = with_force
run_server.main()
"""
"""The server, whose state also has what the plate, the model's last joint, pushes the flange with (N, upwards)."""

PROFILE = f"""
experiment = "my_lab.tap:Tap"
[devices.arm]
driver = "franka_arm"
port = "{HOST}"
start_pose = {[*START[:2], START[2] - TOUCH_M + 0.005, *START[3:]]}
leash_m = 0.3
rate_hz = 250.0
home_speed_m_s = 0.1
enforce_realtime = false
link_timeout_s = 1.0
open_timeout_s = 60.0
[detectors.contact]
kind = "force.threshold"
input = "arm.force"
channels = [2]
threshold = 1.0
[limits]
travel_min_m = -0.2
travel_m = 0.012
position_stream = "arm.position"
speed_m_s = 0.1
force_n = 5.0
stiffness_n_m = {STIFFNESS_N_M}
force_stream = "arm.force"
force_channels = [2]
stuck_s = "none"
stale_s = 1.0
late_s = 1.0
[behavior]
mover = "arm"
force_stream = "arm.force"
limit_m = 0.01
"""
"""Of the tap that docs/how-to/add_an_experiment.md writes. A force without noise cannot be seen to stick; on a busy
machine the twin runs behind real time."""

PATIENCE_S = 60.0
"""Longest wait for an answer: on a busy machine the twin runs far behind real time."""


def scene() -> str:
    """The arm in MuJoCo's format, with the names that franka-sim looks for."""
    ball = '<geom type="sphere" size="0.01" mass="0" condim="1" solref="0.004 1"/>'
    inside = f'<body name="fr3v2_link8" pos="0 0 {FLANGE_M}">{ball}</body>'
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
        f'<worldbody><body name="fr3v2_link0">{inside}</body>'
        f'<body pos="{START[0]} {START[1]} {START[2] - TOUCH_M - FLANGE_M - 0.02}">'
        f'<joint type="slide" axis="0 0 1" stiffness="{STIFFNESS_N_M}" damping="10"/>'
        '<geom type="box" size="0.05 0.05 0.01" mass="0.05" condim="1" solref="0.004 1"/></body></worldbody></mujoco>'
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
                [python, "-c", TWIN, "--port", str(PORT), "--no-gripper"],
                env={**os.environ, "FR3_MJCF": str(model)},
                stdout=log,
                stderr=log,
            )
        try:
            _answers()
            approach(Path(folder))
            drive()
        finally:
            server.kill()
            server.wait()


def approach(folder: Path) -> None:
    """The program approaches the plate: until contact; past it, until the guard stops it. Three runs of each."""
    page = Path("docs/how-to/add_an_experiment.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"```python\n# my_bench/my_lab/tap.py\n(.*?)```", page, re.DOTALL)
    (folder / "my_lab").mkdir()
    (folder / "my_lab" / "tap.py").write_text(source, encoding="utf-8")
    (folder / "tap.toml").write_text(PROFILE, encoding="utf-8")
    for ended, threshold_n, most_n, code in 3 * (("contact", 1.0, 3.0, 0),) + 3 * (("guard", 50.0, 10.0, 4),):
        settings = {"detectors.contact.threshold": str(threshold_n)}
        outcome, run = run_trials(
            folder / "tap.toml", [{"speed_m_s": 0.01}], settings=settings, out=folder, say=lambda line: None
        )
        assert (outcome.exit_code, run.trials[0]["outcome"]) == (code, ended), outcome.line
        assert ("beyond limits.force_n = 5" in outcome.line) == (ended == "guard")
        assert not outcome.not_at_rest
        deepest_m = float(run.signal(1, "arm.position").values.max())
        peak_n = float(run.signal(1, "arm.force").values[:, 2].max())
        stood_m = next(e["position_m"] for e in run.events if e["event"] == "Standstill")
        told(
            f"an approach at 10 mm/s to a plate at 5 mm, ended by {ended}",
            f"at most {1e3 * deepest_m:.2f} mm and {peak_n:.2f} N; stands at {1e3 * stood_m:.2f} mm",
        )
        assert min(threshold_n, 5.0) <= peak_n < most_n
        assert abs(STIFFNESS_N_M * (deepest_m - 0.005) / peak_n - 1.0) < 0.2, "the force is the plate's"
        assert 0.005 < stood_m <= deepest_m


def drive() -> None:
    """Everything that an approach needs, and what stops it."""
    bench = Bench()
    _stands(bench)
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


def _stands(bench: Bench) -> None:
    """Where the guard stopped it, pressed on the plate."""
    told("opened", f"{bench.info.model}, mover {bench.info.mover}")
    stood_m = bench.position_m
    bench.until(lambda: len(bench.blocks) > 100)
    told("afterwards the arm stands beyond the plate by, mm", f"{1e3 * (stood_m - TOUCH_M):.2f}")
    assert TOUCH_M < stood_m < TOUCH_M + 0.003
    assert abs(bench.position_m - stood_m) < 1e-5


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
