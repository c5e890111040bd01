"""Short experiments over the wire: weights, a bench at rest, flexion."""

import tomllib

import numpy as np

from config.script import run_trials
from config.verbs.quiet import quiet
from controller.campaign import EXIT_DONE
from controller.recording.reader import open_run
from tests.program import Terminal

SHORT = {
    "behavior.weights_t_n": "[0.5, 1.0]",
    "behavior.cycles": "1",
    "behavior.preloads": "0",
    "behavior.swing_s": "0.1",
    "behavior.record_s": "0.2",
}


def test_a_bridge_is_calibrated_over_a_pty_with_an_emulated_person(tmp_path):
    outcome, run = run_trials(
        "emulated/weights", [{"bridge": "t"}], settings=SHORT, out=tmp_path, say=lambda line: None
    )
    assert outcome.exit_code == 0
    row = run.trials[0]
    assert row["gain_low_v_n"] < 1.0291 < row["gain_high_v_n"]
    # 0, 0.5, 1, 0.5 hang; the empty bridge at the end is recorded too
    assert row["loads"] == 4
    link = run.manifest["devices"]["operator"]["link"]
    assert link == {"requests": 7, "malformed_lines": 0}, "one set-up, five loads, all taken off at the end"


def test_a_person_at_a_terminal_answers_pauses_goes_on_and_ends_it(tmp_path):
    """Enter answers, Ctrl+C pauses, Enter goes on and the question comes again, n says no."""
    settings = [f"{key}={value}" for key, value in {**SHORT, "devices.operator.port": "console"}.items()]
    terminal = Terminal(
        ["run", "emulated/weights", "--only", "3", "--no-report", "--out", str(tmp_path)]
        + [option for setting in settings for option in ("--set", setting)]
    )
    terminal.until("set the fingertip up for weights on bridge Ft")
    terminal.press(b"\n")
    terminal.until("take every weight off, then press Enter")
    terminal.press(b"\n")
    terminal.until("hang 0.50 N on bridge Ft, then press Enter")
    terminal.press(b"\x03")
    terminal.until("paused: nothing moves")
    terminal.press(b"\n")
    terminal.until("hang 0.50 N on bridge Ft, then press Enter")
    terminal.press(b"\n")
    terminal.until("hang 1.00 N on bridge Ft, then press Enter")
    terminal.press(b"n\n")
    assert terminal.close() == 3, "a device that does not do its part"
    run = open_run("latest", tmp_path)
    assert run.trials[0]["outcome"] == "fault"
    names = [event["event"] for event in run.events]
    assert names.count("Loaded") == 2, "nothing and half a newton"
    assert (names.count("Paused"), names.count("Resumed")) == (1, 1)
    assert "the person says no" in run.manifest["exit"]["reason"]


LAB = """extends = "emulated/transient"  # ours

[detectors]
ours.threshold = "? run.py quiet"
"""


def test_an_emulated_bench_at_rest_sets_the_threshold_of_its_finger(tmp_path, capsys):
    lab = tmp_path / "lab.toml"
    lab.write_text(LAB)
    code = quiet.main([str(lab), "--seconds", "5", "--set", "behavior.settle_s=1"], standalone_mode=False)
    out, _ = capsys.readouterr()
    assert code == 0
    assert "contact: no threshold from rest" in out
    # of a free finger the least of a normal deviate is 3.5, and 500 simulated approaches asked for 4.6
    assert 3.5 < tomllib.loads(lab.read_text())["detectors"]["ours"]["threshold"] < 15.0
    assert lab.read_text().startswith(LAB.partition("[")[0])


def test_the_tendon_is_moved_and_recorded_over_the_wire(tmp_path):
    sweep = {
        "behavior.settle_s": "0.5",
        "detectors.ours.baseline_s": "1.5",
        "plant.noise_scale": "0.2",
        # rest and sweep end with the baseline: of a sweep that was not learned every flexing is a contact
        "behavior.rest_s": "1.0",
        "behavior.sweep_m_s": "0.01",
        "behavior.flexing_s": "1.0",
        "detectors.following.baseline_s": "3.0",
    }
    trial = {"location": "f", "speed_m_s": 0.006435, "tendon_m_s": 0.002}
    outcome, run = run_trials(
        "emulated/flexion", [trial], settings=sweep, out=tmp_path, say=lambda line: None
    )
    assert outcome.exit_code == EXIT_DONE, outcome.line
    (row,) = run.trials
    assert row["free_rise_hz"] > 2.0, "V.C: flexing raises the resonance"
    tendon_m = run.trial(row["trial"]).stream("board.tendon").values
    assert np.ptp(tendon_m) > 0.002, "the sweep, and 1 s of flexing at 2 mm/s"
