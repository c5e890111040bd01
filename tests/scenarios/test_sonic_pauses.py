"""Trials of the sonic fingers on the mock bench, paused in every state that they pass through."""

from dataclasses import replace
from itertools import pairwise

import pytest

from behaviors.aura import Aura
from behaviors.centering import Centering
from config import assemble
from config.profile import load_profile
from controller.campaign import EXIT_DONE, EXIT_FAILED, Campaign
from controller.recording.reader import open_run

PAUSE_AFTER = 15
"""Turns from a state's beginning to the pause: the arm is under way by then."""

START_X_M = 0.4
"""Base frame: devices.arm.start_pose of mock/bench_aura."""


def run_one(out, operator, name, row, code=EXIT_DONE, **sets):
    profile = load_profile(name, {"trials.repeats": "1"} | sets, rows=[row], labels=["the trial"])
    plan = assemble.plan_campaign(profile, profile.trials(0), 1)
    rig = replace(assemble.build_rig(profile), ahead=None)  # turn by turn: the operator counts them
    outcome = Campaign(plan, rig, operator, out).run()
    assert outcome.exit_code == code, outcome.line
    return open_run(outcome.folder)


def pause_everywhere(script, behavior):
    requests = {state: [None] * PAUSE_AFTER + ["pause"] for state in behavior.states}
    script.requests = requests | {"PAUSED": ["resume"] * 100}


def paused_in(script):
    return {before for before, state in pairwise(name for name, _ in script.seen) if state == "PAUSED"}


def alive(behavior):
    return set(behavior.states) - {"DONE", "FAILED"}


@pytest.mark.parametrize(("rate_hz", "cycles"), [("100.0", "2"), ("200.0", "1")])
def test_a_touch_that_is_paused_everywhere_is_made_and_goes_no_deeper_than_its_path(
    tmp_path, script, rate_hz, cycles
):
    pause_everywhere(script, Aura)
    row = {"side": "back", "speed_m_s": 0.01}
    sets = {"loop.rate_hz": rate_hz, "behavior.cycles": cycles}
    run = run_one(tmp_path, script, "mock/touch", row, **sets)
    assert paused_in(script) >= alive(Aura) - {"STOPPING"}, "it stands within fewer turns"
    (measured,) = run.trials
    assert (measured["outcome"], measured["approaches"]) == ("contact", int(cycles)), measured
    assert measured["felt_ours"] == measured["touches"] >= int(cycles), measured
    assert run.trial(1).stream("arm.pose").values[:, 0].max() < START_X_M + 0.0565 + 1e-4


def test_a_search_that_is_paused_everywhere_finds_the_middle_and_touches_nothing(tmp_path, script):
    pause_everywhere(script, Centering)
    row = {"object_x_m": 0.006, "speed_m_s": 0.01, "method": "ours"}
    (measured,) = run_one(tmp_path, script, "mock/centering", row, code=EXIT_FAILED).trials
    braking = {"REVERSING", "TURNING", "STOPPING"}
    after_a_grip_that_was_not_broken_off = {"CONFIRMING", "HOLDING", "BACKING_OFF"}
    assert paused_in(script) >= alive(Centering) - braking - after_a_grip_that_was_not_broken_off
    assert measured["outcome"] == "not_gripped", "a pause broke the grip off"
    assert measured["touched"] == 0
    assert abs(measured["error_m"]) < 0.0032, "docs: the level crossing of the matched filter"


@pytest.mark.parametrize("state", ["HOLDING", "RELEASING"])
def test_a_grip_that_was_confirmed_stands_after_a_pause(tmp_path, script, state):
    script.requests = {state: ["pause"], "PAUSED": ["resume"]}
    row = {"object_x_m": 0.006, "speed_m_s": 0.03, "method": "ours"}
    (measured,) = run_one(tmp_path, script, "mock/centering", row).trials
    names = [name for name, _ in script.seen]
    after = names[names.index("PAUSED") + 1 :]
    assert after == list(dict.fromkeys([state, "RELEASING", "LEAVING", "DONE"]))
    assert measured["outcome"] == "centered"
