"""A whole grasp on the mock bench, joined from fragments: centre, close, lift."""

import json

import pytest

from config.script import run_trials
from controller.campaign import EXIT_DEVICE, EXIT_DONE, EXIT_FAILED
from controller.measures.grasp import OFF_TABLE_M

WAY = ["CENTERING", "RESTING", "CLOSING", "LIFTING", "HOLDING", "LOWERING", "RELEASING", "LEAVING"]


def test_a_slippery_pipe_is_centred_on_gripped_lifted_held_against_slip_and_set_down(tmp_path):
    rows = [{"object_x_m": 0.004, "method": "ours", "speed_m_s": 0.03, "plant.pad_friction": 0.08}]
    outcome, run = run_trials("mock/grasp", rows, out=tmp_path, say=lambda line: None)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    (row,) = run.trials
    assert row["outcome"] == "held"
    assert abs(row["error_m"]) < 0.0005
    assert (row["touched"], row["gripped"]) == (0, 1)
    assert row["slipped"] == row["slips"] == 1
    assert row["grip_n"] == pytest.approx(12.0, abs=0.1), "8 and 10 N do not hold 0.2 kg at this friction"
    assert (row["carried"], row["carried_n"]) == (1.0, pytest.approx(0.2 * 9.80665, abs=0.1))
    assert OFF_TABLE_M < row["rise_m"] < row["lifted_m"] - 0.002, "it slid in the fingers before they held it"
    assert row["lifted_m"] == pytest.approx(0.015, abs=1e-4)
    assert row["held_s"] == pytest.approx(2.0, abs=0.02)
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


@pytest.mark.parametrize("mass_kg", [0.05, 0.2])
def test_what_the_grip_holds_is_not_gripped_harder_for_the_knock_of_its_weight(tmp_path, mass_kg):
    rows = [{"object_x_m": 0.0, "plant.pad_friction": 0.2, "plant.object_kg": mass_kg}]
    outcome, run = run_trials("mock/grasp", rows, out=tmp_path, say=lambda line: None)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    (row,) = run.trials
    assert (row["outcome"], row["slipped"]) == ("held", 0)
    assert row["grip_n"] == pytest.approx(8.0, abs=0.1), "behavior.grip_force_n"
    assert row["rise_m"] == pytest.approx(row["lifted_m"], abs=0.001)


@pytest.mark.parametrize("slip", [(), ("slip_ours",)])
def test_what_never_leaves_the_table_is_no_success_whoever_listens(tmp_path, slip):
    rows = [{"object_x_m": 0.0, "plant.pad_friction": 0.08, "plant.object_kg": 2.0}]
    outcome, run = run_trials(
        "mock/grasp", rows, settings={"behavior.slip": str(list(slip))}, out=tmp_path, say=lambda line: None
    )
    assert (outcome.exit_code, outcome.line) == (
        EXIT_FAILED,
        "no trial succeeded (1 not lifted: 0 of 1 succeeded)",
    )
    (row,) = run.trials
    assert row["lifted_m"] == pytest.approx(0.015, abs=1e-4), "the tool's"
    assert (row["rise_m"], row["slipped"]) == (0.0, 1)
    assert row["carried"] < 0.5
