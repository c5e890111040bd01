"""The rivals of the physics benchmark are what they claim to be: the same physics, of their order."""

import numpy as np
import pytest

from benchmarks.physics import mujoco_rival, references, rivals, scipy_rivals
from benchmarks.physics.dynamics import BY_LAW, CLIPPED, FREE, TOUCHING, constants, contact_force
from benchmarks.physics.model import Scene, difference

# the probe comes at 50 mm/s and stops dead at 0.3 mm: the loop closed, touches, the clipped mode, a jump of the force
BUMP = Scene(
    "bump",
    1e-4,
    ((0.0, 0.0, 0.05, 0.0), (0.008, 0.0004, 0.0, 0.0)),
    0.2,
    changes={"contact_n_s_m": 20.0},
)


@pytest.fixture(scope="module")
def reference():
    way = references.solve(BUMP)
    assert way.events["made"].size >= 2
    assert way.events["comparator_up"].size >= 2
    return way


def solved(solver):
    solver.run()
    return solver.result()


def off(reference, solver):
    return difference(reference, solved(solver))


@pytest.mark.parametrize(("method", "order"), rivals.LOCATED.items())
def test_a_method_that_locates_events_converges_with_its_order_and_finds_them_all(reference, method, order):
    substeps = (2, 4) if order == 4 else (1, 2)
    coarse, fine = (off(reference, rivals.prepared(BUMP, method, n)) for n in substeps)
    for found in (coarse, fine):
        assert (found.missed, found.invented) == (0, 0)
    assert 2 ** (order - 1.5) < coarse.theta_rad / fine.theta_rad < 2 ** (order + 1.5)


@pytest.mark.parametrize("method", rivals.FIXED)
def test_a_method_that_steps_over_events_converges_all_the_same(reference, method):
    coarse, fine = (off(reference, rivals.prepared(BUMP, method, n)) for n in (16, 256))
    assert (fine.missed, fine.invented) == (0, 0)
    assert fine.theta_rad < coarse.theta_rad / 4
    assert fine.theta_rad < 1e-4


@pytest.mark.parametrize("method", ["DOP853", "RK45", "LSODA"])
def test_scipy_with_restarts_finds_every_event_within_its_tolerance(reference, method):
    found = difference(reference, scipy_rivals.solve(BUMP, method, 1e-9))
    assert (found.missed, found.invented) == (0, 0)
    assert found.theta_rad < 1e-7


def test_mujoco_steps_through_the_same_physics_as_the_compiled_runge_kutta():
    compiled, mujoco = solved(rivals.prepared(BUMP, "RK4", 4)), solved(mujoco_rival.prepared(BUMP, "RK4", 4))
    found = difference(compiled, mujoco)
    assert (found.missed, found.invented) == (0, 0)
    assert found.theta_rad < 1e-13
    assert found.event_s < 1e-12


def test_mujoco_leaves_no_callback_behind():
    import mujoco

    mujoco_rival.prepared(BUMP, "Euler", 1).run()
    assert mujoco.get_mjcb_act_dyn() is None


def test_contact_pushes_only_and_only_while_pressed():
    c = constants(BUMP.parameters)
    pressed, leaving, apart = (1e-4, 0.0), (1e-4, -1.0), (-1e-4, 1.0)
    push = BUMP.parameters.contact * 1e-4
    assert contact_force(c, BY_LAW, *pressed) == pytest.approx(push)
    assert contact_force(c, BY_LAW, *leaving) == 0.0
    assert contact_force(c, BY_LAW, *apart) == 0.0
    assert [contact_force(c, mode, *pressed) for mode in (FREE, CLIPPED)] == [0.0, 0.0]
    assert contact_force(c, TOUCHING, *pressed) == pytest.approx(push)


def test_the_comparison_sees_when_a_rival_blows_up():
    wild = Scene("wild", 1e-4, ((0.0, 0.0, 0.05, 0.0),), 0.05, changes={"pad_n_m": 1e9, "contact_n_s_m": 1e6})
    with np.errstate(all="ignore"):
        found = difference(references.solve(wild), solved(rivals.prepared(wild, "RK4", 1)))
    assert found.theta_rad > 1e-3 or found.missed > 0
