"""The jaws' tick of 0.2 ms against an independent solution of their equations, and at the limits of both."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from simulator.physics import jaws_kernel as kernel
from simulator.physics.jaws_drive import GripObject, Jaws, JawsSettings

GAP_M = 0.005


def closing(thing, mass_kg, friction_n, force_n, ticks):
    """Squeeze (m) after each tick under a steady force, from rest 5 mm above the object."""
    jaws = Jaws(JawsSettings(objects={"it": thing}, object="it", mass_kg=mass_kg, friction_n=friction_n))
    jaws.width_m = thing.width_m + GAP_M
    squeezed_m = np.empty(ticks)
    for tick in range(ticks):
        kernel.move(jaws.x, jaws.flags, -force_n)
        squeezed_m[tick] = thing.width_m - jaws.width_m
    return squeezed_m


def reference(thing, mass_kg, friction_n, force_n, seconds):
    """When the jaws touch, and the largest squeeze (m), by closed form up to the touch and DOP853 beyond."""
    along_n = force_n - friction_n
    touch_s = math.sqrt(2.0 * GAP_M * mass_kg / along_n)
    start = [0.0, along_n / mass_kg * touch_s]

    def rates(_, y):
        return [y[1], (along_n - thing.stiffness_n_m * y[0] - thing.damping_n_s_m * y[1]) / mass_kg]

    seen_s = np.linspace(0.0, seconds, 50_001)
    found = solve_ivp(rates, (0.0, seconds), start, method="DOP853", rtol=1e-10, atol=1e-14, t_eval=seen_s)
    return touch_s, float(
        found.y[0].max()
    )  # a later peak is not higher, whichever way the friction acts by then


@pytest.mark.parametrize("stiffness_n_m", [5e3, 2e4, 1e5, 1e6])
@pytest.mark.parametrize("damping_n_s_m", [0.0, 20.0, 200.0])
def test_touch_and_peak_are_those_of_the_equations_within_the_tick(stiffness_n_m, damping_n_s_m):
    """The spring's share is second order, the damper's first: a third of what it takes in a tick; a touch in a tick."""
    thing = GripObject(width_m=0.04, stiffness_n_m=stiffness_n_m, damping_n_s_m=damping_n_s_m)
    squeezed_m = closing(thing, 0.1, 0.5, 20.0, 3000)
    touch_s, peak_m = reference(thing, 0.1, 0.5, 20.0, 0.5)
    tick = int(np.argmax(squeezed_m > 0.0))
    assert (tick + 1) * kernel.TICK_S == pytest.approx(touch_s, abs=kernel.TICK_S)
    damped = damping_n_s_m / 0.1 * kernel.TICK_S
    assert squeezed_m.max() == pytest.approx(peak_m, rel=0.3 * damped + 0.01)


@pytest.mark.parametrize("stiffness_n_m", [5e3, 2e4, 1e6])
def test_where_they_come_to_rest_is_exact_to_the_friction(stiffness_n_m):
    thing = GripObject(width_m=0.04, stiffness_n_m=stiffness_n_m)
    squeezed_m = closing(thing, 0.1, 0.5, 20.0, 20_000)
    assert np.ptp(squeezed_m[-100:]) == 0.0
    assert stiffness_n_m * squeezed_m[-1] == pytest.approx(20.0, abs=0.5 + 1e-9)


@pytest.mark.parametrize(("stiffness_n_m", "damping_n_s_m"), [(1e6, 0.0), (1e6, 200.0), (1e3, 200.0)])
def test_an_object_that_the_tick_would_throw_the_jaws_off_is_refused_and_at_the_bound_little_energy_is_made(
    stiffness_n_m, damping_n_s_m
):
    """Squeezed by 0.1 mm and let go without friction or drive: a spring gives 1 / (1 - k T^2 / 4 m) of its energy."""
    thing = GripObject(width_m=0.04, stiffness_n_m=stiffness_n_m, damping_n_s_m=damping_n_s_m)
    spring, damper = stiffness_n_m * kernel.TICK_S**2, 2.0 * damping_n_s_m * kernel.TICK_S
    least_kg = (spring + damper) / 1.25
    given = {"objects": {"it": thing}, "object": "it", "friction_n": 0.0}
    with pytest.raises(ValidationError, match="it is too stiff or too damped for jaws of"):
        JawsSettings(**given, mass_kg=0.999 * least_kg)
    jaws = Jaws(JawsSettings(**given, mass_kg=1.001 * least_kg))
    jaws.width_m = thing.width_m - 1e-4
    fastest_m_s = 0.0
    for _ in range(100):
        kernel.move(jaws.x, jaws.flags, 0.0)
        fastest_m_s = max(fastest_m_s, abs(jaws.rate_m_s))
    given_back = 0.5 * least_kg * fastest_m_s**2 / (0.5 * stiffness_n_m * 1e-4**2)
    assert given_back <= 1.0 / (1.0 - spring / (4.0 * least_kg)) + 1e-3
