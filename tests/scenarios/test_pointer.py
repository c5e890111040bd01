"""B7 on the mock bench: the angle from the bridges against the one that the arm has turned."""

import math

import pytest

from config import assemble
from config.profile import load_profile
from controller.campaign import Campaign
from controller.measures.pointer import errors_of
from controller.recording.reader import open_run
from controller.reports.pointer import touched
from tests.scenarios.conftest import Script

ANGLES = (0.0, 1.2)
"""The last touch is at zero: an arm that stands turned takes a minute to turn home."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One run of two angles for each of two forces; scenes do not change, so they are run once."""
    return {force_n: run_pointer(tmp_path_factory.mktemp("runs"), force_n) for force_n in (1.0, 3.0)}


def run_pointer(out, force_n=1.0, operator=None, **sets):
    overrides = {
        "behavior.angles_rad": str(list(ANGLES)),
        "trials.list": f"[{{ detectors.touch.threshold = {force_n} }}]",
        **{key.replace("__", "."): value for key, value in sets.items()},
    }
    profile = load_profile("mock/pointer", overrides)
    plan = assemble.plan_campaign(profile, profile.trials(0), 2)
    outcome = Campaign(plan, assemble.build_rig(profile), operator or Script(), out).run()
    return outcome, open_run(outcome.folder)


def test_every_angle_is_touched_up_and_down_with_the_force_that_was_asked_for(runs):
    for force_n, (outcome, run) in runs.items():
        assert outcome.exit_code == 0
        ((_, touches),) = touched([run])
        true = [touch.true_rad for touch in touches]
        assert true == pytest.approx([*ANGLES, *ANGLES[::-1]], abs=1e-3)
        assert [touch.going for touch in touches] == ["up"] * 2 + ["down"] * 2
        # 2 mm/s on 5 kN/m rise by 10 N in a second: twenty milliseconds of averaging, ten of turn and brake
        assert all(force_n < touch.force_n < force_n + 0.5 for touch in touches)


def test_below_the_plays_width_the_angle_is_off_by_what_two_unequal_gains_make_of_it(runs):
    """By hand: 6 % and 4.8 % of hysteresis take a share 2 h / (1 + h / 4) off the gain of a force that opens no loop,
    and the fitted line's own gain is 1 - share / 8 of the bridge's."""
    left = []
    for hysteresis in (0.06, 0.048):
        share = 2.0 * hysteresis / (1.0 + hysteresis / 4.0)
        left.append((1.0 - share) / (1.0 - share / 8.0))
    ((_, touches),) = touched([runs[1.0][1]])
    for touch in touches:
        expected_rad = math.atan(left[0] / left[1] * math.tan(touch.true_rad)) - touch.true_rad
        # 400 samples of 1.75 degrees' spread: five standard deviations of their mean
        assert touch.error_rad == pytest.approx(expected_rad, abs=math.radians(5.0 * 1.75 / 20.0))


def test_hysteresis_shows_where_the_play_opens(runs):
    rows = {force_n: run.trials[0] for force_n, (_, run) in runs.items()}
    assert rows[3.0]["theta_hysteresis_rad"] > 0.05
    assert rows[1.0]["theta_hysteresis_rad"] < 0.02


def test_the_row_is_what_the_recording_gives(runs):
    for _, run in runs.values():
        ((_, touches),) = touched([run])
        assert run.trials[0]["theta_rms_rad"] == pytest.approx(errors_of(touches)["rms"], rel=1e-8)
        assert run.trials[0]["theta_max_rad"] == pytest.approx(errors_of(touches)["max"], rel=1e-8)
        assert run.trials[0]["touches"] == len(touches) == 4


def test_without_a_table_there_is_no_contact(tmp_path):
    outcome, run = run_pointer(tmp_path, plant__surface_m="0.05")
    assert outcome.exit_code == 1, "no trial succeeded"
    assert run.trials[0]["outcome"] == "no_contact"
    assert run.trials[0]["touches"] == 0


PAUSED_ANGLES = (0.0, 0.3)
"""Enough to pause in a touch that has others before and after it."""


@pytest.fixture
def paused_in_a_touch(tmp_path, script):
    script.requests = {"RECORDING": ["pause"], "PAUSED": ["resume"]}
    return run_pointer(tmp_path, operator=script, behavior__angles_rad=str(list(PAUSED_ANGLES)))


def test_after_a_pause_in_a_touch_the_touch_is_made_again(paused_in_a_touch, script):
    outcome, run = paused_in_a_touch
    assert outcome.exit_code == 0
    ((_, touches),) = touched([run])
    expected = [*PAUSED_ANGLES, *PAUSED_ANGLES[::-1]]
    assert [touch.true_rad for touch in touches] == pytest.approx(expected, abs=1e-3)
    names = [event["event"] for event in run.events]
    assert names.count("Resumed") == 1
    assert [name for name, _ in script.seen].count("RECORDING") == 6, (
        "four touches, one twice, and after the pause"
    )
    # the answer of a mover that stood already is waited for: it would come while the arm lifts, and end the lift
    paused, resumed = names.index("Paused"), names.index("Resumed")
    assert names[paused:resumed].count("Standstill") == 1
    lifted = names.index("Reached", resumed)
    assert "Standstill" not in names[resumed:lifted]


def test_a_request_to_resume_while_the_arm_still_brakes_is_not_waited_for_again(
    tmp_path, script, monkeypatch
):
    """The arm needs several turns to stand; virtual time would rest for ever for a request that has been made."""

    def waited(seconds):
        pytest.fail("it waits for a second request")

    monkeypatch.setattr("controller.loop.rest", waited)
    script.requests = {"TURNING": ["pause"], "PAUSED": ["resume"]}
    outcome, _ = run_pointer(tmp_path, operator=script, behavior__angles_rad="[0.0, 0.3]")
    assert outcome.exit_code == 0
    names = [name for name, _ in script.seen]
    paused = names.index("PAUSED")
    assert names[paused + 1 : paused + 4] == ["TURNING", "LIFTING", "HOMING"]
