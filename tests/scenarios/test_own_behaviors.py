"""Behaviors of the user's own that drive on after a stop, call it a success, or command what is none."""

import json
from types import SimpleNamespace

import pytest

LIMIT_N = 0.05

MODULE = '''
"""Drive into the finger, whatever happens."""

import math

import numpy as np

from touchbench import Behavior, Home, MoveAt, MoveTo, Settings, StatePlan, on

COLUMNS = ("peak_n",)
ENDS = ("guard_stopped", "failed", "stalled")


class DriveSettings(Settings):
    mover: str = "stage"
    measured_to: str = "HOMING"


class DriveFactors(Settings):
    number: int


class Drive(Behavior):
    table = (
        on("reached", "HOMING", "DRIVING"),
        on("reached", "DRIVING", "DONE"),
        on("deadline", ["HOMING", "DRIVING"], "DONE"),
    )
    driving_s = 20.0

    def __init__(self, settings: DriveSettings, factors: DriveFactors, detectors: frozenset[str]) -> None:
        measured = frozenset({"board.load_cell", "stage.position"})
        plans = dict.fromkeys(self.states, StatePlan(60.0))
        plans["DRIVING"] = StatePlan(self.driving_s, measures=measured)
        super().__init__({name: plans[name] for name in self.states if name not in self.final}, mover="stage")

    def enter_HOMING(self):
        self.command(Home("stage"))

    def enter_DRIVING(self):
        self.command(MoveAt("stage", 0.005, 0.012))

    def enter_DONE(self):
        self.conclude("contact")


class Again(Drive):
    table = (*Drive.table, *(on(name, "DRIVING", "DRIVING") for name in (*ENDS, "standstill")))


class AtTheEnd(Drive):
    enter_FAILED = Drive.enter_DRIVING


class Back(Drive):
    table = (*Drive.table, on("guard_stopped", "DRIVING", "BACK"), on("reached", "BACK", "DONE"))

    def enter_BACK(self):
        self.command(MoveTo("stage", 0.0, 0.01))


class NotANumber(Drive):
    def enter_DRIVING(self):
        self.command(MoveTo("stage", 0.005, np.float32("nan")))


class NoCommand(Drive):
    def enter_DRIVING(self):
        self.command(None)


class Endless(Drive):
    driving_s = math.nan


def measure(evidence, settings, outcome):
    evidence.entered_s[settings.measured_to]
    if "DRIVING" not in evidence.entered_s:
        return "contact", {"peak_n": None}
    _, force_n = evidence.series("board.load_cell", evidence.entered_s["DRIVING"], evidence.events[-1].t_s)
    return "contact", {"peak_n": float(np.abs(force_n).max())}
'''

PROFILE = """
extends = "mock/bench_resonance"
experiment = "own_drive:{name}"
title = "Drive on"

[limits]
force_n = {limit_n}
travel_m = 0.018

[trials]
list = [ {{ number = 1 }}, {{ number = 2 }} ]
"""


@pytest.fixture
def drive(verb, tmp_path):
    """Runs a behavior of the module."""

    def drive(name, *more):
        (tmp_path / "own_drive.py").write_text(MODULE)
        (tmp_path / "drive.toml").write_text(PROFILE.format(name=name, limit_n=LIMIT_N))
        code, _, err = verb("run", tmp_path / "drive.toml", "--no-report", "--out", tmp_path / "runs", *more)
        found = SimpleNamespace(code=code, err=err, rows=[], events=[])
        for folder in tmp_path.glob("runs/*"):
            header, *rows = (folder / "trials.csv").read_text().splitlines()
            found.rows = [dict(zip(header.split(","), row.split(","), strict=True)) for row in rows]
            found.events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
        return found

    return drive


def stops(run):
    return [event for event in run.events if event["event"] == "GuardStopped"]


@pytest.mark.parametrize("name", ["Again", "AtTheEnd", "Back"])
def test_the_guards_stop_holds_and_is_no_success(drive, name):
    run = drive(name)
    assert run.code == 4
    assert run.err.count("\n") == 1, run.err
    assert "beyond limits.force_n = 0.05" in run.err
    (row,) = run.rows
    assert row["outcome"] == "guard"
    assert LIMIT_N < float(row["peak_n"]) < 1.5 * LIMIT_N, "what a stage at 5 mm/s presses while it brakes"
    (stop,) = stops(run)
    assert run.events[-1]["t_s"] - stop["t_s"] < (1.0 if name == "Back" else 0.1)
    assert ("refused MoveAt(stage)" in run.err) == (name in ("Again", "AtTheEnd"))


def test_a_measure_that_does_not_expect_the_stop_hides_it_neither(drive):
    run = drive("Drive", "--set", "behavior.measured_to=DONE")
    assert run.code == 4
    assert "beyond limits.force_n = 0.05; not measured: KeyError: 'DONE'" in run.err
    assert [row["outcome"] for row in run.rows] == ["guard"]


def test_a_way_out_leads_back_before_the_trial_ends(drive):
    reached = [event for event in drive("Back").events if event["event"] == "Reached"]
    assert (reached[-1]["next"], reached[-1]["position_m"]) == ("DONE", pytest.approx(0.0, abs=1e-6))


@pytest.mark.parametrize(("device", "kind"), [("stage", "stall"), ("board", "unplug")])
def test_a_failure_ends_the_trial_as_a_fault(drive, device, kind):
    run = drive("Again", "--set", f'faults=[{{device="{device}",kind="{kind}",at_s=0.3}}]')
    assert run.code == 3
    assert [row["outcome"] for row in run.rows] == ["fault"]
    assert run.events[-1]["t_s"] < 0.5


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("NotANumber", 4, ["MoveTo(stage)", "speed_m_s is nan"]),
        ("NoCommand", 1, ["own_drive.py", "NoCommand commanded None in DRIVING"]),
        ("Endless", 2, ["Endless", "deadline_s of DRIVING is nan"]),
    ],
)
def test_what_is_no_command_is_refused_in_one_line_that_names_it(drive, name, code, words):
    run = drive(name)
    assert run.code == code
    assert run.err.count("\n") == 1, run.err
    assert all(word in run.err for word in words), run.err
    assert not stops(run)
