"""C1, C2, C4 and C5 on the mock bench: the sweep, the undulations, contact, and what an error does."""

import pytest

from config.script import run_trials
from controller.campaign import EXIT_DONE
from controller.reports.report import build_report
from tests.unit.controller.reports.synthetic_runs import text_of


def run_aura(out, profile, rows, seed=1, **settings):
    return run_trials(profile, rows, settings=settings, seed=seed, out=out, say=lambda line: None)


@pytest.fixture(scope="module")
def approaches(tmp_path_factory):
    """The pipe, straight ahead of two sides at both speeds."""
    rows = [
        {"side": side, "speed_m_s": speed_m_s} for side in ("normal", "front") for speed_m_s in (0.01, 0.03)
    ]
    outcome, run = run_aura(tmp_path_factory.mktemp("runs"), "mock/pretouch", rows)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    return run


def row_of(run, **factors):
    return next(row for row in run.trials if all(row[name] == value for name, value in factors.items()))


def test_the_sweep_finds_the_frequency_at_which_the_fingers_transfer_best(tmp_path):
    outcome, run = run_aura(tmp_path, "mock/chirp", [{}])
    assert outcome.exit_code == EXIT_DONE
    (row,) = run.trials
    assert row["best_hz"] == pytest.approx(40_000.0, abs=500.0)
    # A resonance of quality 25 is 1.6 kHz wide at half its power, two bands of averaging on top.
    assert 1_000.0 < row["band_high_hz"] - row["band_low_hz"] < 3_000.0


@pytest.mark.parametrize("side", ["normal", "front"])
def test_undulations_per_way_are_the_same_at_both_speeds(approaches, side):
    slow, fast = (row_of(approaches, side=side, speed_m_s=v)["undulations_per_cm"] for v in (0.01, 0.03))
    # Two for each wavelength of 343.2 m/s at 40 kHz.
    assert slow == pytest.approx(2 * 40_000 / 343.2 / 100, rel=0.02)
    assert fast == pytest.approx(slow, rel=0.01)


def test_the_pipe_is_seen_before_it_is_touched_and_never_in_the_rest_before(approaches):
    for row in approaches.trials:
        assert row["seen_ours"] == 1, row
        assert row["alarms_ours"] == 0, row
        assert 0.004 < row["distance_m_ours"] <= 0.055
        assert row["touches"] == 0


def test_before_nothing_nothing_is_seen(tmp_path):
    outcome, run = run_aura(tmp_path, "mock/pretouch", [{"object": "none", "speed_m_s": 0.03}])
    assert outcome.exit_code == EXIT_DONE
    assert [(row["seen_ours"], row["alarms_ours"]) for row in run.trials] == [(None, 0)]


def test_a_touch_stops_the_arm_and_is_reported_to_its_end(tmp_path):
    rows = [{"side": side, "speed_m_s": 0.01} for side in ("normal", "normal", "back", "back", "back")]
    outcome, run = run_aura(tmp_path, "mock/touch", rows, seed=0)
    assert outcome.exit_code == EXIT_DONE
    felt = [row for row in run.trials if row["felt_ours"]]
    assert len(felt) >= 3, "both sides feel; a false contact ends a trial too"
    for row in felt:
        assert row["touches"] == row["held_ours"] == row["ended_ours"] == 1
        assert 0.0 <= row["delay_s_ours"] < 0.3
        assert row["truth_contact_s"] < row["truth_release_s"]
    delays_s = [row["delay_s_paper"] for row in run.trials if row["felt_paper"]]
    assert delays_s
    assert min(delays_s) >= 0.0, "what comes before the touch is no hit"


def test_each_report_shows_its_experiment(approaches, tmp_path):
    page = text_of(build_report([approaches], tmp_path))
    assert "Pre-touch (C2)" in page
    assert "SonicFinger" in page
    for speed_mm_s in (10, 30):
        assert f"normal x {speed_mm_s} 2.33 ours " in page, "undulations a centimetre"
