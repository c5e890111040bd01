"""Every switch and the angle, against a solver that shares nothing with the plant.

Bounds: 1e-12 s and 1e-13 rad against the modal reference of 40 digits. Double precision leaves about 1e-15 of either
over a tenth of a second; stiff contact amplifies that by the number of its rings.
"""

import math

import numpy as np
import pytest

from simulator.physics.finger import FingerPlant, FingerSettings
from tests.stability.finger_oracles import arm_and_stiffness, modal

ALL = frozenset({"switches"})
SWITCH_S, THETA_RAD = 1e-12, 1e-13


def run_plant(s, *, pieces, gap_m, until_s, samples_s, location="f", start_s=0.0, excited=True):
    """Switches, and theta at some times."""
    plant = FingerPlant(s)
    plant.begin(key=(0, 0), location=location, gap_m=gap_m, t_s=start_s)
    plant.excite(excited)
    plant.move_probe(pieces)
    thetas = []
    for t_s in samples_s:
        plant.advance(t_s, ALL)
        thetas.append(plant.theta_rad)
    plant.advance(until_s, ALL)
    return plant.switches(), np.array(thetas)


def agree(s, *, digits=40, **scene):
    """Compare plant and reference; return the switches."""
    ours, thetas = run_plant(s, **scene)
    theirs, expected = modal(s, digits=digits, **scene)
    assert [kind for _, kind in ours] == [kind for _, kind in theirs]
    assert np.max(np.abs(np.array([t for t, _ in ours]) - [t for t, _ in theirs])) < SWITCH_S
    assert np.max(np.abs(thetas - expected)) < THETA_RAD
    return ours


def critical_n_s_m(stiffness_n_m: float) -> float:
    """c2 at which the pressed link, its mounting held, is damped critically."""
    s = FingerSettings()
    arm_m, _ = arm_and_stiffness(s, "f")
    whole = 2.0 * math.sqrt((s.joint_n_m_rad + stiffness_n_m * arm_m**2) * s.inertia_kg_m2)
    return (whole - s.joint_n_m_s_rad) / arm_m**2


APPROACH = {"pieces": [(0.0, 0.0, 0.03, 0.0)], "gap_m": 0.001}
STEADY = {"pieces": [(0.0, 0.0, 0.02, 0.0)], "gap_m": 1e-4}
FIXED = {"oscillator_lowest_hz": 28.0, "oscillator_range_hz": 1e-12}
"""An oscillator without range is a drive of fixed frequency."""

SPAN = {"until_s": 0.06, "samples_s": np.linspace(0.01, 0.06, 6)}


SOFT = [(1e2, 0.0), (1e2, 1e6), (1e4, critical_n_s_m(1e4)), (1e5, 1.0)]
RIGID = [(1e7, 0.0), (1e7, critical_n_s_m(1e7)), (1e9, 0.0), (1e9, 1.0), (1e9, 1e6)]


@pytest.mark.parametrize(("stiffness_n_m", "damping_n_s_m"), SOFT + RIGID)
def test_closed_loop_contact_is_exact_from_soft_to_rigid(stiffness_n_m, damping_n_s_m):
    s = FingerSettings(noise_scale=0.0, pad_n_m=stiffness_n_m, contact_n_s_m=damping_n_s_m)
    switches = agree(s, **APPROACH, **SPAN)
    assert {"made", "comparator_up", "drive_up"} <= {kind for _, kind in switches}


def test_a_contact_that_is_clipped_for_microseconds_is_made_again():
    # P falls through zero and is back 19 us later, deep inside the 6 ms that a piece of the clipped mode may last, and
    # falls again before these end: two turns in less than half a radian of the fastest oscillation
    s = FingerSettings(noise_scale=0.0, pad_n_m=1e9, contact_n_s_m=1e4)
    switches = agree(s, **STEADY, until_s=0.0375, samples_s=[0.0368, 0.037, 0.0375])
    contacts = [(t, kind) for t, kind in switches if kind in ("made", "lost")]
    assert [kind for _, kind in contacts[-2:]] == ["lost", "made"]
    assert 1e-5 < contacts[-1][0] - contacts[-2][0] < 2e-5


def test_a_force_that_fades_away_ends_at_its_instant():
    # P ends at some 10 N/s: 1e-19 m of overlap lost to the rounding of theta would be 1e-10 N here, and 1e-11 s
    s = FingerSettings(noise_scale=0.0, pad_n_m=1e9, contact_n_s_m=1e4, **FIXED)
    switches = agree(s, **STEADY, until_s=0.045, samples_s=[0.02, 0.045])
    assert max(t for t, kind in switches if kind == "lost") > 0.04


@pytest.mark.parametrize(("stiffness_n_m", "damping_n_s_m"), [(1e4, 2.0), (1e9, 0.0), (1e3, 1e6)])
def test_open_loop_contact_is_exact(stiffness_n_m, damping_n_s_m):
    s = FingerSettings(noise_scale=0.0, pad_n_m=stiffness_n_m, contact_n_s_m=damping_n_s_m, **FIXED)
    agree(s, **APPROACH, **SPAN)


def test_bouncing_stays_exact_over_many_contacts():
    s = FingerSettings(noise_scale=0.0)
    scene = {**APPROACH, "gap_m": 0.003, "until_s": 0.3}
    switches = agree(s, **scene, samples_s=np.linspace(0.05, 0.3, 6))
    assert sum(kind == "made" for _, kind in switches) >= 4


@pytest.mark.parametrize("speed_m_s", [1e-5, 1e-3, 1e-1])
def test_touching_is_exact_from_a_creep_to_a_blow(speed_m_s):
    s = FingerSettings(noise_scale=0.0)
    scene = {"pieces": [(0.0, 0.0, speed_m_s, 0.0)], "gap_m": speed_m_s * 0.0123, "excited": False}
    agree(s, **scene, until_s=0.05, samples_s=[0.02, 0.05])


def test_corners_of_the_probes_plan_are_kept_to_the_instant():
    s = FingerSettings(noise_scale=0.0)
    plan = [(0.0, 0.0, 0.0, 0.5), (0.02, 1e-4, 0.01, 0.0)]
    plan += [(0.0437, 3.37e-4, 0.01, -0.5), (0.0637, 4.37e-4, 0.0, 0.0)]
    agree(s, pieces=plan, gap_m=0.0002, until_s=0.08, samples_s=[0.03, 0.05, 0.08])


@pytest.mark.parametrize("location", ["a", "h"])
def test_every_place_has_its_own_arm_and_stiffness(location):
    agree(FingerSettings(noise_scale=0.0), **APPROACH, **SPAN, location=location)


def test_a_trial_at_a_million_seconds_is_as_exact_as_one_at_zero():
    s = FingerSettings(noise_scale=0.0)
    scene = {"gap_m": 0.001, "until_s": 0.2, "samples_s": [0.1, 0.2]}
    first, thetas = run_plant(s, pieces=[(0.0, 0.0, 0.03, 0.0)], **scene)
    origin_s = 1e6
    scene = {"gap_m": 0.001, "until_s": origin_s + 0.2, "samples_s": [origin_s + 0.1, origin_s + 0.2]}
    late, late_thetas = run_plant(s, pieces=[(origin_s, 0.0, 0.03, 0.0)], start_s=origin_s, **scene)
    # the instants asked for are 6e-11 s off, half a unit in the last place of 1e6 s: so are the angles, at 2 rad/s
    assert late_thetas == pytest.approx(thetas, abs=2e-10)
    # switches are given in whole seconds: 1.2e-10 s is one unit in the last place of 1e6 s
    assert [t - origin_s for t, _ in late] == pytest.approx([t for t, _ in first], abs=1.2e-10)


def test_periods_at_a_million_seconds_have_no_rounding_of_the_clock():
    s = FingerSettings(noise_scale=0.0)
    periods = []
    for origin_s in (0.0, 1e6):
        plant = FingerPlant(s)
        plant.begin(key=(0, 0), gap_m=0.003, t_s=origin_s)
        plant.excite(True)
        plant.advance(origin_s + 1.0, frozenset({"period"}))
        periods.append(plant.periods()[1])
    assert periods[1] == pytest.approx(periods[0], abs=1e-14)


def test_a_probe_that_stops_dead_does_not_pull():
    """The damper's force jumps with the probe's velocity: what P would be below zero ends the contact at once."""
    s = FingerSettings(contact_n_s_m=20.0, noise_scale=0.0)
    scene = {"pieces": [(0.0, 0.0, 0.05, 0.0), (0.01, 0.0005, 0.0, 0.0)], "gap_m": 1e-4}
    switches = agree(s, **scene, until_s=0.1, samples_s=np.linspace(0.01, 0.1, 10))
    assert (pytest.approx(0.01, abs=SWITCH_S), "lost") in switches
    plant = FingerPlant(s)
    plant.begin(key=(0, 0), gap_m=1e-4)
    plant.excite(True)
    plant.move_probe(scene["pieces"])
    plant.advance(0.1, frozenset({"load_cell"}))
    assert plant.sample("load_cell", np.arange(1, 101) * 1e-3).min() >= -1e-12
