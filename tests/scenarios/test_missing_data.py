"""A device that falls silent, loses, corrupts or sticks ends the trial as a fault that names it, in each experiment."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from config import assemble
from config.profile import Profile, load_profile
from controller.campaign import EXIT_DEVICE, Campaign, Outcome
from controller.recording.reader import Run, open_run
from controller.registry import experiment_of
from simulator.devices.faults import Fault
from tests.scenarios.conftest import SHORTER, Script


class Case(NamedTuple):
    """A short trial of a profile; a line for each device and state in which it has to arrive, and how it does not."""

    profile: str
    trial: int
    settings: dict[str, str]
    faults: str


SLIP = SHORTER["mock/slip"]
SLOWLY = {"loop.rate_hz": "50"}
SONIC = {"behavior.clear_m": "0.01", "behavior.handling_speed_m_s": "0.06"}
REST = {"behavior.settle_s": "1.0", "behavior.rest_s": "0.1", "behavior.record_s": "2.0"}
WEIGHTS = {"behavior.cycles": "1", "behavior.preloads": "0", "behavior.weights_x_n": "[1.0, 2.0]"}
EIGHT = {"behavior.settle_s": "2.0", "detectors.contact.threshold_sigma": "8.0", "loop.rate_hz": "200"}
"""With fewer turns the guard refuses its fastest approach."""

CASES = {
    "static": Case("mock/static", 1, REST, "board RECORDING silent, losing"),
    "transient": Case(
        "mock/transient",
        42,
        EIGHT,
        """board BASELINE stuck
        board APPROACH corrupt
        stage HOLDING silent""",
    ),
    "weights": Case("mock/weights", 1, WEIGHTS, "board RECORDING losing"),
    "pointer": Case(
        "mock/pointer",
        1,
        {**SHORTER["mock/pointer"], "limits.range_streams": "[]"},
        """board TURNING silent
        board RECORDING corrupt
        arm TURNING stuck
        arm RECORDING losing""",
    ),
    "slip of the fingertip": Case("mock/slip", 1, SLIP, "board RESTING losing"),
    "slip of the hand": Case("mock/slip", 7, SLIP, "hand RESTING stuck"),
    "slip of the wrist": Case("mock/slip", 10, SLIP, "arm SLIPPING losing"),
    "slip of the matrix": Case("mock/slip", 13, SLIP, "matrix RESTING corrupt"),
    "chirp": Case("mock/chirp", 1, SHORTER["mock/chirp"], "audio SWEEPING losing"),
    "pretouch": Case("mock/pretouch", 4, SONIC, "audio BASELINE stuck\naudio APPROACHING losing"),
    "touch": Case("mock/touch", 1, SONIC, "arm HOLDING silent"),
    "objects": Case("mock/objects", 2, {**SONIC, "behavior.cycles": "1"}, "audio RETRACTING losing"),
    "centering": Case(
        "mock/centering",
        4,
        SONIC,
        """audio BASELINE silent
        arm SEEKING_BACKWARD corrupt
        gripper RESTING silent""",
    ),
}
"""Every device of every experiment once, and every kind of fault with several; each stream and kind by itself:
tests/unit/controller/test_arrivals.py."""

FAULTS = {kind: {"kind": kind} for kind in ("silent", "corrupt", "stuck")} | {
    "losing": {"kind": "lose", "for_s": 0.06}
}


class Bench(NamedTuple):
    """A campaign of one trial, and what is left of it."""

    profile: Profile
    outcome: Outcome
    run: Run


def run(name: str, folder: Path, faults: Sequence[dict[str, Any]] = ()) -> Bench:
    case = CASES[name]
    profile = replace(
        load_profile(case.profile, SLOWLY | case.settings), faults=tuple(Fault(**each) for each in faults)
    )
    trials = [trial for trial in profile.trials(1) if trial.id == case.trial]
    plan = assemble.plan_campaign(profile, trials, 1)
    outcome = Campaign(plan, assemble.build_rig(profile), Script(), folder).run()
    return Bench(profile, outcome, open_run(outcome.folder))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Undisturbed runs, each made once."""
    made: dict[str, Bench] = {}

    def get(name: str) -> Bench:
        if name not in made:
            made[name] = run(name, tmp_path_factory.mktemp("healthy"))
        return made[name]

    return get


def middle_s(bench: Bench, state: str) -> float:
    """Bench time in the middle of a state's last visit."""
    changes = [(event["next"], event["t_s"]) for event in bench.run.events if event["next"] != event["state"]]
    at = max(place for place, (name, _) in enumerate(changes) if name == state)
    return float(changes[at][1] + changes[at + 1][1]) / 2


def numbers(bench: Bench) -> dict[str, Any]:
    """What was measured, by the only row."""
    (row,) = bench.run.trials
    measured = import_module(experiment_of(bench.profile.experiment).measures).COLUMNS
    return {name: row[name] for name in measured if row.get(name) not in (None, "")}


SCENES = [
    (name, *line.split()[:2], kind)
    for name, case in CASES.items()
    for line in case.faults.splitlines()
    for kind in line.split(maxsplit=2)[2].split(", ")
]


@pytest.mark.parametrize(("name", "device", "state", "kind"), SCENES)
def test_what_does_not_arrive_ends_the_trial_as_a_fault_that_names_it(
    tmp_path, healthy, name, device, state, kind
):
    bench = healthy(name)
    # The shortened centering grips nothing: that is a result, and ends the run as a failure.
    assert bench.run.trials[0]["outcome"] not in ("fault", "guard", "aborted"), bench.outcome.line
    fault = {"device": device, "at_s": middle_s(bench, state), **FAULTS[kind]}
    bench = run(name, tmp_path, [fault])
    assert bench.outcome.exit_code == EXIT_DEVICE, bench.outcome.line
    assert bench.run.trials[0]["outcome"] == "fault"
    reason = {"stuck": "sticks at", "losing": "no samples from"}.get(kind, "is silent for")
    assert reason in bench.outcome.line or "no samples from" in bench.outcome.line
    assert device in bench.outcome.line
    assert numbers(bench) == {}, "no number from what did not arrive"
