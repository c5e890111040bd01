"""Experiments with the finger: flexion, proximal, tradeoff, and the arm for a stage."""

import cmath
import math

import numpy as np
import pytest
from scipy.linalg import eigh

from behaviors.transient import Transient
from config.script import run_trials
from controller.reports.run_account import entered_s

SHORT = {"behavior.settle_s": "3.0", "detectors.ours.baseline_s": "3.0"}
AT_REST = {"behavior.settle_s": "3.0"}


def run_of(profile, folder, trials, settings):
    short = AT_REST if profile in ("mock/stiffness", "mock/locating") else SHORT
    _, run = run_trials(profile, trials, settings=short | settings, out=folder, say=lambda line: None)
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


def two_links_hz(contact_n_m, arm_m=0.05):
    """The faster resonance of the finger's two links, from the numbers of docs/explanation/finger_physics.md."""
    joint, base = 2.5, 0.0775
    stiffness = [[joint + contact_n_m * arm_m**2, -joint], [-joint, joint + base]]
    return math.sqrt(eigh(stiffness, np.diag([1.2e-4, 2.99e-4]), eigvals_only=True)[1]) / (2.0 * math.pi)


def test_the_ringing_is_at_the_resonance_of_the_links_and_at_the_papers_76_hz(tmp_path):
    contacts = [{}, {"plant.pad_n_m": 100.0}, {"plant.pad_n_m": 1e4}, {"location": "h"}]
    trials = [{"condition": "full" if contact else "none", **contact} for contact in contacts]
    rows = row_of("mock/stiffness", tmp_path, trials, {"behavior.record_s": "1.0"})
    expected_hz = [two_links_hz(0.0), two_links_hz(100.0), two_links_hz(1e4), two_links_hz(4220.0, 0.0373)]
    assert [row["ring_hz"] for row in rows] == pytest.approx(expected_hz, abs=0.4), "the joint wanders by 1 %"
    assert rows[2]["ring_hz"] == pytest.approx(76.0, abs=0.5), "II: the finger pad"


def test_the_phase_between_the_links_is_that_of_the_proximal_ones_own_equation(tmp_path):
    trials = [{"condition": "full", "location": location} for location in ("f", "h")]
    for row in row_of("mock/locating", tmp_path, trials, {"plant.noise_scale": "0.0"}):
        s = 2j * math.pi * row["frequency_hz"]
        ratio = (2.99e-4 * s**2 + 2.3e-3 * s + 2.5775) / (1.2e-3 * s + 2.5)
        assert row["phase_rad"] == pytest.approx(cmath.phase(ratio), abs=2e-3)


PROFILE = "mock/transient_arm"


def only_row(bench):
    (row,) = bench.run.trials
    return row


def test_a_trial_ends_by_contact_with_the_arms_stop_certificate(run_profile):
    bench = run_profile(PROFILE, trials=(1,))
    row = only_row(bench)
    assert [name for name, _ in bench.script.seen] == [
        state for state in Transient.states if state != "FAILED"
    ]
    assert row["outcome"] == "contact"
    assert row["onset_s"] < row["detect_s"] <= row["command_s"] < row["standstill_s"]
    # From 3.785 mm/s at 3 m/s2, and 20 ms in which nothing moves.
    assert row["standstill_s"] - row["command_s"] == pytest.approx(0.003785 / 3.0 + 0.02, abs=1e-6)
    cruising_m = 0.003785 * (row["command_s"] - row["detect_s"])
    assert row["stop_travel_m"] == pytest.approx(cruising_m + 0.003785**2 / (2 * 3.0), abs=1e-6)
    assert row["extent_m"] == pytest.approx(0.003785 * row["delay_s"], abs=1e-7)
    assert bench.run.manifest["roles"] == {"mover": "arm", "exciter": "board"}
    assert "arm.position" in bench.run.trial(1).streams
    assert "arm.force" not in bench.run.trial(1).streams, "it has no subscriber"
