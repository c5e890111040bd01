"""A3, A4 and A5 on the mock bench, shortened: the paper's claims, from the profiles that ship."""

import pytest

from config.script import run_trials
from controller.reports.run_account import entered_s

SHORT = {"behavior.settle_s": "3.0", "detectors.ours.baseline_s": "3.0"}


def run_of(profile, folder, trials, settings):
    _, run = run_trials(profile, trials, settings=SHORT | settings, out=folder, say=lambda line: None)
    return run


def row_of(profile, folder, trials, settings):
    return run_of(profile, folder, trials, settings).trials


def test_the_fixed_threshold_calls_flexion_a_contact_and_the_one_that_follows_finds_the_touch(tmp_path):
    settings = {
        "behavior.sweep_m_s": "0.002",
        "behavior.flexing_s": "3.0",
        "detectors.following.baseline_s": "12.0",
        "plant.noise_scale": "0.2",
    }
    trial = {"location": "f", "speed_m_s": 0.004843, "tendon_m_s": 0.002}
    run = run_of("mock/flexion", tmp_path, [trial], settings)
    (row,) = run.trials
    assert row["free_rise_hz"] > 2.0, "V.C: flexing raises the resonance"
    assert row["contact_share"] > 0.5
    assert row["following_share"] < 0.3
    assert row["following_blind"] == 0
    assert 0.0 < row["following_event_s"] < 0.7
    entered = entered_s(run, row["trial"])
    swept_s = entered["FLEXING"] - entered["BASELINE"]
    assert swept_s == pytest.approx(12.0, abs=1.0), "the curve is drawn from the whole sweep, the baseline"


def test_the_link_that_was_touched_is_identified(tmp_path):
    trials = [{"location": location, "speed_m_s": 0.006435} for location in ("p", "f")]
    rows = row_of("mock/proximal", tmp_path, trials, {"plant.noise_scale": "1.0"})
    assert {row["location"]: row["identified"] for row in rows} == {"p": "proximal", "f": "distal"}


def test_every_threshold_is_judged_on_an_approach_that_was_not_stopped(tmp_path):
    trial = {"location": "f", "speed_m_s": 0.006435}
    (row,) = row_of("mock/tradeoff", tmp_path, [trial], {"detectors.contact.baseline_s": "3.0"})
    assert row["outcome"] == "recorded"
    assert row["all_before"] < 4.6 < row["all_soon"] == pytest.approx(row["all_later"], abs=10.0)
    assert row["average_soon"] < row["average_later"]
