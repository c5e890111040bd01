"""A roll-and-slip trial over the wire: ur_rtde, python-can and pyserial at once, on one simulated tip."""

from contextlib import closing

import numpy as np
import pytest

from config.assemble import start_emulator
from config.profile import load_profile
from controller.campaign import EXIT_DONE
from controller.recording.reader import open_run
from tests.wire import wire_campaign

SHORT = {
    "plant.surface_m": "0.0012",
    "behavior.sensors.fingertip.steps": "["
    '{ do = "roll", duration_s = 0.6, turn_rad = 0.15 },'
    '{ do = "load", duration_s = 0.6, speed_m_s = 0.0005 },'
    '{ do = "slip", duration_s = 1.0, speed_m_s = 0.01 },'
    "]",
    "behavior.sensors.fingertip.tilt_rad": "0.0",
}


@pytest.fixture(scope="module")
def slipped(tmp_path_factory):
    profile = load_profile("emulated/slip", SHORT)
    with closing(start_emulator(profile)) as emulator:
        outcome, hand = wire_campaign.run(profile, emulator, tmp_path_factory.mktemp("runs"), number=1)
    return outcome, open_run(outcome.folder), hand


def test_the_arm_stops_on_slip_and_the_row_says_how_fast(slipped):
    outcome, done, hand = slipped
    assert outcome.exit_code == EXIT_DONE, outcome.line
    assert hand.seen[-1] == "DONE"
    (row,) = done.trials
    assert (row["outcome"], row["reference"], row["slips"]) == ("contact", "command", 1)
    # 4 N on the fingertip, and the arm's own sensor feels the same
    assert row["press_n"] == pytest.approx(4.4, abs=0.5)
    assert 0.0 < row["slip_to_stop_s"] < 1.0
    assert hand.seen.index("HALTING") == hand.seen.index("SLIPPING") + 1
    slips = [event for event in done.events if event["event"] == "SlipStarted"]
    assert slips, "ours reported slip"
    # 10 mm/s for a second were asked for
    pose = done.trial(1).stream("arm.pose")
    after = pose.times_s > row["slide_s"]
    assert np.ptp(pose.values[after, 0]) < 0.009, "it was cut short"


def test_every_device_talks_and_what_is_lost_is_counted(slipped):
    outcome, done, _ = slipped
    assert outcome.exit_code == EXIT_DONE, outcome.line
    recording, manifest = done.trial(1), done.manifest
    assert {
        "arm.force",
        "arm.pose",
        "board.fingertip",
        "signals.tip",
        "hand.strain_11",
        "matrix.taxels",
    } <= set(recording.streams)
    for stream, rate_hz in (("arm.force", 500.0), ("hand.strain_11", 250.0), ("matrix.taxels", 100.0)):
        series = recording.stream(stream)
        missing = sum(gap.samples for gap in series.gaps)
        first_s, last_s = series.times_s[[0, -1]]
        skipped_s = sum(max(0.0, min(s.t1_s, last_s) - max(s.t0_s, first_s)) for s in series.skipped)
        assert missing <= manifest["loss"].get(stream, 0) + 1, f"{stream}: a gap that was not counted"
        assert len(series) + missing == pytest.approx((last_s - first_s - skipped_s) * rate_hz, rel=0.05), (
            stream
        )
    assert manifest["devices"]["arm"]["link"]["rows"] > 1000
