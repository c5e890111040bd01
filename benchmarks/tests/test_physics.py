"""How the physics benchmark counts events and compares costs, and that its rival is what it claims to be."""

import math

import numpy as np
import pytest

from benchmarks.physics import (
    Difference,
    Point,
    Scene,
    Trajectory,
    compiled_rk4,
    cost_at,
    difference,
    matched,
    reference,
)

# the probe comes at 50 mm/s and stops dead at 0.3 mm: the loop closed, touches, the clipped mode, a jump of the force
BUMP = Scene(
    "bump", 1e-4, ((0.0, 0.0, 0.05, 0.0), (0.008, 0.0004, 0.0, 0.0)), 0.2, changes={"contact_n_s_m": 20.0}
)


def point(us_per_s, error, missed=0):
    return Point("s", True, "solver", "", us_per_s, Difference(error / 2, error, missed, 0))


def solved(solver):
    solver.run()
    return solver.result()


def test_the_rival_converges_with_its_order_and_finds_every_event():
    truth = reference(BUMP)
    assert truth.events["made"].size >= 2
    assert truth.events["comparator_up"].size >= 2
    coarse, fine = (difference(truth, solved(compiled_rk4(BUMP, n))) for n in (2, 4))
    for found in (coarse, fine):
        assert (found.missed, found.invented) == (0, 0)
    assert 2**2.5 < coarse.theta_rad / fine.theta_rad < 2**5.5


def test_the_comparison_sees_when_a_rival_blows_up():
    wild = Scene("wild", 1e-4, ((0.0, 0.0, 0.05, 0.0),), 0.05, changes={"pad_n_m": 1e9, "contact_n_s_m": 1e6})
    with np.errstate(all="ignore"):
        found = difference(reference(wild), solved(compiled_rk4(wild, 1)))
    assert found.theta_rad > 1e-3 or found.missed > 0
    good = Trajectory(np.zeros(3), {})
    assert difference(good, Trajectory(np.array([0.0, np.nan, 0.0]), {})).theta_rad == math.inf


@pytest.mark.parametrize(
    ("found", "errors", "missed", "invented"),
    [
        ([0.1001, 0.1999, 0.3], [1e-4, 1e-4, 0.0], 0, 0),
        ([0.1, 0.25, 0.3001], [0.0, 1e-4], 1, 1),  # one missed and one invented do not pass for errors
        ([], [], 3, 0),
    ],
)
def test_events_are_matched_before_their_errors_are_taken(found, errors, missed, invented):
    off, *counts = matched(np.array([0.1, 0.2, 0.3]), np.array(found))
    np.testing.assert_allclose(off, errors, atol=1e-12)
    assert counts == [missed, invented]


def test_the_cost_at_an_error_lies_between_settings_in_logarithms_and_those_that_miss_events_do_not_count():
    points = [point(10.0, 1e-9, missed=1), point(100.0, 1e-4), point(1000.0, 1e-8)]
    assert cost_at(points, 1e-6) == pytest.approx(math.sqrt(100.0 * 1000.0))
    assert cost_at(points, 1e-8) == pytest.approx(1000.0)
    assert cost_at(points, 1e-3) == pytest.approx(100.0)
    assert cost_at(points, 1e-9) == math.inf
