"""The five sensors: what the paper prints of each, read off the simulated one."""

import math

import numpy as np
import pytest

from simulator.physics.slip import SENSORS, SlipPlant

PRESS_M = 1e-3


def recorded(name, seconds, *, speed_m_s=0.0, roll_rad_s=0.0, key=(1, 1), **changed):
    """Pressed; rolled from the start, dragged from 0.3 s on; shape (n, channels)."""
    settings = SENSORS[name].model_copy(update=changed)
    plant = SlipPlant(settings)
    plant.begin(key=key, press_m=PRESS_M)
    n = round(seconds * settings.rate_hz)
    t_s = np.arange(1, n + 1) / settings.rate_hz
    arm_m = speed_m_s * np.maximum(0.0, t_s - 0.3)
    return plant.advance(arm_m, np.full(n, PRESS_M), roll_rad_s * t_s), plant


def powers(x, size=64):
    blocks = x[: len(x) // size * size].reshape(-1, size)
    return np.abs(np.fft.rfft(blocks, axis=1)[:, 1:]) ** 2 / size


@pytest.mark.parametrize(
    ("name", "frequency_hz"), [("fingertip", 180.0), ("flexible_finger", 125.0), ("barrett_finger", 375.0)]
)
def test_slip_rings_at_the_printed_frequency(name, frequency_hz):
    found = np.concatenate(
        [powers(recorded(name, 4.0, speed_m_s=0.01, key=(1, k))[0][500:, -1]) for k in range(4)]
    )
    mean = found.mean(axis=0)
    # above the slow changes of friction: from 60 Hz on
    strongest_hz = (np.argmax(mean[3:]) + 4) * 1000.0 / 64
    assert strongest_hz == pytest.approx(frequency_hz, abs=1000.0 / 64)


def test_the_fingertips_peak_in_slip_is_that_of_fig_9c():
    found = np.concatenate(
        [powers(recorded("fingertip", 4.0, speed_m_s=0.01, key=(1, k))[0][500:, 2]) for k in range(6)]
    )
    assert np.median(found[:, 9:13].max(axis=1)) == pytest.approx(0.12, rel=0.25)


def test_the_fingertips_lowest_bin_in_rolling_is_that_of_fig_9b_and_its_floor_that_of_fig_9a():
    rolling = powers(recorded("fingertip", 200.0, roll_rad_s=0.001)[0][:, 2])
    assert rolling[:, 0].mean() == pytest.approx(0.045, rel=0.25)
    still = powers(recorded("fingertip", 20.0)[0][:, 2])
    assert np.median(still.max(axis=1)) == pytest.approx(3.5e-5, rel=0.25)


@pytest.mark.parametrize(
    ("channel", "resolution_n", "gain"), [(0, 0.12, 0.0694), (1, 0.12, 0.0326), (2, 0.01, 1.0291)]
)
def test_the_fingertips_noise_is_its_printed_resolution_over_3_5(channel, resolution_n, gain):
    volts = recorded("fingertip", 20.0)[0][:, channel]
    assert 3.5 * np.std(volts) / gain == pytest.approx(resolution_n, rel=0.05)


@pytest.mark.parametrize("theta_rad", [-1.2, -0.3, 0.0, 0.7])
def test_theta_is_the_angle_of_the_two_normal_bridges(theta_rad):
    plant = SlipPlant(SENSORS["fingertip"].model_copy(update={"noise_scale": 0.0}))
    plant.begin(key=(1, 1), roll_rad=theta_rad)
    n = 500
    volts = plant.advance(np.zeros(n), np.linspace(0.0, PRESS_M, n), np.full(n, theta_rad))[-1]
    fx_n, fy_n = volts[0] / 0.0694, volts[1] / 0.0326
    # hysteresis: 6 and 4.8 % of 7 N on a force of 5 N
    assert math.hypot(fx_n, fy_n) == pytest.approx(5.0, abs=0.3)
    assert math.atan2(fx_n, fy_n) == pytest.approx(theta_rad, abs=0.06)


def test_nothing_stands_out_of_the_jr3_in_slip():
    slip = powers(recorded("jr3_wrist", 6.0, speed_m_s=0.01)[0][1000:, 0]).mean(axis=0)
    rolling = powers(recorded("jr3_wrist", 6.0, roll_rad_s=0.01)[0][1000:, 0]).mean(axis=0)
    assert np.max(slip[3:] / rolling[3:]) < 2.0


def test_a_taxel_shows_a_level_of_volts_at_a_hundred_samples_a_second():
    values, plant = recorded("dsa_taxel", 5.0)
    assert plant.settings.rate_hz == 100.0
    assert 1500.0 < values.mean() < 4000.0
    assert np.all(values == np.round(values))


@pytest.mark.parametrize("name", SENSORS)
def test_truth_distinguishes_holding_from_slipping(name):
    assert np.ptp(recorded(name, 2.0, rolling_n=0.0)[1].slid_m) == 0.0
    slid_m = recorded(name, 3.0, speed_m_s=0.01)[1].slid_m
    assert slid_m[-1] - slid_m[0] > 0.01
