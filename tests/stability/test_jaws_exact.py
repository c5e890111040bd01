"""The jaws' tick of 0.2 ms against an independent solution of their equations, and at the limits of both."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.physics import jaws_kernel as kernel
from simulator.physics.jaws_drive import FRICTION_N, MASS_KG, STIFFEST_N_M, JawsDrive
from tests.contracts.gripper_suite import put

WIDTH_M, GAP_M, FORCE_N = 0.04, 0.005, 20.0


def jaws_on(stiffness_n_m, damping_n_s_m):
    """Jaws with an object of 40 mm between them."""
    jaws = JawsDrive(0.008)
    put(jaws, WIDTH_M, stiffness_n_m, damping_n_s_m)
    return jaws


def closing(stiffness_n_m, damping_n_s_m, ticks):
    """Squeeze (m) after each tick under a steady force, from rest 5 mm above the object."""
    jaws = jaws_on(stiffness_n_m, damping_n_s_m)
    jaws.width_m = WIDTH_M + GAP_M
    squeezed_m = np.empty(ticks)
    for tick in range(ticks):
        kernel.move(jaws.x, jaws.flags, -FORCE_N)
        squeezed_m[tick] = WIDTH_M - jaws.width_m
    return squeezed_m


def reference(stiffness_n_m, damping_n_s_m, seconds):
    """When the jaws touch, and the largest squeeze (m), by closed form up to the touch and DOP853 beyond."""
    along_n = FORCE_N - FRICTION_N
    touch_s = math.sqrt(2.0 * GAP_M * MASS_KG / along_n)
    start = [0.0, along_n / MASS_KG * touch_s]

    def rates(_, y):
        return [y[1], (along_n - stiffness_n_m * y[0] - damping_n_s_m * y[1]) / MASS_KG]

    seen_s = np.linspace(0.0, seconds, 50_001)
    found = solve_ivp(rates, (0.0, seconds), start, method="DOP853", rtol=1e-10, atol=1e-14, t_eval=seen_s)
    # a later peak is not higher, whichever way the friction acts by then
    return touch_s, float(found.y[0].max())


@pytest.mark.parametrize("stiffness_n_m", [5e3, 2e4, 1e5, 1e6])
@pytest.mark.parametrize("damping_n_s_m", [0.0, 20.0, 200.0])
def test_touch_and_peak_are_those_of_the_equations_within_the_tick(stiffness_n_m, damping_n_s_m):
    """The spring's share is second order, the damper's first: a third of what it takes in a tick; a touch in a tick."""
    squeezed_m = closing(stiffness_n_m, damping_n_s_m, 3000)
    touch_s, peak_m = reference(stiffness_n_m, damping_n_s_m, 0.5)
    tick = int(np.argmax(squeezed_m > 0.0))
    assert (tick + 1) * kernel.TICK_S == pytest.approx(touch_s, abs=kernel.TICK_S)
    damped = damping_n_s_m / MASS_KG * kernel.TICK_S
    assert squeezed_m.max() == pytest.approx(peak_m, rel=0.3 * damped + 0.01)


@pytest.mark.parametrize("stiffness_n_m", [5e3, 2e4, 1e6])
def test_where_they_come_to_rest_is_exact_to_the_friction(stiffness_n_m):
    squeezed_m = closing(stiffness_n_m, 20.0, 20_000)
    assert np.ptp(squeezed_m[-100:]) == 0.0
    assert stiffness_n_m * squeezed_m[-1] == pytest.approx(FORCE_N, abs=FRICTION_N + 1e-9)


def test_the_stiffest_object_gives_little_more_than_it_takes():
    """Squeezed by 0.1 mm and let go without friction or drive: a spring gives 1 / (1 - k T^2 / 4 m) of its energy."""
    jaws = jaws_on(STIFFEST_N_M, 0.0)
    jaws.x[kernel.FRICTION] = 0.0
    jaws.width_m = WIDTH_M - 1e-4
    fastest_m_s = 0.0
    for _ in range(100):
        kernel.move(jaws.x, jaws.flags, 0.0)
        fastest_m_s = max(fastest_m_s, abs(jaws.rate_m_s))
    given_back = MASS_KG * fastest_m_s**2 / (STIFFEST_N_M * 1e-4**2)
    assert 0.9 < given_back <= 1.0 / (1.0 - STIFFEST_N_M * kernel.TICK_S**2 / (4.0 * MASS_KG)) + 1e-3
