"""Whole experiments through real serial drivers, ptys and emulated devices, and what pulls them down."""

import pytest

from config.assemble import build_rig, start_emulator
from config.profile import load_profile
from controller.campaign import EXIT_DEVICE, EXIT_DONE, EXIT_GUARD
from controller.doctor import examine
from controller.recording.reader import open_run
from controller.rig import TrialScene
from tests.wire.wire_campaign import QUICK, run


@pytest.fixture
def emulated():
    """A profile and an emulator of it that outlives the run, so that one can look at the bench afterwards."""
    profile = load_profile("emulated/transient", QUICK)
    emulator = start_emulator(profile)
    yield profile, emulator
    emulator.close()


def test_an_approach_over_the_wire_ends_by_contact(emulated, tmp_path):
    profile, emulator = emulated
    outcome, hand = run(profile, emulator, tmp_path)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    assert hand.seen[-1] == "DONE"
    done = open_run(outcome.folder)
    (row,) = done.trials
    assert row["outcome"] == "contact"
    assert row["onset_s"] < row["detect_s"] < row["command_s"] < row["standstill_s"]
    # 4.843 mm/s from the onset to the detection, through the stage's own positions and the board's own clock.
    assert row["extent_m"] == pytest.approx(0.004843 * row["delay_s"], abs=6e-5)
    force = done.trial(2).stream("board.load_cell")
    assert not force.gaps
    assert done.manifest["bench"] == "emulated"
    assert done.manifest["clock"] == "held"


@pytest.mark.parametrize("device", ["board", "stage"])
def test_a_pulled_plug_stops_the_bench_and_says_which(emulated, tmp_path, device):
    profile, emulator = emulated
    outcome, _ = run(profile, emulator, tmp_path, {"APPROACH": lambda: emulator.inject(device, "unplug")})
    assert outcome.exit_code == EXIT_DEVICE
    assert "trial 2" in outcome.line
    assert "\n" not in outcome.line
    done = open_run(outcome.folder)
    assert done.trials[0]["outcome"] == "fault"
    failed = [event for event in done.events if event["event"] == "Failed"]
    assert failed[0]["device"] == device
    if device == "board":
        assert emulator.scene()["probe_m_s"] == 0.0
    assert len(done.trial(2).stream("board.load_cell")) > 500, "what was measured is kept"


def test_a_board_that_falls_silent_stops_the_stage(emulated, tmp_path):
    profile, emulator = emulated
    outcome, _ = run(profile, emulator, tmp_path, {"APPROACH": lambda: emulator.inject("board", "silent")})
    assert outcome.exit_code in (EXIT_DEVICE, EXIT_GUARD)
    assert "board" in outcome.line
    assert emulator.scene()["probe_m_s"] == 0.0


def test_a_stalled_stage_ends_the_run(emulated, tmp_path):
    profile, emulator = emulated
    outcome, _ = run(profile, emulator, tmp_path, {"APPROACH": lambda: emulator.inject("stage", "stall")})
    assert outcome.exit_code == EXIT_DEVICE
    assert "stalled" in outcome.line, outcome.line


def test_the_doctor_reads_every_sensor_and_moves_nothing(emulated):
    profile, emulator = emulated
    rig = build_rig(profile, emulator.endpoints)
    findings = list(examine(rig, TrialScene(1, 1, {}, profile.plant.settings.model_dump(mode="json"))))
    rig.close()
    lines = "\n".join(finding.line for finding in findings)
    assert all(finding.verdict != "fail" for finding in findings), lines
    assert "board.load_cell" in lines
    assert "stage.position" in lines
    assert emulator.scene() == {"probe_m": 0.0, "probe_m_s": 0.0}
