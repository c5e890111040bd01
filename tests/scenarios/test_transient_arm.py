"""A2 on the mock bench with the arm in the stage's place: the same experiment, another mover."""

import pytest

from behaviors.transient import Transient
from controller.campaign import EXIT_DEVICE
from controller.reports.report import build_report

PROFILE = "mock/transient_arm"


def row_of(bench):
    (row,) = bench.run.trials
    return row


def test_a_trial_ends_by_contact_with_the_arms_stop_certificate(run_profile):
    bench = run_profile(PROFILE, trials=(1,))
    row = row_of(bench)
    assert [name for name, _ in bench.script.seen] == [
        state for state in Transient.states if state != "FAILED"
    ]
    assert row["outcome"] == "contact"
    assert row["onset_s"] < row["detect_s"] <= row["command_s"] < row["standstill_s"]
    # From 3.785 mm/s at 3 m/s2, and 20 ms in which nothing moves.
    assert row["standstill_s"] - row["command_s"] == pytest.approx(0.003785 / 3.0 + 0.02, abs=1e-6)
    cruising_m = 0.003785 * (row["command_s"] - row["detect_s"])
    assert row["stop_travel_m"] == pytest.approx(cruising_m + 0.003785**2 / (2 * 3.0), abs=1e-6)
    assert row["extent_m"] == pytest.approx(0.003785 * row["delay_s"], abs=1e-7)
    assert bench.run.manifest["roles"] == {"mover": "arm", "exciter": "board"}
    assert "arm.position" in bench.run.trial(1).streams
    assert "arm.force" not in bench.run.trial(1).streams, "it has no subscriber"


def test_the_report_is_that_of_the_stage(run_profile):
    page = build_report([run_profile(PROFILE, trials=(16, 22)).run]).read_text(encoding="utf-8")
    assert "Table I" in page
    assert "with an arm" in page


def test_a_protective_stop_ends_the_run_and_nothing_moves(run_profile):
    seen = run_profile(PROFILE, trials=(1,)).script.seen
    at_s = next(t_s for name, t_s in seen if name == "APPROACH") + 0.1
    bench = run_profile(PROFILE, trials=(1, 2), faults=[{"device": "arm", "kind": "stall", "at_s": at_s}])
    assert bench.outcome.exit_code == EXIT_DEVICE
    assert "protective stop" in bench.outcome.line
    assert not bench.rig.devices["arm"].axis.moving(bench.rig.clock.now())
    assert len(bench.run.trials) == 1
