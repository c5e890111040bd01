"""How far a mover travels after its program is killed or stopped: real drivers, emulated devices.

The device must end the motion: the stage has a target, controllers and grippers have watchdogs. Emulated devices
behave as their interface pages state: no real one was at hand.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.results import save
from config import assemble
from config.profile import Profile, load_profile
from drivers.core.messages import Command, Home, MoveAt, Reached, Release
from simulator.wiring.emulator_process import EmulatorProcess

REPEATS, QUICK_REPEATS = 4, 1

SETTLED_S = 1.5
"""Time without motion after which the bench counts as still: longer than any watchdog here."""

GIVE_UP_S = 20.0
"""Longest wait for the motion to end."""


class MoverMotion(NamedTuple):
    """What a mover is doing when its program ends: its bench, which of the scene's numbers is its position, the last
    command, and how fast and how far it has gone then."""

    profile: str
    shown: str
    command: Command
    speed_m_s: float
    way_m: float


MOTIONS = {
    "stage": MoverMotion("emulated/transient", "probe_m", MoveAt("stage", 0.0127, 0.025), 0.0127, 0.004),
    "arm": MoverMotion("emulated/transient_arm", "probe_m", MoveAt("arm", 0.0127, 0.012), 0.0127, 0.001),
    "gripper": MoverMotion("emulated/centering", "width_m", Release("gripper", 0.02), 0.02, 0.005),
}

ENDS = (
    *product(("stage",), ("program",), (signal.SIGKILL, signal.SIGSTOP)),
    *product(("arm",), ("program", "arm's process"), (signal.SIGKILL, signal.SIGSTOP)),
    ("arm", "program and of the arm's process", signal.SIGSTOP),
    *product(("gripper",), ("program",), (signal.SIGKILL, signal.SIGSTOP)),
)


def profile_of(mover: str) -> Profile:
    """A mover's bench without its finger in the way: only the program's end stops the motion."""
    far = {} if mover == "gripper" else {"plant.surface_m": "0.09"}
    return load_profile(MOTIONS[mover].profile, far)


def drive(mover: str, endpoints: Mapping[str, Any]) -> None:
    """The program to be killed: homes the mover, moves it, and samples it at 200 Hz."""
    device = assemble.build_rig(profile_of(mover), endpoints).devices[mover]
    device.open()
    device.apply(Home(mover))
    homed = False
    while True:
        device.read()
        if not homed and any(isinstance(status, Reached) for status in device.poll()):
            homed = True
            device.apply(MOTIONS[mover].command)
            print("moves", flush=True)
        time.sleep(0.005)


def child_of(pid: int) -> int:
    """The arm's process: the only child of the program."""
    (child,) = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return int(child)


def measured(mover: str, victim: str, ending: signal.Signals) -> tuple[float, float]:
    """Travel after the program's end, m, and its duration, s."""
    motion = MOTIONS[mover]
    scene = assemble.emulator_scene(profile_of(mover))
    scene["devices"] = {mover: scene["devices"][mover]}
    emulator = EmulatorProcess(scene)
    command = [sys.executable, "-m", "benchmarks.left_alone", mover, json.dumps(emulator.endpoints)]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert program.stdout is not None
        if program.stdout.readline() != "moves\n":
            raise RuntimeError(f"{mover}: the program ended before anything moved")
        from_m = emulator.scene()[motion.shown]
        while abs(emulator.scene()[motion.shown] - from_m) < motion.way_m:
            time.sleep(0.001)
        arm = {"arm's process": child_of(program.pid)} if mover == "arm" else {}
        for name, pid in {"program": program.pid, **arm}.items():
            if name in victim:
                os.kill(pid, ending)
        return gone_on(emulator, motion)
    finally:
        program.kill()
        program.wait()
        emulator.close()


def gone_on(emulator: EmulatorProcess, motion: MoverMotion) -> tuple[float, float]:
    """Watch until nothing moves."""
    began_s = still_s = time.monotonic()
    from_m = last_m = emulator.scene()[motion.shown]
    while (now_s := time.monotonic()) - still_s < SETTLED_S and now_s - began_s < GIVE_UP_S:
        place_m = emulator.scene()[motion.shown]
        if abs(place_m - last_m) > 1e-9:
            last_m, still_s = place_m, now_s
        time.sleep(0.002)
    return abs(last_m - from_m), still_s - began_s


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    repeats = QUICK_REPEATS if quick else REPEATS
    cases = []
    for mover, victim, ending in ENDS:
        found = np.array([measured(mover, victim, ending) for _ in range(repeats)])
        way_mm = 1e3 * found[:, 0]
        about: dict[str, Any] = {"mover": mover, "victim": victim, "signal": ending.name}
        about |= {"speed_mm_s": 1e3 * MOTIONS[mover].speed_m_s}
        ways = {"median_mm": float(np.median(way_mm)), "longest_mm": float(way_mm.max())}
        cases.append({**about, **ways, "way_mm": way_mm.tolist(), "wall_s": found[:, 1].tolist()})
        print(cases[-1], flush=True)
    save("left_alone", {"repeats": repeats, "cases": cases}, quick=quick)


if __name__ == "__main__":
    drive(sys.argv[1], json.loads(sys.argv[2]))
