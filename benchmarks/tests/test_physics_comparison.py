"""How the physics benchmark counts events and compares costs."""

import math

import numpy as np
import pytest

from benchmarks.physics.model import Difference, Trajectory, difference, matched
from benchmarks.physics.run import Point, cost_at


def point(us_per_s, error, missed=0):
    return Point("s", True, "solver", "", us_per_s, Difference(error / 2, error, missed, 0))


def test_events_are_compared_in_order_when_there_are_as_many():
    errors, missed, invented = matched(np.array([0.1, 0.2]), np.array([0.1001, 0.1999]))
    np.testing.assert_allclose(errors, [1e-4, 1e-4])
    assert (missed, invented) == (0, 0)


def test_a_missed_event_and_an_invented_one_do_not_pass_for_errors():
    errors, missed, invented = matched(np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.25, 0.3001]))
    np.testing.assert_allclose(errors, [0.0, 1e-4])
    assert (missed, invented) == (1, 1)


def test_no_event_at_all_misses_every_one():
    assert matched(np.array([0.1, 0.2]), np.empty(0))[1:] == (2, 0)
    assert matched(np.empty(0), np.array([0.1]))[1:] == (0, 1)


def test_a_trajectory_that_blew_up_is_infinitely_wrong():
    good = Trajectory(np.zeros(3), {})
    assert difference(good, Trajectory(np.array([0.0, np.nan, 0.0]), {})).theta_rad == math.inf


def test_the_cost_at_an_error_lies_between_settings_in_logarithms():
    points = [point(100.0, 1e-4), point(1000.0, 1e-8)]
    assert cost_at(points, 1e-6) == pytest.approx(math.sqrt(100.0 * 1000.0))
    assert cost_at(points, 1e-8) == pytest.approx(1000.0)
    assert cost_at(points, 1e-3) == 100.0


def test_what_no_setting_reaches_costs_infinitely_much():
    points = [point(100.0, 1e-4), point(1000.0, 1e-8)]
    assert cost_at(points, 1e-9) == math.inf


def test_a_setting_that_misses_events_does_not_count():
    points = [point(10.0, 1e-9, missed=1), point(100.0, 1e-4), point(1000.0, 1e-8)]
    assert cost_at(points, 1e-8) == pytest.approx(1000.0)
