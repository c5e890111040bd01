"""What the slip study counts: time called slip, and slips of tips that had moved."""

import numpy as np
import pytest

from benchmarks.slip import called, drifting, joined, refusals, sensor_off, slips, thinned

RATE_HZ = 100.0


@pytest.mark.parametrize("sensor", ["fingertip", "flexible_finger", "barrett_finger"])
def test_tips_that_a_load_step_moved_slip_as_well(sensor):
    trials = list(slips(sensor_off(sensor, "loads"), 20, 5))
    assert all(trial.onset is not None and trial.onset >= trial.start for trial in trials)
    assert 0 < sum(trial.moved_before for trial in trials) < 20


def test_a_rival_reports_slip_until_its_number_has_been_low_for_as_long_as_ours_holds():
    # at 100 Hz ours holds for twenty samples; a number at the end of a block stands until the next
    statistic = np.concatenate([[np.nan, 0.0, 2.0, np.nan], np.zeros(24)])
    slipping = called("a rival", np.zeros(28), statistic, RATE_HZ, 1.0)
    assert np.flatnonzero(slipping).tolist() == list(range(2, 24))


def test_what_a_cusum_was_sure_of_long_ago_does_not_delay_its_end():
    total = np.concatenate([np.arange(100.0), 99.0 - np.arange(100.0)])
    slipping = called("a CUSUM", np.zeros(200), total, RATE_HZ, 10.0)
    # over with the first sample down, but for the hold
    assert np.flatnonzero(slipping)[[0, -1]].tolist() == [11, 120]


def test_a_slip_at_reset_is_refused_where_the_quiet_is_known():
    quiet = np.random.default_rng(1).normal(0.0, 1.0, (2, 3000))
    found = refusals(list(quiet), [quiet[0], 30.0 * quiet[1]], 1000.0)
    assert (found["slips"], found["detected"], found["something_reported"]) == (2, 1, 2)


def test_a_coarse_sensor_drifts_from_code_to_code_and_lost_samples_lie_on_a_line():
    plant = sensor_off("fingertip", "noise of 0.2 steps")
    step = 5.0 * plant.bridges[-1].noise
    codes = [(x / step)[:, 0] for x in drifting(plant, 0.5, 1)]
    assert all(np.allclose(x, np.round(x)) for x in codes)
    # 0.02, 0.1 and 0.5 steps a second, for ten minutes
    assert [x[-5000:].mean() - x[:5000].mean() for x in codes] == pytest.approx([12.0, 60.0, 300.0], abs=3.0)
    x = np.arange(100_000.0)
    lost = thinned(x, 0.2, 3)
    assert np.isnan(lost).mean() == pytest.approx(0.2, abs=0.01)
    assert joined(lost)[10:-10] == pytest.approx(x[10:-10])
