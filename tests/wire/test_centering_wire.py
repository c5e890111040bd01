"""Centering over the wire: ur_rtde, python-can and sound at once, on one simulated pair of fingers."""

from contextlib import closing

import pytest

from config.assemble import start_emulator
from config.profile import load_profile
from controller.campaign import EXIT_DONE
from controller.recording.reader import open_run
from tests.wire import wire_campaign

SHORT = {
    "behavior.run_up": "false",
    "behavior.baseline_s": "0.4",
    "behavior.hold_s": "0.1",
    "behavior.handling_speed_m_s": "0.06",
    "behavior.open_speed_m_s": "0.05",
    "trials.list": "[{ object_x_m = 0.001 }]",
    "trials.grid.method": '["ours"]',
    "trials.grid.speed_m_s": "[0.02]",
}


def test_the_pipe_is_centred_closed_on_confirmed_and_released(tmp_path):
    profile = load_profile("emulated/centering", SHORT)
    with closing(start_emulator(profile)) as emulator:
        outcome, hand = wire_campaign.run(profile, emulator, tmp_path, number=1)
        scene = emulator.scene()
    assert outcome.exit_code == EXIT_DONE, outcome.line
    way = ["SEEKING_FORWARD", "TURNING", "SEEKING_BACKWARD", "STOPPING", "CENTERING", "CLOSING", "HOLDING"]
    assert [state for state in hand.seen if state in (*way, "RELEASING", "DONE")] == [
        *way,
        "RELEASING",
        "DONE",
    ]
    done = open_run(outcome.folder)
    (row,) = done.trials
    assert (row["outcome"], row["gripped"]) == ("centered", 1)
    assert abs(row["error_m"]) < 0.0025, "what the project aims at (NUMERICS, Centering)"
    assert row["contact_left_s"] > 0.0 and row["contact_right_s"] > 0.0, "both fingers felt it"
    for finger in ("left", "right"):
        assert 0.0 < row[f"seen_to_stop_{finger}_s"] < 1.0
    # the jaws are as open as they go, and the arm has left
    assert scene["width_m"] == pytest.approx(0.063, abs=0.001)
    assert scene["tool_z_m"] == pytest.approx(0.07, abs=0.001)
    recording, manifest = done.trial(1), done.manifest
    assert {"arm.position", "gripper.width", "signals.left", "signals.right"} <= set(recording.streams)
    link = manifest["devices"]["audio"]["link"]
    assert link["frames"] > 96_000
    assert manifest["loss"].get("audio.fingers", 0) == link["frames_lost"]
