"""From slip to changed force over the wire, stage by stage; whole grasps beside a busy process.

`python -m benchmarks grasp_wire`: `emulated/grasp` in wall-clock time (ur_rtde, python-can over slcan, sound and sensor
board at once) beside one process that burns a core. In the first part the jaws press 2 N harder upon a slip that is
told, while the arm takes up the weight of an object that the first grip does not hold. Where the slip began is taken
from the recorded force: the first sample whose second difference leaves the noise. The second part is ours, as it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.grasp import drawn
from benchmarks.results import kept, progress, save
from benchmarks.soak import burners
from config.script import run_trials
from controller.recording.reader import Run
from simulator.physics.held_kernel import GRAVITY_M_S2

SEED, COUNT, PART = 64_000, 20, 4

REFLEX = {"behavior.rule": "step", "behavior.plateau_s": "0.0", "behavior.relax_s": "60.0"}
SHORT = {
    "behavior.center": "false",
    "behavior.lift_m": "0.01",
    "behavior.shake_m_s": "0.0",
    "behavior.hold_s": "0.5",
    "behavior.width_stream": "gripper.force",  # what its drive reports of its current, in the width's place
}

QUIET_S, RESTS_S, OUT = 1.0, 0.05, 6.0
"""Noise is estimated over so long before a slip is told; what is out of it, and how long it may be in between, belongs
to the slip; in deviations."""

HARDER_N, MEAN = 0.5, 5
"""The pad feels a changed force where the mean of so many samples has grown by this much."""

Floats = NDArray[np.float64]


def onset_s(times_s: Floats, force_n: Floats, told_s: float) -> float:
    """When a slip began that was told at `told_s`: see above."""
    before = (times_s > told_s - QUIET_S) & (times_s <= told_s)
    at_s, jerks = times_s[before][2:], np.abs(np.diff(force_n[before], 2))
    quiet = jerks[at_s < told_s - 0.5 * QUIET_S]
    out_s = at_s[jerks > OUT * np.median(quiet) / 0.6745]
    first_s = told_s
    for t_s in out_s[::-1].tolist():
        if first_s - t_s > RESTS_S:
            break
        first_s = t_s
    return first_s


def stages(run: Run, trial: int) -> Mapping[str, float] | None:
    """The first slip of a trial that made the jaws press harder, s; None where there was none."""
    events = run.events_of(trial)
    acted = [event for event in events if event["event"] == "SlipStarted" and event["state"] == "LOADING"]
    if not acted:
        return None
    told_s = float(acted[0]["t_s"])
    grips = [event for event in events if event["event"] == "Sent" and event["command"].startswith("Grip(")]
    sent_s = next((float(event["t_s"]) for event in grips if float(event["t_s"]) >= told_s), None)
    if sent_s is None:
        return None
    recording = run.trial(trial)
    pad, drive = recording.stream("signals.pad"), recording.stream("gripper.force")
    began_s = onset_s(pad.times_s, pad.values[:, 2], told_s)
    was = float(drive.values[drive.times_s <= sent_s, 0][-1])
    seen_s = drive.times_s[(drive.times_s > sent_s) & (np.abs(drive.values[:, 0]) > 1.02 * abs(was))]
    normal_n = np.convolve(pad.values[:, 3], np.full(MEAN, 1.0 / MEAN))[: len(pad.values)]
    level_n = float(np.median(normal_n[(pad.times_s > told_s - 0.2) & (pad.times_s <= told_s)]))
    felt_s = pad.times_s[(pad.times_s > told_s) & (normal_n > level_n + HARDER_N)]
    if not len(seen_s) or not len(felt_s):
        return None
    return {
        "told": told_s - began_s,
        "sent": sent_s - told_s,
        "drive": float(seen_s[0]) - sent_s,
        "felt": float(felt_s[0]) - sent_s,
        "whole": float(felt_s[0]) - began_s,
    }


def grasped(first: int, settings: Mapping[str, str]) -> list[Mapping[str, Any]]:
    """Some objects on the wire."""
    rows = []
    for thing in drawn(SEED, first + PART)[first:]:
        weight = {"behavior.weight_n": thing.mass_kg * GRAVITY_M_S2}
        rows.append({name: each for name, each in (thing.row({}) | weight).items() if name != "speed_m_s"})
    with TemporaryDirectory() as folder, burners(1):
        outcome, run = run_trials(
            "emulated/grasp", rows, settings=settings, seed=SEED + first, out=Path(folder), say=progress
        )
        made = {row["trial"]: row["outcome"] for row in run.trials}
        return [
            {
                "outcome": made.get(trial, outcome.line),
                "not_at_rest": list(outcome.not_at_rest),
                "stages": stages(run, trial) if trial in made and settings else None,
            }
            for trial in range(1, len(rows) + 1)
        ]


def _spread_ms(values_s: list[float]) -> Mapping[str, float]:
    median, p99 = np.quantile(1e3 * np.array(values_s), (0.5, 0.99)).tolist()
    return {"median": median, "p99": p99, "most": 1e3 * max(values_s)}


def main(*, quick: bool = False) -> None:
    """Both parts, some objects at a time: an interrupted study goes on."""
    result: dict[str, Any] = {}
    for name, settings in (("step upon slip", REFLEX | SHORT), ("ours", {})):
        rows: list[Mapping[str, Any]] = []
        for first in range(0, PART if quick else COUNT, PART):
            rows += kept(f"grasp_wire_{name.replace(' ', '_')}_{first}", partial(grasped, first, settings))
            known = [row["stages"] for row in rows if row["stages"]]
            result[name] = {
                "objects": len(rows),
                "outcomes": dict(Counter(row["outcome"] for row in rows)),
                "not_at_rest": sum(bool(row["not_at_rest"]) for row in rows),
                "slips": len(known),
            }
            if known and name != "ours":
                result[name]["ms"] = {
                    stage: _spread_ms([each[stage] for each in known]) for stage in known[0]
                }
            save("grasp_wire", result, quick=quick)
