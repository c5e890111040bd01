"""What decides a trial is what is shown of it: the profile of the README, which our detector stops."""

import base64
import json

import numpy as np
import pytest

from config import assemble
from config.profile import load_profile
from controller.reports.hero import hero_of
from controller.reports.report import build_report
from controller.reports.trial_signals import payload
from tests.scenarios.conftest import run_campaign
from tests.unit.controller.reports.synthetic_runs import text_of


def drawn(curve):
    """Times and values as the page unpacks them."""
    t0, t1, low, high = curve["span"]
    packed = [np.frombuffer(base64.b64decode(curve[name]), "<u2").astype(float) for name in ("t", "y")]
    times_s, values = (np.where(each == 65535, np.nan, each) / 65534 for each in packed)
    return t0 + times_s * (t1 - t0), low + values * (high - low)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Three approaches that our detector stops, beside the paper's that only listens."""
    sets = {"behavior.detector": "ours", "detectors.ours.baseline_s": "5.0"}
    return run_campaign(tmp_path_factory.mktemp("runs"), trials=(1, 2, 3), **sets)


def test_the_first_drawn_point_above_the_threshold_is_the_decision(bench):
    run = bench.run
    signals = json.loads(payload([run], 4_000_000))
    for row in run.trials:
        trial = signals[f"r0t{row['trial']}"]
        first = trial["panels"][0]
        assert first["label"] == "ours, σ"
        assert first["title"] == "ours: departure of phase and amplitude from the prediction"
        _, limits = drawn(first["threshold"])
        ((_, _, threshold, unit),) = [each for each in trial["thresholds"] if each[1] == "ours"]
        times_s, values = drawn(first["curves"][0])
        dot_s, dot = (first["curves"][0]["span"][end] for end in (1, 3))
        at_s = times_s[np.flatnonzero(values > threshold + dot / 65534)[0]]
        assert unit == "σ"
        assert limits.tolist() == pytest.approx([threshold] * 2)
        assert at_s == pytest.approx(row["detect_s"], abs=dot_s / 65534)
        assert at_s >= row["truth_contact_s"], "it was a true contact"
        assert len(times_s) > 50
        assert {each[1] for each in trial["thresholds"]} == {"ours", "contact"}


def test_a_figure_and_its_text_speak_of_the_detector_that_stopped(bench):
    run = bench.run
    for drawn in hero_of("transient", [run]):
        row = next(row for row in run.trials if row["trial"] == drawn.trial)
        assert (drawn.moments.detector, drawn.moments.decided_s) == ("ours", row["detect_s"])
        assert drawn.shown["streams"] == ["board.accelerometer", "detector.ours"]
        assert drawn.shown["marks"]["decided"] == row["detect_s"]
        statistic = run.trial(drawn.trial).stream("detector.ours")
        decided = statistic.between(row["detect_s"], row["detect_s"] + 1e-9)
        assert decided.values[0, 0] > decided.values[0, 1]
    text = text_of(build_report([run]))
    assert "“ours” (resonance, on board.accelerometer) compares the departure of phase and amplitude" in text
    assert "“ours” (resonance) stops the approaches, not the paper" in text
    assert "moving average" not in text
    assert "detectors.ours.baseline_s 5 " not in text


def test_a_column_in_hertz_is_empty_where_the_statistic_is_no_frequency(bench, run_profile):
    for row in bench.run.trials:
        assert row["threshold_hz"] is None
        assert 26.0 < row["baseline_hz"] < 30.0
    (row,) = run_profile(trials=(1,)).run.trials
    assert row["threshold_hz"] > row["baseline_hz"]


@pytest.mark.parametrize(
    ("name", "sets", "state", "deciding"),
    [
        ("mock/transient", {}, "APPROACH", "contact"),
        ("mock/transient", {"behavior.detector": "ours"}, "APPROACH", "ours"),
        ("mock/transient", {"behavior.detector": "ours"}, "RETRACTING", "ours"),
        ("mock/pointer", {}, "DESCENDING", "touch"),
        ("mock/touch", {}, "APPROACHING", "contact_ours"),
        ("mock/slip", {"behavior.reflex": "ours"}, "DESCENDING", "touch_fingertip"),
        ("mock/slip", {"behavior.reflex": "ours"}, "SLIPPING", "fingertip_ours"),
        ("mock/grasp", {}, "SEEKING_FORWARD", "left_ours"),
        ("mock/grasp", {}, "SEEKING_BACKWARD", "right_ours"),
        ("mock/grasp", {}, "CLOSING", "left_contact"),
        ("mock/grasp", {}, "HOLDING", "slip_ours"),
    ],
)
def test_of_several_detectors_the_one_whose_event_ends_the_state_comes_first(name, sets, state, deciding):
    profile = load_profile(name, sets)
    behavior = next(iter(assemble.plan_campaign(profile, profile.trials(1), 1).trials)).behavior
    behavior.state = state
    assert behavior.deciding[0] == deciding
