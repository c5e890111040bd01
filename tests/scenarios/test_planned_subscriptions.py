"""What `plan` prints of each state is what a run of that trial arms and subscribes to."""

import re
from collections import defaultdict

import pytest

from config.assemble import build_rig, plan_campaign
from config.costs import planned
from config.profile import load_profile
from config.trials import distinct
from controller.campaign import Campaign
from controller.loop import Loop
from controller.registry import EXPERIMENTS
from tests.scenarios.conftest import SHORTER

PROFILES = [f"mock/{name}" for name in EXPERIMENTS if name != "aura"]
PROFILES += ["mock/pretouch", "mock/touch", "mock/transient_arm"]


def groups_of(printed):
    """Of each group of trials: the first one, the guard's streams, and detectors and streams of each state."""
    groups, states = [], []
    lines = "\n".join(printed).splitlines()
    for line in lines[lines.index(next(line for line in lines if line.startswith("force "))) + 1 :]:
        head, _, rest = line.partition(" ")
        if head == "trials" or not groups:
            groups.append((int((re.findall(r"^ *(\d+)", rest) or [1])[0]), set(), defaultdict(list)))
        if head == "guard":
            groups[-1][1].update(rest.partition(":")[0].strip().split(", "))
        elif head.rstrip(",").isupper():
            states = line.split(", ")
        elif states and not head:
            named = re.findall(r"(\S+) \(([^)]*)\)", line)
            inputs = {name: given.split(", ") for name, given in named if given != "recorded"}
            recorded = {name for name, given in named if given == "recorded"}
            for state in states:
                groups[-1][2][state].append((set(inputs), recorded.union(*inputs.values())))
    return groups


@pytest.mark.parametrize("name", PROFILES)
def test_a_run_arms_and_subscribes_to_what_plan_prints(name, script, tmp_path, monkeypatch):
    profile = load_profile(name, SHORTER.get(name, {}))
    trials = profile.trials(0)
    printed = list(planned(profile, trials, plan_campaign(profile, distinct(trials), 0), 1))
    arrange, seen = Loop._arrange, []

    def watched(loop, commands):
        arrange(loop, commands)
        seen.append((loop._trial.behavior.state, set(loop._trial.armed), set(loop._trial.subscribed)))

    monkeypatch.setattr(Loop, "_arrange", watched)
    for number, guarded, states in groups_of(printed):
        seen.clear()
        only = [trial for trial in trials if trial.id == number]
        Campaign(plan_campaign(profile, only, 0), build_rig(profile), script, tmp_path).run()
        assert {state for state, *_ in seen} - states.keys() == {"DONE"}
        for state, armed, subscribed in seen:
            if state != "DONE":
                fits = [streams for planned_detectors, streams in states[state] if planned_detectors == armed]
                assert any(
                    subscribed == streams | guarded if streams else subscribed <= guarded for streams in fits
                ), (state, armed, subscribed)
