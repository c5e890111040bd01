"""B8 on the mock bench: each sensor touches, rolls, slips and stops; overload and faults stop the arm."""

import numpy as np
import pytest

from config.script import run_trials
from config.source import ProfileError
from controller.campaign import EXIT_DONE, EXIT_GUARD
from tests.scenarios.conftest import SENSORS, SHORTER

SHORT = SHORTER["mock/slip"]


def run_slip(out, factors, profile="mock/slip", seed=1, **settings):
    rows = [{"sensor": sensor} for sensor in ([factors] if isinstance(factors, str) else factors)]
    return run_trials(profile, rows, settings=settings, seed=seed, out=out, say=lambda line: None)


@pytest.fixture(scope="module")
def every_sensor(tmp_path_factory):
    outcome, run = run_slip(tmp_path_factory.mktemp("runs"), SENSORS, **{"loop.rate_hz": "50.0"})
    assert outcome.exit_code == EXIT_DONE, outcome.line
    return run


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The same with short steps, where the paper's times do not matter."""
    outcome, run = run_slip(tmp_path_factory.mktemp("short"), ("fingertip", "wrist"), **SHORT)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    return run


def row_of(run, sensor):
    return next(row for row in run.trials if row["sensor"] == sensor)


def csv_of(run):
    return (run.folder.path / "trials.csv").read_bytes()


def stream_of(run, sensor, name):
    return run.trial(row_of(run, sensor)["trial"]).stream(name)


def test_a_sensor_whose_own_detectors_are_taken_off_slips_without_them(tmp_path):
    off = {"detectors.wrist_ours": "none", "behavior.sensors.wrist.paper": "none"}
    outcome, run = run_slip(tmp_path, "wrist", **SHORT, **off)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    row = row_of(run, "wrist")
    assert (row["outcome"], row["slips"]) == ("contact", 1)
    assert {row[f"{whose}_{what}"] for whose in ("ours", "paper") for what in ("missed", "quiet_s")} == {None}
    with pytest.raises(ProfileError, match="stop_on_slip"):
        run_slip(tmp_path, "wrist", **SHORT, **off, **{"behavior.stop_on_slip": "true"})
    with pytest.raises(ProfileError, match="'touch_arm', which is \"none\""):
        run_slip(tmp_path, "wrist", **{"detectors.touch_arm": "none"})


@pytest.mark.parametrize("sensor", SENSORS)
def test_each_sensor_touches_the_table_slips_where_it_should_and_comes_home(every_sensor, sensor):
    row = row_of(every_sensor, sensor)
    assert row["outcome"] == "contact"
    assert row["reference"] == "truth"
    assert row["slips"] == (2 if sensor == "flexible_finger" else 1)
    assert 0.0 < row["touch_s"] - row["touch_truth_s"] < 0.3
    assert 0.0 <= row["slip_s"] - row["slide_s"] < 0.5, "first the tip is loaded, then it slips"
    scored = sum(row[f"ours_{what}"] for what in ("detected", "missed", "early"))
    assert scored == row["slips"]
    assert every_sensor.manifest["loss"] == {}


def test_the_fingertip_runs_at_the_papers_times(every_sensor):
    """B1: contact at 2.43 s, roll to 6.20 s, slip to 9.8 s."""
    row = row_of(every_sensor, "fingertip")
    since = {name: row[name] - row["clock_s"] for name in ("touch_truth_s", "slide_s", "slip_end_s")}
    assert since["touch_truth_s"] == pytest.approx(2.43, abs=0.05)
    assert since["slide_s"] == pytest.approx(6.20, abs=0.2)
    assert since["slip_end_s"] == pytest.approx(9.8, abs=0.3)


def test_the_fingertips_slip_is_found_by_both_detectors_at_its_own_frequency(every_sensor):
    row = row_of(every_sensor, "fingertip")
    assert row["dominant_hz"] in (171.875, 187.5), "the paper's bins beside 180 Hz"
    assert row["peak_product"] > 10.0 > row["peak_product_before"], "4.3: the threshold of 10 separates them"
    assert (row["paper_missed"], row["ours_missed"]) == (0, 0)
    assert row["ours_event_s"] <= row["paper_event_s"]


def test_forces_and_angle_are_calibrated_and_recorded_in_newtons(every_sensor):
    tip = stream_of(every_sensor, "fingertip", "signals.tip")
    row = row_of(every_sensor, "fingertip")
    assert tip.unit == "N"
    pressed = (tip.times_s > row["touch_truth_s"] + 0.6) & (tip.times_s < row["slip_s"])
    normal_n, theta_rad = tip.values[pressed, 3], tip.values[pressed, 4]
    assert normal_n.mean() == pytest.approx(row["press_n"], rel=0.05), (
        "the fingertip and the arm feel the same table"
    )
    assert theta_rad[:20].mean() == pytest.approx(-0.4, abs=0.1)
    assert theta_rad[-20:].mean() == pytest.approx(0.2, abs=0.1), "rolled by 0.6 rad"
    slipping = (tip.times_s > row["slip_s"] + 0.2) & (tip.times_s < row["slip_end_s"] - 0.2)
    assert tip.values[slipping, 2].mean() == pytest.approx(0.2 * row["press_n"], rel=0.1), "friction 0.2"


def test_the_arm_really_rolled_and_slid(every_sensor):
    pose = stream_of(every_sensor, "fingertip", "arm.pose")
    row = row_of(every_sensor, "fingertip")
    at = np.searchsorted(pose.times_s, [row["slide_s"], row["slip_end_s"]])
    assert pose.values[at[1], 0] - pose.values[at[0], 0] == pytest.approx(0.036, abs=0.001)


def test_one_seed_gives_one_file_to_the_last_byte_whatever_else_is_run(tmp_path, short):
    """The first sensor's trial has the numbers that it has in the longer campaign."""
    _, again = run_slip(tmp_path, "fingertip", **SHORT)
    assert csv_of(again).splitlines() == csv_of(short).splitlines()[:2]


def test_stop_on_slip_stops_the_arm_within_two_turns_and_lifts(tmp_path):
    outcome, run = run_slip(tmp_path, "fingertip", **{"behavior.stop_on_slip": "true"})
    row = row_of(run, "fingertip")
    assert outcome.exit_code == EXIT_DONE
    # the loop turns every 5 ms: the sample waits for the next turn, the command leaves in it
    assert 0.0 <= row["slip_to_stop_s"] <= 0.0051
    assert 0.0 < row["stop_travel_m"] < 0.01 * 0.06
    assert row["slip_end_s"] - row["slide_s"] < 0.3


def test_an_overload_of_the_fingertip_stops_the_arm_and_ends_the_trial_as_guard(tmp_path):
    """2.4 mm would be 12 N; 10 N are the most."""
    hard = {"behavior.sensors.fingertip.press_m": "0.0024", "behavior.sensors.fingertip.tilt_rad": "0.0"}
    outcome, run = run_slip(tmp_path, "fingertip", **hard)
    row = row_of(run, "fingertip")
    assert (outcome.exit_code, row["outcome"]) == (EXIT_GUARD, "guard")
    assert "signals.tip is beyond its range" in outcome.line
    position = stream_of(run, "fingertip", "arm.position")
    tip = stream_of(run, "fingertip", "signals.tip")
    assert position.values.max() < 0.003 + 10.6 / 5e3, "stopped within the guard's turn"
    assert np.ptp(position.values[-5:]) < 1e-6, "it stands"
    assert 10.0 < np.abs(tip.values[:, 1]).max() < 10.6
    kinds = [event["event"] for event in run.events]
    assert "Saturated" in kinds
    assert "GuardStopped" in kinds


def test_an_overload_stops_the_arm_in_states_in_which_no_detector_listens_too(tmp_path, short):
    state = "LEVELLING"
    entered_s = next(event["t_s"] for event in short.events if event["trial"] == 1 and event["next"] == state)
    fault = f'[{{ device = "board", kind = "full_scale", at_s = {entered_s + 0.05} }}]'
    outcome, run = run_slip(tmp_path, "fingertip", faults=fault, **SHORT)
    assert outcome.exit_code == EXIT_GUARD
    assert "signals.tip is beyond its range" in outcome.line
    (stopped,) = [event for event in run.events if event["event"] == "GuardStopped"]
    assert stopped["state"] == state
    assert stopped["t_s"] < entered_s + 0.1


def test_bumps_raise_the_papers_alarms_and_not_ours(tmp_path):
    _, run = run_slip(tmp_path, "fingertip", "mock/slip_bumps", **{"plant.bumps_hz": "6.0"})
    (row,) = run.trials
    assert row["paper_false_alarms"] >= 4, "a bump rings as slip does"
    assert row["ours_false_alarms"] <= row["paper_false_alarms"] / 4
    assert row["ours_missed"] == 0
