"""A whole grasp on the mock bench, joined from fragments: centre, close, lift."""

import json

import pytest

from config.script import run_trials
from controller.campaign import EXIT_DONE

WAY = [
    "CENTERING",
    "RESTING",
    "CLOSING",
    "LIFTING",
    "HOLDING",
    "LOWERING",
    "RELEASING",
    "LEAVING",
]


def test_a_slippery_pipe_is_centred_on_gripped_lifted_held_against_slip_and_set_down(tmp_path):
    rows = [{"object_x_m": 0.004, "method": "ours", "speed_m_s": 0.03, "plant.pad_friction": 0.08}]
    outcome, run = run_trials("mock/grasp", rows, out=tmp_path, say=lambda line: None)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    (row,) = run.trials
    assert row["outcome"] == "contact"
    assert abs(row["error_m"]) < 0.0005
    assert (row["touched"], row["gripped"]) == (0, 1)
    assert row["slipped"] == row["slips"] == 1
    assert row["grip_n"] > 12.0, "8 N do not hold 0.2 kg at this friction"
    assert row["lifted_m"] == pytest.approx(0.015, abs=1e-4)
    assert row["held_s"] == pytest.approx(2.0, abs=0.02)
    lines = (run.folder.path / "events.jsonl").read_text().splitlines()
    entered = dict.fromkeys(json.loads(line).get("next") for line in lines)
    assert [state for state in entered if state in WAY] == WAY
