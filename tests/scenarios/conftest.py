"""Whole campaigns on the mock bench, in virtual time."""

import json
import os
import pickle
import pty
import sys
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from config import assemble
from config.profile import Profile, load_profile
from controller.campaign import Campaign, Outcome
from controller.console import Console
from controller.recording.reader import Run, open_run
from run import cli
from simulator.devices.faults import Fault

QUICK = {"behavior.settle_s": "2.0", "detectors.contact.threshold_sigma": "8.0"}
"""The loop locks within a second; at the paper's three sigma a third of these trials would end by false contact."""

FEW = {
    "behavior.settle_s": "2.0",
    "detectors.contact.threshold_sigma": "8.0",
    "trials.repeats": "1",
    "trials.list": "["
    '{ location = "a", speed_m_s = 0.003785 }, { location = "d", speed_m_s = 0.004487 },'
    '{ location = "f", speed_m_s = 0.006435 }, { location = "f", speed_m_s = 0.00806 },'
    '{ location = "f", speed_m_s = 0.010685 }, { location = "f", speed_m_s = 0.011997 }]',
}
"""Six trials of Table I, for what is asked of a campaign and not of a trial; the loop locks within a second."""

STEPS = (
    '[{ do = "hold", duration_s = 0.2 }, { do = "load", duration_s = 0.2, speed_m_s = 0.0005 },'
    ' { do = "slip", duration_s = 0.4, speed_m_s = 0.01 }, { do = "roll", duration_s = 0.3, turn_rad = 0.1 }]'
)
SENSORS = ("fingertip", "flexible_finger", "barrett_finger", "wrist", "dsa")
FINGER = ("static", "stiffness", "locating", "transient", "flexion", "proximal", "tradeoff")
SHORTER = {
    "mock/slip": {
        "plant.surface_m": "0.0012",
        "loop.rate_hz": "50.0",
        **{f"behavior.sensors.{sensor}.steps": STEPS for sensor in SENSORS},
    },
    "mock/chirp": {"behavior.duration_s": "0.6"},
    "mock/pointer": {
        "behavior.angles_rad": "[0.0, 0.1]",
        "plant.surface_m": "0.0012",
        "behavior.rest_s": "0.1",
        "behavior.record_s": "0.2",
        "detectors.touch.baseline_s": "0.2",
        "loop.rate_hz": "50.0",
    },
    "mock/weights": {"behavior.cycles": "1", "behavior.preloads": "0"},
    **{f"mock/{name}": {"behavior.settle_s": "2.0"} for name in FINGER},
    "mock/flexion": {
        "behavior.settle_s": "2.0",
        "behavior.flexing_s": "4.0",
        "behavior.sweep_m_s": "0.004",
        "detectors.following.baseline_s": "8.0",
    },
    "mock/centering": {"behavior.open_speed_m_s": "0.05", "behavior.hold_s": "0.2", "loop.rate_hz": "50.0"},
    "mock/grasp": {
        "behavior.open_speed_m_s": "0.05",
        "behavior.hold_s": "0.5",
        "behavior.lift_speed_m_s": "0.06",
        "behavior.shake_s": "0.8",
        "loop.rate_hz": "50.0",
    },
}
"""Settings with which a trial of a shipped profile passes through all its states, and is short."""


def options(settings):
    """Settings as they are given on the command line."""
    return tuple(part for key, value in settings.items() for part in ("--set", f"{key}={value}"))


def run_of(out):
    """The folder of the only run in there."""
    return next(path.parent for path in Path(out).glob("*/manifest.json"))


def run_once(out, *options):
    """Runs `mock/transient` to its good end; gives the run's folder."""
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "mock/transient", *options, "--out", str(out)])
    assert ended.value.code == 0
    return run_of(out)


def change_manifest(folder, change):
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


class InTurn(Executor):
    """Runs each batch as it is submitted, on a copy of its order: two workers share no object of the program."""

    def submit(self, fn, /, *args, **kwargs):
        done = Future()
        try:
            done.set_result(fn(*pickle.loads(pickle.dumps(args)), **kwargs))
        except Exception as error:
            done.set_exception(error)
        return done


class Script(Console):
    """An operator who requests what the test wants, when the trial is where the test wants it."""

    def __init__(self, requests: dict[str, list[str]] | None = None) -> None:
        super().__init__()
        self.requests = requests or {}
        self.seen: list[tuple[str, float]] = []

    def poll(self) -> str | None:
        requests = self.requests.get(self.seen[-1][0]) if self.seen else None
        return requests.pop(0) if requests else None

    def state(self, name: str, t_s: float) -> None:
        self.seen.append((name, t_s))


@dataclass
class Bench:
    """A campaign that has been run, and what is left of it."""

    profile: Profile
    rig: Any
    script: Script
    outcome: Outcome

    @property
    def run(self) -> Run:
        return open_run(self.outcome.folder)

    @property
    def csv(self) -> str:
        return (self.outcome.folder / "trials.csv").read_text()

    @property
    def stage(self) -> Any:
        return self.rig.devices["stage"]


def run_campaign(
    out, name="mock/transient", *, trials=(16,), seed=1, script=None, faults=(), wrap=None, **sets
) -> Bench:
    """Runs a profile, shortened, with `--set` like overrides; the trials are those with the given numbers."""
    overrides = {**QUICK, **{key.replace("__", "."): value for key, value in sets.items()}}
    profile = load_profile(name, overrides)
    if faults:
        profile = replace(profile, faults=tuple(Fault(**fault) for fault in faults))
    rig = assemble.build_rig(profile)
    if wrap is not None:
        wrap(rig)
    chosen = [trial for trial in profile.trials(seed) if not trials or trial.id in trials]
    script = script or Script()
    plan = assemble.plan_campaign(profile, chosen, seed)
    outcome = Campaign(plan, rig, script, out).run()
    return Bench(profile, rig, script, outcome)


@pytest.fixture
def run_profile(tmp_path):
    """`run_campaign` into a folder of the test's own."""
    return partial(run_campaign, tmp_path / "runs")


@pytest.fixture
def script():
    """An operator without requests; the test gives them."""
    return Script()


@pytest.fixture
def verb(verb, monkeypatch):
    """As everywhere; figures are drawn elsewhere."""
    monkeypatch.setattr("controller.reports.figures.Figures.save", lambda *_: "<svg/>")
    return verb


@pytest.fixture
def at_terminal(monkeypatch):
    """Has the program read its keys from a terminal, at which nobody types; gives the other end."""
    hand, descriptor = pty.openpty()
    with os.fdopen(descriptor, "r") as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)
        yield hand
    os.close(hand)


@pytest.fixture(scope="module")
def local_cluster():
    """A Dask cluster of one worker in this process."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as started:
        yield started
