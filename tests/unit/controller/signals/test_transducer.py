"""Transducers by their resonances, and the beat of two clocks."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.signals.iq import Beat
from controller.signals.transducer import analyse


def lorentz(f_hz, f0_hz, q):
    return 1.0 / (1.0 + (q * (f_hz / f0_hz - f0_hz / f_hz)) ** 2)


def noisy(response, seed, share=0.01):
    return response * (1.0 + share * np.random.default_rng(seed).standard_normal(len(response)))


@settings(deadline=None, max_examples=15)
@given(st.floats(39e3, 42e3), st.floats(15.0, 80.0), st.integers(0, 1000))
def test_one_resonance_is_found_with_its_sharpness(f0_hz, q, seed):
    f_hz = np.linspace(36e3, 45e3, 91)
    found = analyse(f_hz, noisy(np.sqrt(lorentz(f_hz, f0_hz, q)), seed, 0.003))
    (one,) = found.resonances
    assert one.frequency_hz == pytest.approx(f0_hz, abs=20.0)
    assert one.q == pytest.approx(q, rel=0.03)
    assert found.q == pytest.approx(q, rel=0.1)
    assert found.peak_hz == pytest.approx(f0_hz, abs=100.0)
    # an amplitude of half lies sqrt(3) half-power half-widths away
    assert found.high_hz - found.low_hz == pytest.approx(math.sqrt(3.0) * f0_hz / q, rel=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_two_resonances_in_a_row_are_distinguished_from_one(seed):
    f_hz = np.linspace(38.5e3, 42.5e3, 41)
    product = np.sqrt(lorentz(f_hz, 40.1e3, 35.0) * lorentz(f_hz, 40.9e3, 40.0))
    found = analyse(f_hz, noisy(product, seed))
    assert [one.frequency_hz for one in found.resonances] == pytest.approx([40.1e3, 40.9e3], abs=60.0)
    assert found.aicc_two < found.aicc_one - 10.0


@pytest.mark.parametrize("seed", range(5))
def test_a_conductance_is_a_sum_on_a_slope(seed):
    f_hz = np.arange(222e3, 230e3, 100.0)
    both = 4e-3 * lorentz(f_hz, 226e3, 400.0) + 2e-3 * lorentz(f_hz, 224e3, 300.0)
    found = analyse(f_hz, noisy(both + 1e-3 + 1e-7 * (f_hz - 222e3), seed), "conductance")
    assert [one.frequency_hz for one in found.resonances] == pytest.approx([224e3, 226e3], abs=60.0)
    assert found.peak_hz == pytest.approx(226e3, abs=60.0)


@pytest.mark.parametrize("peak_hz", [226.0e3, 222.7e3])
def test_the_peak_of_a_piezos_conductance_is_followed_down(peak_hz):
    """As of one on an aluminium block in four states of damage (Virtual Labs, IIT Delhi, damage detection)."""
    f_hz = np.arange(222e3, 227.05e3, 100.0)
    both = 1.5e-3 * lorentz(f_hz, peak_hz - 900.0, 100.0) + 4e-3 * lorentz(f_hz, peak_hz, 500.0)
    found = analyse(f_hz, 2e-3 + both, "conductance")
    assert found.peak_hz == pytest.approx(peak_hz, abs=60.0)


def test_a_second_resonance_is_not_invented_from_noise_nor_a_band_that_the_sweep_does_not_hold():
    f_hz = np.linspace(38e3, 43e3, 22)
    invented = sum(
        len(analyse(f_hz, noisy(np.sqrt(lorentz(f_hz, 40.4e3, 45.0)), seed, 0.02)).resonances) == 2
        for seed in range(12)
    )
    assert invented <= 1
    f_hz = np.linspace(40.0e3, 40.8e3, 20)
    found = analyse(f_hz, np.sqrt(lorentz(f_hz, 40.4e3, 20.0)))
    assert math.isnan(found.low_hz)
    assert math.isnan(found.q)
    assert found.resonances[0].q == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize(
    ("f_hz", "response", "reason"),
    [
        (np.arange(1.0, 5.0), np.ones(4), "4 points are too few"),
        (np.arange(1.0, 9.0), np.arange(1.0, 9.0), "at the sweep's end"),
        (np.arange(1.0, 9.0), np.array([1, 2, 3, math.nan, 3, 2, 1, 1]), "must be finite"),
        (np.ones(8), np.ones(8), "must rise"),
    ],
)
def test_what_is_no_sweep_is_refused(f_hz, response, reason):
    with pytest.raises(ValueError, match=reason):
        analyse(f_hz, response)


RATE_HZ = 1000.0


def scene(seconds, beat_hz, seed=1):
    """Signal of an unbalanced bridge: some undulations, a contact, noise; and the turned one. Both shape (n,)."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    rng = np.random.default_rng(seed)
    noise = 1e-5 * (rng.standard_normal(len(t)) + 1j * rng.standard_normal(len(t)))
    near = (t % 10.0 > 4.0) & (t % 10.0 < 8.0)
    still = 0.1 + 0.05j + near * 0.01 * np.exp(2j * np.pi * 2.3 * t) + noise
    still[t % 20.0 > 15.0] += 0.03 + 0.02j
    return still, still * np.exp(2j * np.pi * beat_hz * t)


@pytest.mark.parametrize("beat_hz", [-8.0, -0.8, 0.0, 0.8, 4.0])
def test_the_beat_is_found_among_undulations_and_contacts(beat_hz):
    beat = Beat(RATE_HZ)
    beat.push(scene(30.0, beat_hz)[1], 0)
    assert beat.hz == pytest.approx(beat_hz, abs=1e-4)


@pytest.mark.parametrize("beat_hz", [0.0, 0.8])
def test_without_the_beat_the_signal_is_that_of_one_clock(beat_hz):
    still, turned = scene(60.0, beat_hz)
    ratio = Beat(RATE_HZ).push(turned, 0) / still[1000:]
    # the first second's error stays as a constant turn; after that nothing moves that did not move before
    late = ratio[20_000:]
    assert np.ptp(np.unwrap(np.angle(late))) < 0.02
    assert np.abs(late) == pytest.approx(1.0, abs=1e-9)
    assert beat_hz or np.abs(np.angle(ratio)).max() < 0.02, "hardly anything is removed without a beat"


def beat_error_ppm(z, true_hz):
    """RMS error of the beat expected of each second from the eleventh on, ppm of 40 kHz."""
    beat, found = Beat(RATE_HZ), []
    for first in range(0, len(z) - 1000, 1000):
        beat.push(z[first : first + 1000], first)
        found.append(beat.hz - true_hz[first + 1500])
    return math.sqrt(np.mean(np.square(found[10:]))) / 0.04


@pytest.mark.parametrize(("ppm_a_s", "most_ppm"), [(1.0, 0.01), (1.0 / 60.0, 0.01)])
def test_a_crystal_that_warms_up_is_followed_without_lag(ppm_a_s, most_ppm):
    """The mean of a minute lags by 28 ppm at 1 ppm a second."""
    still, _ = scene(120.0, 0.0)
    hz = 0.8 + 0.04 * ppm_a_s * np.arange(len(still)) / RATE_HZ
    turned = still * np.exp(2j * np.pi * np.cumsum(hz) / RATE_HZ)
    assert beat_error_ppm(turned, hz) < most_ppm
    torn = Beat(RATE_HZ)
    torn.push(turned[:60_300], 0)
    torn.push(turned[72_000:73_000], 72_000)
    assert torn.hz == pytest.approx(hz[73_500], abs=0.001)


@pytest.mark.parametrize("seed", range(4))
def test_noise_and_jitter_of_one_steady_beat_are_averaged_as_they_were(seed):
    """The error is that of a mean of a minute, weighted: a line through noise would double it."""
    rng = np.random.default_rng(seed)
    count = 60
    jitter_rad = np.repeat(10.0 ** rng.uniform(-3.5, -2.5, count), 1000)
    phases = 2.0 * np.pi * 0.8 * np.arange(1000 * count) / RATE_HZ + jitter_rad * rng.standard_normal(
        1000 * count
    )
    beat = Beat(RATE_HZ)
    beat.push(0.1 * np.exp(1j * phases), 0)
    place = np.arange(1000) - 499.5
    slopes = phases.reshape(count, 1000) @ place / np.sum(place**2)
    weights = jitter_rad[::1000] ** -2.0 * np.exp(-np.arange(count)[::-1] / 60.0)
    mean_hz = float(weights @ slopes / weights.sum()) * RATE_HZ / (2.0 * np.pi)
    assert beat.hz == pytest.approx(mean_hz, abs=2e-6)


def test_blocks_of_any_size_give_the_same():
    turned = scene(5.0, 0.8)[1]
    at_once = Beat(RATE_HZ).push(turned, 0)
    beat, place, parts = Beat(RATE_HZ), 0, []
    for size in np.random.default_rng(3).integers(1, 400, 1000):
        parts.append(beat.push(turned[place : place + size], place))
        place += size
    assert np.concatenate(parts) == pytest.approx(at_once, abs=1e-12)


def test_a_gap_is_turned_through():
    turned = scene(40.0, 0.8)[1]
    whole = Beat(RATE_HZ).push(turned, 0)
    beat = Beat(RATE_HZ)
    beat.push(turned[:9_300], 0)
    after = beat.push(turned[9_900:12_000], 9_900)
    assert np.abs(np.angle(after / whole[8_900:11_000])).max() < 0.02
