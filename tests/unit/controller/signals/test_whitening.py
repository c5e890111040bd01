import math

import numpy as np
import pytest

from controller.signals import whitening
from controller.signals.whitening import GAIN, NOISE, first_level, innovate, predictor

LEARN = 500


def ratios(x):
    memory = {"keep": math.exp(-1 / 4000), "keep_energy": math.exp(-1 / 10), "scale": 2000.0}
    state = predictor(10, LEARN, **memory, model_error=0.1)
    return np.array([innovate(state, value) for value in x]), state


def ring(n, frequency, damping, rate_hz=1000.0):
    t_s = np.arange(n) / rate_hz
    return np.exp(-damping * 2 * np.pi * frequency * t_s) * np.sin(2 * np.pi * frequency * t_s)


def test_constants_of_the_cut_distributions_are_those_of_their_definitions():
    from scipy.stats import norm, truncnorm  # a second to load: for this test alone

    cut_mean = norm.expect(lambda z: min(z * z, whitening.CUT), lb=-12.0, ub=12.0, points=[-2.0, 2.0])
    assert cut_mean == pytest.approx(whitening.CUT_MEAN, abs=1e-7)
    edge = norm.ppf(0.5 + whitening.KEPT / 2)
    assert truncnorm(-edge, edge).var() == pytest.approx(whitening.KEPT_MEAN_SQUARE, rel=1e-6)


def test_the_first_level_is_the_variance_of_the_noise_and_bumps_hardly_move_it():
    rng = np.random.default_rng(2)
    x = 0.003 * rng.standard_normal(20_000)
    assert first_level(np.abs(np.diff(x, 2))) == pytest.approx(9e-6, rel=0.05)
    x[::200] += 5.0
    assert first_level(np.abs(np.diff(x, 2))) == pytest.approx(9e-6, rel=0.15)


@pytest.mark.parametrize("sigma", [0.2, 0.25, 0.3])
def test_the_noise_is_never_less_than_what_a_converter_makes_of_noise_between_two_codes(sigma):
    """A converter's step of 0.05; noise is learned there, then the channel stands in a code's middle for a minute."""
    rng = np.random.default_rng(3)
    place = np.concatenate([np.full(1000, 0.5), np.zeros(60_000)])
    x = 0.05 * np.round(place + np.where(place > 0.0, 0.1, sigma) * rng.standard_normal(place.size))
    _, state = ratios(x)
    assert state.scalars[NOISE] >= 0.25 * 0.05**2 * (1.0 - 1e-9)


def test_without_any_motion_there_is_no_level_and_in_noise_it_is_the_noises_with_a_ratio_of_one():
    found, state = ratios(np.full(3000, 2.5))
    assert np.isnan(found).all()
    assert state.counts[whitening.COUNT] < LEARN
    x = 0.02 * np.random.default_rng(4).standard_normal(30_000)
    found, state = ratios(x)
    settled = found[10_000:]
    # the prediction's allowance for ringing makes it a little smaller than one
    assert 0.9 < settled.mean() < 1.05
    assert state.scalars[NOISE] == pytest.approx(4e-4, rel=0.15)


def test_gain_is_that_of_the_whole_filter():
    found, state = ratios(np.random.default_rng(5).standard_normal(5000))
    taps = np.convolve(np.r_[1.0, -state.weights], [1.0, -2.0, 1.0])
    # weights are solved for every 8 samples, and the gain with them
    assert state.scalars[GAIN] == pytest.approx(taps @ taps, rel=1e-9)
    assert np.isfinite(found[-1])


@pytest.mark.parametrize("frequency", [60.0, 125.0, 180.0, 375.0, 480.0])
def test_ringing_is_predicted_whatever_its_frequency_and_a_blow_is_not(frequency):
    rng = np.random.default_rng(6)
    x = rng.standard_normal(20_000)
    for start in range(2000, 20_000 - 300, 700):
        x[start : start + 300] += 60.0 * ring(300, frequency, 0.02)
    found, _ = ratios(x)
    last = 2000 + 700 * 25
    assert found[last : last + 4].max() > 30.0
    assert np.median(found[last + 12 : last + 100]) < 2.0


def test_a_gap_is_silent_until_the_past_is_whole_again():
    x = np.random.default_rng(8).standard_normal(3000)
    x[2000:2010] = np.nan
    found, _ = ratios(x)
    # two samples make a second difference, ten of those a past
    assert np.isnan(found[2000 : 2010 + 2 + 10]).all()
    assert np.isfinite(found[2010 + 2 + 10 :]).all()
    assert np.isfinite(found[1001:2000]).all()


def test_one_or_two_lost_samples_are_bridged_and_the_innovation_after_them_is_as_large_as_others():
    """Noise of a structure that rings: predicted by two samples or three it is known less well."""
    rng = np.random.default_rng(9)
    x = np.zeros(60_000)
    for n in range(2, x.size):
        x[n] = 1.7 * x[n - 1] - 0.9 * x[n - 2] + rng.standard_normal()
    for lost in (1, 2):
        places = np.arange(20_000, x.size - 10, 40)
        y = x.copy()
        for k in range(lost):
            y[places + k] = np.nan
        found, _ = ratios(y)
        assert np.isfinite(found[20_000 + lost :: 40]).all()
        assert np.mean(found[places + lost]) == pytest.approx(np.mean(found[places + 30]), rel=0.25)
        assert np.isnan(found[places]).all()
