"""B6 over the wire, short: with an emulated person, and with one at a terminal who pauses in the middle."""

from controller.recording.reader import open_run
from tests.wire.terminal import Terminal

SHORT = {
    "behavior.weights_t_n": "[0.5, 1.0]",
    "behavior.cycles": "1",
    "behavior.preloads": "0",
    "behavior.swing_s": "0.1",
    "behavior.record_s": "0.2",
}


def test_a_bridge_is_calibrated_over_a_pty_with_an_emulated_person(tmp_path):
    from config.script import run_trials

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
