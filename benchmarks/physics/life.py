"""The plant in the bench's life: times real time, a trial of 95 s, an hour of bench, first use after install."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.physics import ours
from benchmarks.physics.model import HOLD, OUTPUT_HZ, Floats, Scene, scenes
from benchmarks.physics.timing import cpu_s
from drivers.mock.physics.finger import FingerPlant, FingerSettings

ROOT = Path(__file__).resolve().parents[2]

LONG_S = 20.0
"""Length of the scenes for times real time: what begins them does not matter."""

SETTLING_S, TRIAL_S, TURN_S = 90.0, 95.0, 0.05
"""A trial: settling that nobody reads, its end, and how often the rest is read."""

BEGUN_S = 92.0
"""When the probe sets out."""

SPEED_M_S, GAP_M = 0.004843, 0.003
"""Of the probe: Table I, location f; the bench's gap at the start."""

LISTENED = frozenset({"load_cell", "period"})
"""What a transient trial reads."""

HOUR_S = 3600.0

FIRST_USE = """
import json, sys, time
wall, cpu = time.perf_counter(), time.process_time()
from drivers.mock.physics.finger import FingerPlant, FingerSettings
settings = FingerSettings()
idle, numba = time.perf_counter() - wall, "numba" in sys.modules
plant = FingerPlant(settings)
plant.excite(True)
plant.advance(0.5, frozenset({"accelerometer", "period"}))
plant.sample("accelerometer", __import__("numpy").array([0.25]))
plant.advance(100.0)
plant.theta_rad
print(json.dumps([time.perf_counter() - wall, time.process_time() - cpu, idle, numba]))
"""
"""A first use: settings, a plant, an observed span, a jump. Prints seconds by both clocks, and of settings alone."""


class Speed(NamedTuple):
    """Of one scene with 1 kHz output, without and with the plant's noise."""

    scene: str
    noise: bool
    times_real: float


class TrialCost(NamedTuple):
    """Of a trial of 95 virtual seconds."""

    name: str
    at_once_ms: float
    """CPU time when the 5 s after settling are read in one go: the physics."""
    in_turns_ms: float
    """CPU time when they are read in turns of 50 ms: with what each call costs."""
    tiers: dict[str, float]
    theta_rad: float | None
    """Largest difference from the exact tier in the part that is read; None where noise makes them two of many."""


class FirstUse(NamedTuple):
    """Seconds to a plant's first samples."""

    wall_s: float
    cpu_s: float
    settings_s: float
    """Of which, importing and making settings, without a plant."""
    numba_for_settings: bool


def _lasting() -> Iterator[Scene]:
    """The three scenes, such that they go on as they are."""
    for scene in scenes(closed=True, duration_s=LONG_S):
        yield dataclasses.replace(scene, motion=HOLD) if scene.name == "bouncing" else scene


def speeds(*, quick: bool = False) -> list[Speed]:
    """Times real time with 1 kHz output, closed loop."""
    found = []
    for noise in (False,) if quick else (False, True):
        for scene in _lasting():
            settings = scene.settings.model_copy(update={"noise_scale": float(noise)})
            found.append(Speed(scene.name, noise, scene.duration_s / ours.taken_s(scene, settings)))
    return found


def _turns(begin_s: float, end_s: float) -> Iterator[Floats]:
    """Instants of the samples of each turn."""
    samples = round(TURN_S * OUTPUT_HZ)
    for first in range(round(begin_s * OUTPUT_HZ), round(end_s * OUTPUT_HZ), samples):
        yield np.arange(first + 1, first + samples + 1) / OUTPUT_HZ


def _trial(
    plant: FingerPlant, number: int, *, at_once: bool = False, thetas: list[float] | None = None
) -> None:
    """One trial as the bench runs it: settling unread, then turn by turn (or at once), the probe on its way at last."""
    plant.begin(key=(1, number), gap_m=GAP_M)
    plant.excite(True)
    plant.move_probe([(0.0, 0.0, 0.0, 0.0), (BEGUN_S, 0.0, SPEED_M_S, 0.0)])
    plant.advance(SETTLING_S)
    turns = list(_turns(SETTLING_S, TRIAL_S))
    for times_s in [np.concatenate(turns)] if at_once else turns:
        plant.advance(float(times_s[-1]), LISTENED)
        plant.sample("load_cell", times_s)
        plant.periods()
        if thetas is not None:
            thetas.append(plant.theta_rad)
    plant.contacts()


def trials() -> list[TrialCost]:
    """A trial with and without noise, with the default budget and exactly."""
    exact = _cost("exact, no noise", {"noise_scale": 0.0, "error_budget_rad": 0.0}, None)
    return [
        exact[0],
        _cost("within the budget, no noise", {"noise_scale": 0.0}, exact[1])[0],
        _cost("exact, noise", {"error_budget_rad": 0.0}, None)[0],
        _cost("within the budget, noise", {}, None)[0],
    ]


def _cost(name: str, changes: dict[str, float], exact: list[float] | None) -> tuple[TrialCost, list[float]]:
    """One kind of trial, and theta at the end of its turns."""
    settings = FingerSettings.model_validate(changes)
    plant, fresh = FingerPlant(settings), FingerPlant(settings)
    at_once_s, in_turns_s = cpu_s(lambda: _trial(plant, 1, at_once=True)), cpu_s(lambda: _trial(plant, 1))
    thetas: list[float] = []
    _trial(fresh, 1, thetas=thetas)
    tiers = {tier: float(seconds) for tier, seconds in fresh.account()["seconds"].items()}
    off = None if exact is None else float(np.max(np.abs(np.array(thetas) - exact)))
    return TrialCost(name, at_once_s * 1e3, in_turns_s * 1e3, tiers, off), thetas


def _resident_mb() -> float:
    """Memory of this process that is in use now: not its peak, which would hide what came before it."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def hour() -> dict[str, float]:
    """Growth of this process's memory in MB by an hour of bench: in trials of 95 s, and in one trial. Linux."""
    plant = FingerPlant(FingerSettings())
    for number in range(3):
        _trial(plant, number)
    start = _resident_mb()
    for number in range(int(HOUR_S / TRIAL_S)):
        _trial(plant, number)
    trials = _resident_mb()
    plant.begin(key=(1, 1), gap_m=GAP_M)
    plant.excite(True)
    for times_s in _turns(0.0, HOUR_S):
        plant.advance(float(times_s[-1]), LISTENED)
        plant.sample("load_cell", times_s)
        plant.periods()
        plant.contacts()
    return {
        "in trials of 95 s": trials - start,
        "in one trial of an hour, all of it read": _resident_mb() - trials,
    }


def memory_mb() -> dict[str, float]:
    """`hour` in a process of its own, which nothing else has made large."""
    code = "import json; from benchmarks.physics import life; print(json.dumps(life.hour()))"
    return dict(json.loads(_python(code, dict(os.environ))))


def _python(code: str, environment: dict[str, str]) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, check=True, capture_output=True, text=True
    ).stdout


def first_uses() -> dict[str, FirstUse]:
    """First use after install, which compiles, and the next, which finds the compiled code."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for name in ("compiling", "cached"):
            found[name] = FirstUse(*json.loads(_python(FIRST_USE, environment)))
    return found
