"""Crossings of piecewise polynomials, and noise by counter."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.physics.noise import gaussian_at, normal, philox
from simulator.physics.piecewise import BRACKET, DEGREE, SPAN, degree_for, parts_for, rising, value_slope


def sine(offset: float, amplitude: float, phase: float, reach: float) -> np.ndarray:
    """Terms of offset + amplitude sin(phase + reach u)."""
    turns = (math.sin(phase), math.cos(phase), -math.sin(phase), -math.cos(phase))
    terms = np.array([amplitude * turns[k % 4] * reach**k / math.factorial(k) for k in range(DEGREE + 1)])
    terms[0] += offset
    return terms


def test_a_rising_crossing_is_found_to_the_last_bit():
    terms = sine(-0.5, 1.0, 0.0, 2.0)
    assert rising(terms, DEGREE, 3, 1.0, 0.0) == pytest.approx(math.asin(0.5) / 2.0, abs=2e-16)


def test_a_falling_crossing_does_not_count():
    assert rising(sine(0.0, 1.0, math.pi / 2, 2.0), DEGREE, 3, 1.0, -0.2) == 0.0  # above and flat: due
    assert rising(sine(0.0, -1.0, -0.5, 1.5), DEGREE, 3, 1.0, 0.0) == math.inf


def test_sign_and_level_look_at_the_same_polynomial_from_below():
    terms = sine(0.0, 1.0, 0.3, 2.0)
    assert rising(terms, DEGREE, 3, 1.0, 0.6) == pytest.approx((math.asin(0.6) - 0.3) / 2.0, abs=2e-16)
    assert rising(-terms, DEGREE, 3, -1.0, 0.6) == rising(terms, DEGREE, 3, 1.0, 0.6)


@pytest.mark.parametrize(
    ("height", "touches"), [(1e-14, True), (1e-15, True), (-1e-15, False), (-1e-14, False)]
)
def test_a_graze_counts_if_and_only_if_its_top_is_above(height, touches):
    terms = sine(-1.0 + height, 1.0, 0.4, 2.4)
    u = rising(terms, DEGREE, 4, 1.0, 0.0)
    assert math.isfinite(u) == touches
    if touches:
        # the first of the two crossings, left of the top by sqrt(2 height)
        assert u == pytest.approx((math.pi / 2 - 0.4 - math.sqrt(2 * height)) / 2.4, abs=2e-8)


def test_a_start_at_zero_that_falls_is_not_a_crossing_but_its_return_is():
    terms = sine(0.0, -1.0, 0.0, 2.5)
    assert rising(terms, DEGREE, 4, 1.0, 0.0) == math.inf
    dip = np.zeros(DEGREE + 1)
    dip[1], dip[2] = -0.25, 1.0
    assert rising(dip, DEGREE, 1, 1.0, 0.0) == pytest.approx(0.25, abs=1e-16)


def test_a_start_above_zero_that_rises_is_due_at_once():
    assert rising(np.array([1e-9, 1.0, 0.0, 0.0]), 3, 1, 1.0, 0.0) == 0.0


def test_rest_at_zero_followed_by_acceleration_is_a_crossing_at_the_start():
    assert rising(np.array([0.0, 0.0, 0.5, 0.0]), 3, 1, 1.0, 0.0) == 0.0


def product(*roots: float) -> np.ndarray:
    """Terms of the product of (u - root)."""
    return np.polynomial.polynomial.polyfromroots(roots)


@pytest.mark.parametrize("parts", [1, 2, 5])
@pytest.mark.parametrize("width", [0.4, 1e-2, 1e-4])
def test_a_rise_is_found_however_soon_the_fall_after_it(parts, width):
    # three crossings within one step, which no sign at its ends shows: falls, rises, falls
    low = 0.0123
    terms = -product(low - 0.01, low, low + width)
    assert rising(terms, 3, parts, 1.0, 0.0) == pytest.approx(low, abs=1e-14)
    assert rising(-terms, 3, parts, -1.0, 0.0) == rising(terms, 3, parts, 1.0, 0.0)


def test_a_start_at_zero_that_dips_and_returns_is_found_before_it_falls_again():
    terms = -product(0.0, 0.003, 0.4)
    assert rising(terms, 3, 2, 1.0, 0.0) == pytest.approx(0.003, abs=1e-15)


def test_a_crossing_at_the_very_end_of_a_step_is_found():
    # the search halves [0, 1] down to [0, 0.25], where the polynomial is zero to the last bit
    assert rising(product(0.25, 0.41, 0.45), 3, 1, 1.0, 0.0) == pytest.approx(0.25, abs=1e-15)


@given(roots=st.lists(st.integers(1, 99), min_size=2, max_size=7, unique=True), parts=st.integers(1, 4))
def test_the_first_of_many_crossings_is_the_one_that_is_found(roots, parts):
    roots = sorted(roots)
    terms = product(*(root / 100.0 for root in roots))
    upwards = roots[0 if len(roots) % 2 else 1]
    if len(roots) % 2 == 0:
        # begins above and falls: armed by the first root, due at the second
        assert terms[0] > 0.0 > terms[1]
    slope = np.prod([(upwards - root) / 100.0 for root in roots if root != upwards])
    rounding = 1e-15 * np.abs(terms).sum() / slope
    assert rising(terms, len(roots), parts, 1.0, 0.0) == pytest.approx(
        upwards / 100.0, abs=1e-14 + 10 * rounding
    )


@given(offset=st.floats(-1.2, 1.2), phase=st.floats(0.0, 2 * math.pi), reach=st.floats(0.05, SPAN))
def test_the_first_crossing_agrees_with_a_dense_scan(offset, phase, reach):
    terms = sine(offset, 1.0, phase, reach)
    u = rising(terms, DEGREE, parts_for(reach), 1.0, 0.0)
    grid = np.linspace(0.0, 1.0, 4001)
    values = offset + np.sin(phase + reach * grid)
    if values[0] > 0.0 and math.cos(phase) >= 0.0:
        assert u == 0.0
        return
    below = np.maximum.accumulate(values < -1e-9)
    crossings = np.flatnonzero(below[:-1] & (values[:-1] < 0.0) & (values[1:] >= 1e-9))
    if crossings.size:
        assert u <= grid[crossings[0] + 1]
    if math.isfinite(u):
        g, rate = value_slope(terms, DEGREE, u)
        # a crossing, or where a start above zero stops falling
        assert abs(g) < 1e-14 or (values.min() > -1e-9 and abs(rate) < 1e-7)
        assert rate >= -1e-7


def test_the_terms_left_out_are_below_rounding():
    for reach in np.linspace(0.01, SPAN, 50):
        degree = degree_for(reach)
        assert degree <= DEGREE
        assert reach ** (degree + 1) / math.factorial(degree + 1) < 1e-16


def test_no_part_of_a_search_is_longer_than_the_bracket():
    for reach in np.linspace(0.0, SPAN, 50):
        assert reach / parts_for(reach) <= BRACKET


WORDS = [
    # known answers for philox4x32-10, from Random123's kat_vectors
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


def gaussian(key, stream, first, n):
    return gaussian_at(key, stream, np.arange(first, first + n, dtype=np.int64))


@pytest.mark.parametrize(("counter", "key", "expected"), WORDS)
def test_philox_gives_the_published_answers(counter, key, expected):
    assert tuple(int(word) for word in philox(*(np.uint64(word) for word in (*counter, *key)))) == expected


def test_the_noise_is_standard_normal():
    from scipy.stats import kstest  # a second to load: for this test alone

    sample = gaussian((7, 3), 0, 0, 200_000)
    assert kstest(sample, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(sample[:-1], sample[1:])[0, 1]) < 4 / np.sqrt(sample.size)


def test_skipping_and_order_change_no_sample():
    whole = gaussian((7, 3), 2, -50, 1000)
    assert np.array_equal(gaussian((7, 3), 2, 313, 17), whole[363:380])
    order = np.random.default_rng(1).permutation(1000)
    assert np.array_equal(gaussian_at((7, 3), 2, order - 50), whole[order])
    assert normal(7, 3, 2, 900) == whole[950]


@pytest.mark.parametrize(("key", "stream"), [((8, 3), 2), ((7, 4), 2), ((7, 3), 1), ((7 + 2**40, 3), 2)])
def test_another_seed_trial_or_stream_is_other_noise(key, stream):
    a, b = gaussian((7, 3), 2, 0, 20_000), gaussian(key, stream, 0, 20_000)
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(a.size)
