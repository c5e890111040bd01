"""B7 over the wire, short: ur_rtde turns and lowers the tip, pyserial brings its bridges, the two are held together."""

import pytest

SHORT = {
    "behavior.angles_rad": "[0.0, 0.06]",  # the last touch is at zero: turning home is slow
    "plant.surface_m": "0.0006",
    "behavior.turn_rad_s": "0.12",
    "behavior.rest_s": "0.1",
    "behavior.record_s": "0.2",
    "detectors.touch.baseline_s": "0.2",
}


def test_the_angle_of_the_contact_is_measured_over_the_wire(tmp_path):
    from config.script import run_trials
    from controller.reports.pointer import read_sweeps

    outcome, run = run_trials(
        "emulated/pointer",
        [{"detectors.touch.threshold": 1.0}],
        settings=SHORT,
        out=tmp_path,
        say=lambda line: None,
    )
    assert outcome.exit_code == 0, outcome.line
    (sweep,) = read_sweeps([run])
    assert [touch.going for touch in sweep.touches] == ["up", "up", "down", "down"]
    # the emulated arm turns to what it was asked for within the drift of a twist's end, 1 % of a radian
    assert [touch.true_rad for touch in sweep.touches] == pytest.approx([0.0, 0.06, 0.06, 0.0], abs=0.01)
    # at 1 N the play opens no loop: what is left is the bridges' unequal hysteresis, below 0.7 degrees, and noise
    assert sweep.errors.largest < 0.02
    assert 1.0 < sweep.pressed_n < 2.5
