"""The tip on its table against an independent solution of its equations: soft and stiff, a creep and a blow."""

import math

import numpy as np
import pytest

from simulator.physics.slip import SlipPlant
from tests.stability.tip_oracles import PRESS_M, bare, reference


def felt(settings, speed_m_s, seconds):
    plant = SlipPlant(settings)
    plant.begin(key=(1, 1), press_m=PRESS_M)
    n = round(seconds * settings.rate_hz)
    times_s = np.arange(1, n + 1) / settings.rate_hz
    return plant.advance(speed_m_s * times_s, np.full(n, PRESS_M), np.zeros(n))[:, 0]


def worst_n(settings, speed_m_s, seconds, least):
    """Largest difference of the forces over the friction, after `least` events at the least."""
    expected_n, events_s = reference(settings, speed_m_s, seconds)
    assert len(events_s) >= least
    friction_n = settings.friction * settings.normal_n_m * PRESS_M
    return np.abs(felt(settings, speed_m_s, seconds) - expected_n).max() / friction_n


@pytest.mark.parametrize("contact_ratio", [1e-2, 0.2, 100.0])
@pytest.mark.parametrize("damping_ratio", [1e-3, 0.7])
def test_stick_and_slip_are_exact_from_soft_to_stiff(contact_ratio, damping_ratio):
    settings = bare(contact_ratio=contact_ratio, damping_ratio=damping_ratio, static_excess=0.2)
    speed_m_s = 0.05 if contact_ratio < 0.1 else 0.003
    assert worst_n(settings, speed_m_s, 0.4, least=1) < 1e-9


@pytest.mark.parametrize("speed_m_s", [1e-3, 3e-3, 0.3])
def test_they_are_from_a_creep_to_a_blow(speed_m_s):
    seconds = 1e-3 / speed_m_s if speed_m_s < 0.3 else 0.2
    assert worst_n(bare(static_excess=0.1), speed_m_s, seconds, least=1) < 1e-9


def test_a_mode_far_above_the_samples_and_chatter_of_forty_sticks_and_slips_stay_exact():
    """Four periods in a sample."""
    assert worst_n(bare(mode_hz=4000.0, static_excess=0.3), 3e-4, 0.08, least=4) < 1e-9
    settings = bare(static_excess=0.2, damping_ratio=0.03, contact_ratio=10.0)
    assert worst_n(settings, 3e-3, 0.4, least=40) < 1e-9


def test_a_break_away_that_is_grazed_is_held_or_not():
    """An arm that stops with the contact 1e-4 below static friction, and as much above: it swings by 2e-5 of it."""
    settings = bare(static_excess=0.1, damping_ratio=0.9)
    k = settings.mass_kg * (2.0 * math.pi * settings.mode_hz) ** 2
    kc = settings.contact_ratio * k
    static_n = 1.1 * settings.friction * settings.normal_n_m * PRESS_M
    way_m = static_n * (1.0 / k + 1.0 / kc)
    for off, holds in ((-1e-4, True), (1e-4, False)):
        plant = SlipPlant(settings)
        plant.begin(key=(1, 1), press_m=PRESS_M)
        n = 60_000  # slow enough that the tip does not swing
        arm_m = np.minimum(np.arange(1, n + 1) / (n - 2000), 1.0) * way_m * (1.0 + off)
        plant.advance(arm_m, np.full(n, PRESS_M), np.zeros(n))
        assert bool(np.ptp(plant.slid_m) == 0.0) is holds


def test_a_trial_of_ten_minutes_ends_as_exactly_as_one_of_a_second():
    """Stuck on a table that the arm leaves and comes back to: after whole turns the force is that of the first."""
    settings = bare(damping_ratio=0.3)
    plant = SlipPlant(settings)
    plant.begin(key=(1, 1), press_m=PRESS_M)
    t_s = np.arange(1, 600_001) / settings.rate_hz
    arm_m = 2e-6 * np.sin(2.0 * np.pi * t_s)
    force_n = plant.advance(arm_m, np.full(len(t_s), PRESS_M), np.zeros(len(t_s)))[:, 0]
    assert np.ptp(plant.slid_m) == 0.0
    assert np.abs(force_n[-1000:] - force_n[2000:3000]).max() < 1e-12
