"""The contact study's scoring, on made-up statistics."""

import numpy as np
import pytest

from benchmarks.contact import STEPS, UNKNOWN, Record, bound, judged, threshold


def test_a_threshold_is_exceeded_as_often_as_was_asked_for():
    maxima = np.random.default_rng(1).exponential(size=4000)
    assert np.mean(maxima[:2000] > threshold(maxima[2000:].tolist(), 0.01)) == pytest.approx(0.01, abs=0.006)


def test_a_contact_is_in_time_within_two_periods_and_missed_where_nothing_rises():
    records = (np.array([0.01, 0.05]), np.array([2.0, 6.0]))
    late = (np.array([0.2]), np.array([6.0]))
    silent = (np.array([0.01]), np.array([1.0]))
    record = Record(
        [0.0, 7.0, 0.0], [records, late, silent], [np.array([0.01, 0.02]), np.array([0.1]), np.array([0.0])]
    )
    found = judged(record, 5.0)
    assert found["false"] == 1
    assert found["missed"] == 1
    assert found["in_time"] == pytest.approx(1 / 3)
    assert found["median_s"] == 0.2
    assert found["force_max_n"] == 0.1


def test_an_observer_whose_hypotheses_lie_at_the_threshold_detects_half_of_the_contacts():
    result = bound(np.full((4, STEPS), UNKNOWN))
    assert result["unknown"]["within_70_ms"] == pytest.approx(0.5)
    assert result["known"]["within_70_ms"] > 0.8
    assert result["unknown"]["p95_s"] == np.inf
