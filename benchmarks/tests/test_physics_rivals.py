"""The rivals of the physics benchmark are what they claim to be: the same physics, of their order."""

import numpy as np
import pytest

from benchmarks.physics.model import Scene, difference
from benchmarks.physics.run import ORDERS, compiled_rival, reference

# the probe comes at 50 mm/s and stops dead at 0.3 mm: the loop closed, touches, the clipped mode, a jump of the force
BUMP = Scene(
    "bump",
    1e-4,
    ((0.0, 0.0, 0.05, 0.0), (0.008, 0.0004, 0.0, 0.0)),
    0.2,
    changes={"contact_n_s_m": 20.0},
)


@pytest.fixture(scope="module")
def truth():
    way = reference(BUMP)
    assert way.events["made"].size >= 2
    assert way.events["comparator_up"].size >= 2
    return way


def solved(solver):
    solver.run()
    return solver.result()


@pytest.mark.parametrize(("method", "order"), ORDERS.items())
def test_a_method_that_locates_events_converges_with_its_order_and_finds_them_all(truth, method, order):
    substeps = (2, 4) if order == 4 else (1, 2)
    coarse, fine = (difference(truth, solved(compiled_rival(BUMP, method, n))) for n in substeps)
    for found in (coarse, fine):
        assert (found.missed, found.invented) == (0, 0)
    assert 2 ** (order - 1.5) < coarse.theta_rad / fine.theta_rad < 2 ** (order + 1.5)


def test_the_comparison_sees_when_a_rival_blows_up():
    wild = Scene("wild", 1e-4, ((0.0, 0.0, 0.05, 0.0),), 0.05, changes={"pad_n_m": 1e9, "contact_n_s_m": 1e6})
    with np.errstate(all="ignore"):
        found = difference(reference(wild), solved(compiled_rival(wild, "RK4, events located", 1)))
    assert found.theta_rad > 1e-3 or found.missed > 0
