"""A3, A4 and A5 over serial lines: the streams that the first experiment has not arrive, and are measured."""

import numpy as np

from config.script import run_trials
from controller.campaign import EXIT_DONE

QUICK = {"behavior.settle_s": "0.5", "detectors.ours.baseline_s": "1.5", "plant.noise_scale": "0.2"}


def row_of(name, folder, trial, settings):
    outcome, run = run_trials(
        f"emulated/{name}", [trial], settings=settings, out=folder, say=lambda line: None
    )
    assert outcome.exit_code == EXIT_DONE, outcome.line
    (row,) = run.trials
    return row, run.trial(row["trial"])


def test_the_tendon_is_moved_and_recorded_over_the_wire(tmp_path):
    sweep = {
        # rest and sweep end with the baseline: of a sweep that was not learned every flexing is a contact
        "behavior.rest_s": "1.0",
        "behavior.sweep_m_s": "0.01",
        "behavior.flexing_s": "1.0",
        "detectors.following.baseline_s": "3.0",
    }
    trial = {"location": "f", "speed_m_s": 0.006435, "tendon_m_s": 0.002}
    row, recording = row_of("flexion", tmp_path, trial, QUICK | sweep)
    assert row["free_rise_hz"] > 2.0, "V.C: flexing raises the resonance"
    tendon_m = recording.stream("board.tendon").values
    assert np.ptp(tendon_m) > 0.002, "the sweep, and 1 s of flexing at 2 mm/s"


def test_the_link_that_was_touched_is_identified_over_the_wire(tmp_path):
    calm = QUICK | {"detectors.contact.baseline_s": "1.5", "detectors.contact.threshold_sigma": "8.0"}
    row, recording = row_of("proximal", tmp_path, {"location": "f", "speed_m_s": 0.006435}, calm)
    assert (row["outcome"], row["identified"]) == ("contact", "distal")
    assert not recording.stream("board.distal").gaps


def test_each_threshold_is_judged_on_what_arrived_over_the_wire(tmp_path):
    # noise as it is: over a calmer baseline 100 sigma would stop the probe on its way
    short = QUICK | {"detectors.contact.baseline_s": "1.5", "plant.noise_scale": "1.0"}
    row, recording = row_of("tradeoff", tmp_path, {"location": "f", "speed_m_s": 0.011997}, short)
    for sense in ("frequency", "amplitude", "phase", "all"):
        assert row[f"{sense}_before"] < row[f"{sense}_later"], sense
    assert not recording.stream("board.accelerometer").gaps
