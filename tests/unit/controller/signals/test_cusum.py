import math

import numpy as np
import pytest

from controller.signals.cusum import CREDIT, MISSING, MOST_VIBRATION_NAT, Cusum, accumulate, log_odds, louder
from controller.signals.octaves import ENERGY, LEVEL, filter_octaves, judge_octaves, learn_octaves, octaves
from controller.signals.whitening import predictor


def cusum():
    state = np.zeros(17)
    state[CREDIT] = math.log(200.0)
    weights = {"knock": 0.2, "jump": 0.001, "ratio": 30.0, "cap": math.log(200.0), "refill": 0.6}
    follows = {"patience": 100, "follow": 0.02, "most_followed": math.log(2.25), "sample_s": 1e-3}
    tail = {"tail_share": 0.02, "tail_normal": 1.6887, "strike": 100, "deaf": 1000}
    return Cusum(**weights, **follows, **tail, state=state, totals=np.zeros(33))


ODDS = cusum()


class Channel:
    """A channel; below 60 Hz it has no octaves, and detects knocks alone."""

    def __init__(self, rate_hz, ceiling=math.inf):
        memory = {"keep": math.exp(-1 / 4000), "keep_energy": math.exp(-1 / 10), "scale": 2000.0}
        self.cusum, self.ceiling = cusum(), ceiling
        self.parts = self.cusum, predictor(10, 100, **memory, model_error=0.1), octaves(rate_hz)

    def __call__(self, x):
        out, begin = np.empty(len(x)), 0
        while begin < len(x):
            begin += accumulate(*self.parts, x[begin:], self.ceiling, out[begin:])
        return np.nan_to_num(out)


def trace(x, ceiling=math.inf):
    return Channel(50.0, ceiling)(x)


@pytest.mark.parametrize("z", [0.0, 0.5, 1.0, 3.0, 6.0])
def test_log_odds_are_those_of_the_two_mixtures(z):
    from scipy.stats import norm  # a second to load: for this test alone

    noise, knock = norm.pdf(z), norm.pdf(z, scale=math.sqrt(ODDS.ratio))
    slipping = (1 - ODDS.knock) * noise + ODDS.knock * knock
    holding = (1 - ODDS.jump) * noise + ODDS.jump * knock
    assert log_odds(ODDS, z * z) == pytest.approx(math.log(slipping / holding), rel=1e-9)


def test_one_blow_counts_once_and_four_count_four_times():
    x = np.random.default_rng(1).standard_normal(3000)
    blow = np.array([40.0, 80.0, 40.0])
    one, four = x.copy(), x.copy()
    one[2000:2003] += blow
    for start in (2000, 2015, 2030, 2045):
        four[start : start + 3] += blow
    assert ODDS.cap * 0.9 < trace(one)[2000:2010].max() < ODDS.cap + 10 * ODDS.refill
    assert trace(four)[2000:2060].max() > 3.0 * ODDS.cap


def test_the_sum_leaves_neither_zero_nor_the_ceiling_and_no_innovation_is_worth_more_than_the_cap():
    rng = np.random.default_rng(2)
    x = rng.standard_normal(4000)
    x[2000:3000] += 30.0 * rng.standard_normal(1000)
    found = trace(x, ceiling=12.0)
    assert found.min() == 0.0
    assert found.max() == 12.0
    assert log_odds(ODDS, 1e300) == pytest.approx(ODDS.cap, rel=1e-6)
    assert log_odds(ODDS, math.inf) <= ODDS.cap


def test_missing_samples_are_counted_until_the_next_good_one():
    channel = Channel(50.0)
    channel(np.random.default_rng(4).standard_normal(500))
    assert channel.cusum.state[MISSING] == 0.0
    channel(np.full(7, np.nan))
    assert channel.cusum.state[MISSING] == 7.0


def test_vibration_of_many_octaves_is_detected_at_once_but_never_beyond_its_worth():
    rng = np.random.default_rng(6)
    x = rng.standard_normal(6000)
    x[5000:] += np.cumsum(rng.standard_normal(1000)) * 10.0
    knocks, both = trace(x), Channel(1000.0)(x)
    assert np.argmax(both[5000:] > 10.0) < 4
    assert both[:5000].max() < 8.0
    assert (both >= knocks).all()
    assert both[both > knocks].max() <= MOST_VIBRATION_NAT


def test_a_smoothly_starting_arm_is_no_vibration():
    x = np.random.default_rng(7).standard_normal(6000)
    t_s = np.maximum(0.0, (np.arange(6000) - 5000) / 1000.0)
    smooth = 0.5 * (t_s - 0.03 / np.pi * np.sin(np.pi * t_s / 0.03))
    x += 1000.0 * np.where(t_s < 0.03, smooth, t_s - 0.015)
    assert Channel(1000.0)(x)[5000:].max() < 8.0


def test_louder_is_the_likelihood_ratio_of_the_best_window():
    squared = np.array([1.0, 0.2, 9.0, 4.0])
    totals = np.concatenate([[0.0], np.cumsum(squared)])
    windows = [squared[-n:].mean() for n in (1, 2, 4)]
    best = max(0.5 * n * (r - 1.0 - math.log(r)) for n, r in zip((1, 2, 4), windows, strict=True))
    assert louder(totals, 4) == pytest.approx(best)


def relearned(learned_size, then_size, n, seed):
    """By how much the quiet levels, learned at one size of noise, have fallen after n samples at another, nat."""
    bands, rng = octaves(1000.0), np.random.default_rng(seed)
    for number, x in enumerate(rng.normal(0.0, learned_size, 1000)):
        filter_octaves(bands, x, math.inf)
        learn_octaves(bands, 1e-9, number + 1)
    learned = bands.states[:, LEVEL].copy()
    for x in rng.normal(0.0, then_size, n):
        filter_octaves(bands, x, math.inf)
        judge_octaves(bands, 1e-9, 0.0, -math.inf)
    return learned - bands.states[:, LEVEL]


def test_quiet_that_was_learned_beside_servos_is_forgotten_soon_where_there_is_less_and_else_kept():
    # followed by half a nat a second alone, the levels would be four nats too high still;
    # a tenth of the amplitude is 4.6 nats less
    assert relearned(10.0, 1.0, 1500, seed=3) == pytest.approx(4.6, abs=1.2)
    assert relearned(1.0, 1.0, 10_000, seed=4) == pytest.approx(0.0, abs=0.8)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0, 2200.0])
def test_the_energy_that_an_octave_has_of_white_noise_is_known(rate_hz):
    bands, noise = octaves(rate_hz), np.random.default_rng(5).standard_normal(round(60.0 * rate_hz))
    energies = []
    for x in noise:
        filter_octaves(bands, x, math.inf)
        energies.append(bands.states[:, ENERGY].copy())
    mean = np.mean(energies, axis=0)
    # the lowest has a little less, for the high-pass ahead of all
    assert np.exp(bands.shares[1:]) == pytest.approx(mean[1:], rel=0.25)
    assert 1.0 < np.exp(bands.shares[0]) / mean[0] < 2.0


def test_no_quiet_level_falls_below_that_of_the_noise_that_a_converter_makes():
    bands = octaves(1000.0)
    least = math.log(0.25 * 0.1**2)
    for _ in range(20_000):
        filter_octaves(bands, 3.0, math.inf)
        judge_octaves(bands, 1e-9, 0.0, least)
    assert bands.states[:, LEVEL] == pytest.approx(least + bands.shares)
