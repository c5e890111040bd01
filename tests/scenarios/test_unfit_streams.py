"""Streams: what a run subscribes to, and what cannot use its stream."""

import re
import warnings
from collections import defaultdict
from dataclasses import replace

import pytest

from config import assemble
from config.assemble import build_rig, plan_campaign
from config.costs import planned
from config.profile import load_profile
from config.source import ProfileError
from config.trials import distinct
from controller.campaign import EXIT_GUARD, EXIT_USAGE, Campaign
from controller.loop import Loop
from controller.recording.reader import open_run
from controller.registry import EXPERIMENTS
from controller.reports.report import build_report
from tests.scenarios.conftest import SHORTER


@pytest.fixture
def run(tmp_path, script):
    """Runs the first trial of a profile; returns the outcome, the run and the rig."""

    def run(name, wrap=None, **sets):
        overrides = {key.replace("__", "."): value for key, value in sets.items()}
        profile = load_profile(name, overrides)
        rig = assemble.build_rig(profile)
        if wrap is not None:
            wrap(rig)
        trials = [trial for trial in profile.trials(0) if trial.id == 1]
        outcome = Campaign(assemble.plan_campaign(profile, trials, 0), rig, script, tmp_path).run()
        return outcome, open_run(outcome.folder), rig

    return run


def test_a_signal_that_cannot_use_its_stream_ends_the_run_in_one_line(run):
    outcome, kept, rig = run("mock/pretouch", signals__right__channel="5")
    assert (outcome.exit_code, outcome.error) == (EXIT_USAGE, None)
    assert outcome.line.startswith("audio.fingers: 4 channels where signals.right needs 12")
    assert [row["outcome"] for row in kept.trials] == ["fault"]
    assert kept.manifest["exit"]["reason"] == outcome.line
    assert not rig.devices["arm"].axis.moving(rig.clock.now())


def test_a_stream_that_is_no_sound_is_not_taken_for_an_envelope(run):
    outcome, _, _ = run("mock/pretouch", signals__right__input="arm.pose")
    assert outcome.exit_code == EXIT_USAGE
    assert "neither sound nor an envelope" in outcome.line


def test_a_detector_that_loses_its_rate_while_the_arm_descends_stops_the_arm(run):
    moved_m = []

    def wrap(rig):
        arm, board = rig.devices["arm"], rig.devices["board"]
        read = board.read

        def irregular():
            now_s = rig.clock.now()
            moving = arm.axis.moving(now_s) and arm.axis.position(now_s) > 5e-4
            if moving:
                moved_m.append(arm.axis.position(now_s))
            return [replace(b, rate_hz=None, times_s=b.times) if moving else b for b in read()]

        board.read = irregular

    outcome, kept, rig = run("mock/pointer", wrap)
    assert moved_m, "the arm was on its way down"
    assert outcome.exit_code == EXIT_USAGE
    assert outcome.line.startswith("touch: signals.tip: samples at irregular times")
    assert [row["outcome"] for row in kept.trials] == ["fault"]
    assert not rig.devices["arm"].axis.moving(rig.clock.now())


def test_a_guard_that_would_watch_nothing_refuses_before_anything_moves(run):
    outcome, kept, _ = run("mock/transient", limits__force_stream="board.nix")
    assert outcome.exit_code == EXIT_GUARD
    assert "board.nix: the bench has no such stream" in outcome.line
    assert [row["outcome"] for row in kept.trials] == ["guard"]
    assert not any(event["event"] == "Sent" and "Move" in str(event) for event in kept.events)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert build_report([kept]).is_file(), "a trial without samples of the finger is drawn as nothing"


def test_a_detector_that_a_behavior_listens_to_must_be_there():
    profile = load_profile("mock/centering", {})
    others = {name: entry for name, entry in profile.detectors.items() if name != "left_ours"}
    without = replace(profile, detectors=others)
    with pytest.raises(ProfileError, match="listens to a detector 'left_ours'"):
        assemble.plan_campaign(without, without.trials(0), 0)


def test_signals_that_are_made_of_each_other_are_a_mistake_of_the_profile():
    circle = {"signals.right.input": "signals.left", "signals.left.input": "signals.right"}
    with pytest.raises(ProfileError, match="goes in a circle, right → left → right"):
        load_profile("mock/pretouch", circle)


PROFILES = [
    f"mock/{name}"
    for name in {kind.made: name for name, kind in EXPERIMENTS.items()}.values()
    if name != "aura"
]
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
    profile = load_profile(name, SHORTER.get(name, {}) | {"loop.rate_hz": "50.0"})
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
