"""Truth and rows are the same whoever looks and how often."""

from dataclasses import replace

import pytest

from behaviors.events import Tick
from behaviors.machine import Behavior, StatePlan, on
from config import assemble
from config.profile import load_profile
from controller.campaign import Campaign
from controller.console import Console
from controller.loop import Loop
from tests.scenarios.conftest import SHORTER, Script

KNOWN = {
    "mock/transient": {},
    "mock/flexion": {},
    "mock/weights": {},
    "mock/slip": {},
    "mock/centering": {},
    # the search is that of mock/centering
    "mock/grasp": {"behavior.center": "false", "trials.list": "[{ object_x_m = 0.0 }]"},
}
"""Profiles in whose first trial something touches, if it is to; every part of the benches is in one of them."""


EXACT = {"plant.error_budget_rad": "0"}
"""For the finger, which else jumps over what nobody observes: to another phase of its oscillation than it would have
computed, so that its next touch comes at another time, as in a trial with other noise."""


class Deaf(Behavior):
    """Commands what another behavior commanded, when it did, measures what it measured, and has no detector.

    Args:
        acts: When, which commands, and which streams are measured from then on.
        end_s: When the trial ended.
    """

    table = (on("deadline", "ACTING", "DONE"),)

    def __init__(self, acts, end_s):
        self._acts = list(acts)
        self._measures = frozenset()
        super().__init__({"ACTING": StatePlan(end_s)})

    @property
    def plan(self):
        return replace(super().plan, measures=self._measures)

    @property
    def due_s(self):
        return self._acts[0][0] if self._acts else super().due_s

    def begin(self, t_s):
        return [*super().begin(t_s), *self._act()]

    def handle(self, event):
        commands = list(super().handle(event))
        while isinstance(event, Tick) and self._acts and self._acts[0][0] <= event.t_s + 1e-9:
            commands += self._act()
        return commands

    def _act(self):
        _, commands, self._measures = self._acts.pop(0)
        return commands


def run_one(plan, rig, out, trial):
    outcome = Campaign(replace(plan, trials=[trial]), rig, Script(), out).run()
    assert outcome.error is None, outcome.error


def made(profile):
    """A plan of its first trial, that trial, and the bench turn by turn."""
    plan = assemble.plan_campaign(profile, profile.trials(0)[:1], 1)
    rig = replace(assemble.build_rig(profile), ahead=None)
    return plan, next(iter(plan.trials)), rig


@pytest.mark.parametrize("name", KNOWN)
def test_the_truth_is_the_same_with_every_detector_taken_away(name, tmp_path):
    exact = EXACT if name in ("mock/transient", "mock/flexion") else {}
    profile = load_profile(
        name,
        {"trials.order": '"listed"', **SHORTER.get(name, {}), "loop.rate_hz": "50.0", **exact, **KNOWN[name]},
    )
    plan, trial, rig = made(profile)
    seen, acts = [], []

    def noting(method):
        def noted(event):
            commands = method(event)
            if commands or not acts or behavior.plan.measures != acts[-1][2]:
                acts.append((rig.clock.now(), list(commands), behavior.plan.measures))
            return commands

        return noted

    def measured(evidence, outcome):
        seen.append((evidence, rig.clock.now()))
        return trial.measure(evidence, outcome)

    behavior = trial.behavior
    behavior.begin, behavior.handle = noting(behavior.begin), noting(behavior.handle)
    run_one(plan, rig, tmp_path, replace(trial, measure=measured))
    (heard, end_s), *_ = seen
    assert "truth" in rig.known() and (heard.detectors or name == "mock/weights")

    plan, trial, rig = made(profile)
    deaf = replace(
        trial,
        behavior=Deaf(acts, end_s),
        detectors={},
        measure=lambda evidence, outcome: seen.append((evidence, 0.0)) or (outcome, {}),
    )
    run_one(plan, rig, tmp_path, deaf)
    unheard = seen[-1][0]
    assert not any(True for _ in unheard.events if type(_).__name__ in ("Contact", "SlipStarted", "PreTouch"))

    assert (unheard.truth, unheard.slips, unheard.lifts) == (heard.truth, heard.slips, heard.lifts)
    row = trial.measure(heard, "held")
    judged_by_the_other = trial.measure(
        replace(heard, truth=unheard.truth, slips=unheard.slips, lifts=unheard.lifts), "held"
    )
    for column, value in row[1].items():
        assert judged_by_the_other[1][column] == pytest.approx(value, abs=1e-9, nan_ok=True), column
    assert row[0] == judged_by_the_other[0]


def ran(name, folder, *, together):
    profile = load_profile(name, SHORTER.get(name, {}))
    rig = assemble.build_rig(profile)
    if not together:
        rig = replace(rig, ahead=None)
    plan = assemble.plan_campaign(profile, profile.trials(1)[:1], 1)
    found = Campaign(plan, rig, Console(), folder).run().folder
    return [(found / file).read_bytes() for file in ("trials.csv", "events.jsonl")]


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("mock/transient", 3),
        ("mock/flexion", 1.5),  # its behavior moves the tendon ten times a second
        ("mock/pretouch", 3),
        ("mock/centering", 3),
    ],
)
def test_rows_and_events_are_the_same_to_the_byte(name, times, tmp_path, monkeypatch):
    """With faults besides: the swarm, where a slow disk has turns taken one by one."""
    turn, turned = Loop._turn, []
    monkeypatch.setattr(Loop, "_turn", lambda loop, *now: turned.append(1) or turn(loop, *now))
    together = ran(name, tmp_path / "together", together=True)
    few = len(turned)
    assert ran(name, tmp_path / "apart", together=False) == together
    assert few < (len(turned) - few) / times, "most turns were taken together"


def test_what_is_looked_at_at_once_is_not_cut_where_a_stream_could_fall_silent(tmp_path, monkeypatch):
    """With nothing to fear from a device, 4,000 turns of a trial are some 60 looks."""
    looked, look = [], Loop._look
    monkeypatch.setattr(Loop, "_look", lambda loop: looked.append(1) or look(loop))
    ran("mock/pretouch", tmp_path, together=True)
    assert len(looked) < 120
