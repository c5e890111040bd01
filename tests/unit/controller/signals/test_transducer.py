"""A sweep's peak, band, sharpness and resonances, on curves whose resonances are known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


@pytest.mark.parametrize("peak_hz", [226.0e3, 224.5e3, 223.0e3, 222.7e3])
def test_the_peak_of_a_piezos_conductance_is_followed_down(peak_hz):
    """As of one on an aluminium block in four states of damage (Virtual Labs, IIT Delhi, damage detection)."""
    f_hz = np.arange(222e3, 227.05e3, 100.0)
    found = analyse(
        f_hz,
        2e-3 + 1.5e-3 * lorentz(f_hz, peak_hz - 900.0, 100.0) + 4e-3 * lorentz(f_hz, peak_hz, 500.0),
        "conductance",
    )
    assert found.peak_hz == pytest.approx(peak_hz, abs=60.0)


def test_a_second_resonance_is_not_invented_from_noise():
    f_hz = np.linspace(38e3, 43e3, 22)
    invented = sum(
        len(analyse(f_hz, noisy(np.sqrt(lorentz(f_hz, 40.4e3, 45.0)), seed, 0.02)).resonances) == 2
        for seed in range(25)
    )
    assert invented <= 1


def test_a_band_that_the_sweep_does_not_hold_is_not_made_up():
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
