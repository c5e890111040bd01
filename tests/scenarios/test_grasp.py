"""A whole grasp on the mock bench, joined from fragments: centre, close, lift."""

import json

import pytest

from config.assemble import build_rig, plan_campaign
from config.profile import load_profile
from config.script import run_trials
from controller.campaign import EXIT_DEVICE, EXIT_DONE, EXIT_FAILED, Campaign
from controller.recording.reader import open_run
from simulator.physics.gripper_part import GripperPart
from simulator.physics.pad_part import PadPart
from tests.scenarios.conftest import SHORTER, Script

WAY = [
    *("CENTERING", "RESTING", "CLOSING", "LOADING", "LIFTING", "SHAKING", "HOLDING"),
    *("LOWERING", "RELEASING", "LEAVING"),
]
HEAVY = {"plant.object_kg": 0.5, "plant.pad_friction": 0.3}
AT_ONCE = {"behavior.center": "false"}


def grasped(out, row, **settings):
    """A grasp without a search; its outcome, its only row and its events."""
    settings = (
        SHORTER["mock/grasp"] | AT_ONCE | {name.replace("__", "."): value for name, value in settings.items()}
    )
    outcome, run = run_trials(
        "mock/grasp", [{"object_x_m": 0.0} | row], settings=settings, out=out, say=lambda line: None
    )
    (trial,) = run.trials
    return outcome, trial, run


def test_an_object_is_centred_on_lifted_shaken_loaded_tapped_and_set_down_with_little_more_than_the_least_force(
    tmp_path,
):
    rows = [{"object_x_m": 0.004, "method": "ours", "speed_m_s": 0.03} | HEAVY]
    outcome, run = run_trials("mock/grasp", rows, out=tmp_path, say=lambda line: None)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    (row,) = run.trials
    assert row["outcome"] == "held"
    assert abs(row["error_m"]) < 0.0005
    assert row["lifted_m"] == pytest.approx(0.2, abs=2e-3)
    assert row["lifted_m"] - 0.01 < row["rise_m"] < row["lifted_m"], "the pads give, and what slid is missing"
    assert row["carried_n"] == pytest.approx(0.5 * 9.80665 * 1.1, rel=0.1), (
        "half as much more for a second of five"
    )
    assert row["least_n"] == pytest.approx(0.5 * 9.80665 / (2 * 0.3), rel=0.01)
    assert 1.0 < row["grip_over_least"] < 1.6
    assert row["told_true"] >= 1
    assert row["friction"] == pytest.approx(0.3, rel=0.15)
    assert row["arrested_m"] < 0.003
    lines = (run.folder.path / "events.jsonl").read_text().splitlines()
    entered = dict.fromkeys(json.loads(line).get("next") for line in lines)
    assert [state for state in entered if state in WAY] == WAY


def centred(out, **settings):
    """A centering with its grip on a pipe; its outcome, its only row and its events."""
    row = {"object_x_m": 0.0, "method": "ours", "speed_m_s": 0.03}
    outcome, run = run_trials("mock/centering", [row], settings=settings, out=out, say=lambda line: None)
    (trial,) = run.trials
    return outcome, trial, run.events


def test_jaws_that_jam_open_or_on_their_way_grip_nothing(tmp_path):
    _, _, events = centred(tmp_path / "free")
    closes_s = next(event["t_s"] for event in events if event["next"] == "CLOSING" != event["state"])
    for late_s, words in ((-0.5, "63.0 mm, where they stood before"), (0.5, "but the object is at most")):
        fault = f'[{{device="gripper",kind="stall",at_s={closes_s + late_s}}}]'
        outcome, trial, _ = centred(tmp_path / f"{late_s}", faults=fault)
        assert outcome.exit_code == EXIT_DEVICE
        assert trial["outcome"] == "fault"
        assert words in outcome.line


def test_what_the_least_grip_holds_through_shake_and_tap_is_not_gripped_harder(tmp_path):
    outcome, row, _ = grasped(
        tmp_path, {"plant.object_kg": 0.1, "plant.pad_friction": 0.5, "plant.added": 0.0}
    )
    assert outcome.exit_code == EXIT_DONE, outcome.line
    assert (row["outcome"], row["told_false"], row["slid_m"]) == ("held", 0, pytest.approx(0.0, abs=1e-4))
    assert row["grip_n"] == pytest.approx(7.0, abs=0.1), "behavior.grip_force_n"


def test_what_never_leaves_the_table_is_no_success(tmp_path):
    row = {"plant.object_kg": 2.0, "plant.pad_friction": 0.08}
    about = {"behavior__tightest_n": "9.0", "behavior__lift_m": "0.015"}
    outcome, row, _ = grasped(tmp_path, row, **about)
    assert (outcome.exit_code, outcome.line) == (
        EXIT_FAILED,
        "no trial succeeded (not lifted: 1; 0 of 1 succeeded)",
    )
    assert row["lifted_m"] == pytest.approx(0.015, abs=1e-4), "the tool's"
    assert row["rise_m"] == 0.0
    assert row["carried"] < 0.5


def test_what_slides_while_the_jaws_press_less_hard_is_held(tmp_path):
    """Gripped off its centre, the third slides in the air at less than was seen on the table: its own stick-slip is no
    knock."""
    plant = {
        "object_kg": 0.5234817060776139,
        "pad_friction": 0.3609248358174799,
        "lever_m": 0.0014254221903946215,
    }
    plant |= {"object_width_m": 0.03916706459467771, "object_n_m": 36569.068959723365}
    plant |= {"pad_roughness": 0.06933705104113826}
    rows = [{"object_x_m": 0.0} | {f"plant.{name}": value for name, value in plant.items()}] * 3
    profile = load_profile(
        "mock/grasp", AT_ONCE, rows=dict(zip(("first", "second", "third"), rows, strict=True))
    )
    third = [trial for trial in profile.trials(1) if trial.id == 3]
    outcome = Campaign(plan_campaign(profile, third, 1), build_rig(profile), Script(), tmp_path).run()
    (row,) = open_run(outcome.folder).trials
    assert row["outcome"] == "held"
    assert row["arrested_m"] > 0.001


def test_what_the_grip_crushes_is_no_success(tmp_path):
    outcome, row, _ = grasped(tmp_path, HEAVY | {"plant.crush_n": 8.5})
    assert row["outcome"] == "crushed"
    assert outcome.exit_code == EXIT_FAILED


def always(value):
    return property(lambda self: value)


def test_what_grips_cannot_see_the_truth(tmp_path, monkeypatch):
    """Everything that a simulated bench knows is scrambled: commands and times stay the same."""
    _, seen, run = grasped(tmp_path / "a", HEAVY)
    spans = [(1.0, True), (2.0, False)]
    for part, name, value in (
        (GripperPart, "lifts", []),
        (GripperPart, "slides", spans),
        (GripperPart, "contacts", spans),
        (PadPart, "slips", spans),
    ):
        monkeypatch.setattr(part, name, always(value))
    _, unseen, again = grasped(tmp_path / "b", HEAVY)
    assert [event for event in run.events if event["commands"]] == [
        event for event in again.events if event["commands"]
    ]
    assert seen["outcome"] == "held"
    assert unseen["outcome"] != "held", "but what is scored by it is not"
