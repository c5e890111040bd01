"""The reference of the physics benchmark, against what is known without it."""

import numpy as np
import pytest
from mpmath import mp
from scipy.linalg import expm

from benchmarks.physics import references
from benchmarks.physics.modal import DIGITS, Wave, rising
from benchmarks.physics.model import FREE, Scene


def wave(level, omega=200):
    """cos(omega t - 1) minus a level."""
    return Wave([mp.mpc(0, omega)], [mp.exp(mp.mpc(0, -1))], [-mp.mpf(level), mp.mpf(0), mp.mpf(0)])


def test_a_crest_that_grazes_zero_by_a_hair_is_seen():
    with mp.workdps(DIGITS):
        hair = mp.mpf(10) ** -24
        instant = rising(wave(1 - hair), mp.mpf("0.02"))
        # cos(x) = 1 - hair at x = -sqrt(2 hair)
        assert instant is not None
        assert abs(200 * instant - 1 + mp.sqrt(2 * hair)) < mp.mpf(10) ** -20


def test_a_crest_that_stays_below_zero_by_a_hair_is_not_taken_for_a_touch():
    with mp.workdps(DIGITS):
        assert rising(wave(1 + mp.mpf(10) ** -24), mp.mpf("0.02")) is None


def test_a_wave_that_begins_at_zero_and_falls_is_found_where_it_rises_again():
    with mp.workdps(DIGITS):
        falling = Wave([mp.mpc(0, 200)], [mp.mpc(0, 1)], [mp.mpf(0)] * 3)  # -sin(200 t)
        assert abs(rising(falling, mp.mpf("0.02")) - mp.pi / 200) < mp.mpf(10) ** -30


def test_a_fast_and_a_slow_wave_together_lose_no_short_crossing():
    with mp.workdps(DIGITS):
        # a dip of a 10 kHz ripple on a 1 Hz swing: above zero for some microseconds alone
        ripple, swing = mp.mpc(0, 2 * mp.pi * 10_000), mp.mpc(0, 2 * mp.pi)
        both = Wave(
            [ripple, swing], [mp.exp(mp.mpc(0, -1)), mp.mpc(1)], [mp.mpf("-1.99"), mp.mpf(0), mp.mpf(0)]
        )
        instant = rising(both, mp.mpf("0.001"))
        assert instant is not None
        assert instant < mp.mpf("2e-5")
        assert abs(both.at(instant)[0]) < mp.mpf(10) ** -30


@pytest.mark.parametrize("closed", [True, False])
def test_until_the_first_switch_it_is_the_exponential_of_the_matrix(closed):
    scene = Scene("start", 1e-2, FREE, 0.008, closed)
    p = scene.parameters
    # (1), (2) with the drive at -U and nothing else, forced by a constant in the fifth place
    a = np.zeros((5, 5))
    a[0, 1] = a[2, 3] = 1.0
    a[1, :4] = np.array([-p.joint, -p.joint_damping, p.joint, p.joint_damping]) / p.inertia
    a[3, :4] = np.array([p.joint, p.joint_damping, -p.joint - p.base, -p.joint_damping - p.base_damping])
    a[3, :4] /= p.base_inertia
    a[1, 4] = -p.drive / p.inertia
    expected = [(expm(a * t) @ [0.0, 0.0, 0.0, 0.0, 1.0])[0] for t in scene.times_s]
    solved = references.solve(scene)
    assert solved.events["drive_up"].size == 0
    np.testing.assert_allclose(solved.theta_rad, expected, rtol=1e-12)


def test_without_the_loop_the_drive_turns_at_its_half_periods():
    solved = references.solve(Scene("open", 1e-2, FREE, 0.1, closed=False))
    np.testing.assert_allclose(solved.events["drive_up"], [1 / 56, 3 / 56, 5 / 56], rtol=1e-15)
    np.testing.assert_allclose(solved.events["drive_down"], [2 / 56, 4 / 56], rtol=1e-15)
