import math

import numpy as np
import pytest
from scipy.stats import norm

from controller.signals.evidence import MISSING, Odds, accumulate, log_odds
from controller.signals.whitening import Settling, predictor

ODDS = Odds(knock=0.2, jump=0.001, ratio=30.0, cap=math.log(200.0), refill=0.6, patience=100)
SETTLING = Settling(
    learn=100,
    keep=math.exp(-1 / 4000),
    keep_energy=math.exp(-1 / 10),
    scale=2000.0,
    model_error=0.1,
)


def trace(x, ceiling=math.inf, odds=ODDS):
    out = np.empty(len(x))
    accumulate(odds, SETTLING, predictor(10, SETTLING.learn), np.array([0.0, odds.cap, 0.0]), x, ceiling, out)
    return out


@pytest.mark.parametrize("z", [0.0, 0.5, 1.0, 3.0, 6.0])
def test_log_odds_are_those_of_the_two_mixtures(z):
    noise, knock = norm.pdf(z), norm.pdf(z, scale=math.sqrt(ODDS.ratio))
    slipping = (1 - ODDS.knock) * noise + ODDS.knock * knock
    holding = (1 - ODDS.jump) * noise + ODDS.jump * knock
    assert log_odds(ODDS, z * z) == pytest.approx(math.log(slipping / holding), rel=1e-9)


def test_no_innovation_is_worth_more_than_the_cap():
    assert log_odds(ODDS, 1e300) == pytest.approx(ODDS.cap, rel=1e-6)
    assert log_odds(ODDS, math.inf) <= ODDS.cap


def test_one_blow_counts_once_and_four_count_four_times():
    x = np.random.default_rng(1).standard_normal(3000)
    blow = np.array([40.0, 80.0, 40.0])
    one, four = x.copy(), x.copy()
    one[2000:2003] += blow
    for start in (2000, 2015, 2030, 2045):
        four[start : start + 3] += blow
    assert ODDS.cap * 0.9 < trace(one)[2000:2010].max() < ODDS.cap + 10 * ODDS.refill
    assert trace(four)[2000:2060].max() > 3.0 * ODDS.cap


def test_the_sum_never_leaves_zero_downwards_nor_the_ceiling_upwards():
    rng = np.random.default_rng(2)
    x = rng.standard_normal(4000)
    x[2000:3000] += 30.0 * rng.standard_normal(1000)
    found = trace(x, ceiling=12.0)
    assert found.min() == 0.0
    assert found.max() == 12.0


def test_a_short_gap_keeps_the_sum_and_a_long_one_does_not():
    rng = np.random.default_rng(3)
    x = rng.standard_normal(4000)
    x[2000:2200] += 30.0 * rng.standard_normal(200)
    short, long = x.copy(), x.copy()
    short[2200:2260] = np.nan
    long[2200:2400] = np.nan
    assert trace(short)[2259] == trace(short)[2199] > 20.0
    assert trace(long)[2399] == 0.0


def test_missing_samples_are_counted_until_the_next_good_one():
    state = np.array([0.0, ODDS.cap, 0.0])
    parts = predictor(10, SETTLING.learn)
    x = np.random.default_rng(4).standard_normal(500)
    accumulate(ODDS, SETTLING, parts, state, x, math.inf, np.empty(500))
    assert state[MISSING] == 0.0
    accumulate(ODDS, SETTLING, parts, state, np.full(7, np.nan), math.inf, np.empty(7))
    assert state[MISSING] == 7.0
