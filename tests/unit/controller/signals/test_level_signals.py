"""The z-score of a sample in its own window, against the plain formula."""

import math

import numpy as np
import pytest

from controller.signals.level import window, z_scores


def scores(y, size, missing=None, pieces=1):
    state, found = window(size), []
    missing = np.zeros(len(y), np.int64) if missing is None else missing
    for part, lost in zip(np.array_split(y, pieces), np.array_split(missing, pieces), strict=True):
        out = np.empty(len(part))
        z_scores(state, np.ascontiguousarray(part), lost, out)
        found.append(out)
    return np.concatenate(found)


def plain(y, size):
    found = np.full(len(y), np.nan)
    for i in range(size - 1, len(y)):
        inside = y[i - size + 1 : i + 1]
        found[i] = (y[i] - inside.mean()) / inside.std(ddof=1)
    return found


@pytest.mark.parametrize("pieces", [1, 17, 500])
def test_it_is_the_plain_formula_however_the_samples_come(pieces):
    y = 0.2 + 1e-5 * np.random.default_rng(1).standard_normal(500)
    assert scores(y, 40, pieces=pieces) == pytest.approx(plain(y, 40), rel=1e-6, nan_ok=True)


def test_a_large_offset_and_a_glitch_leave_no_error_behind():
    y = 50.0 + 1e-5 * np.random.default_rng(2).standard_normal(5000)
    y[1000] = -99.0
    assert scores(y, 100)[2000:] == pytest.approx(plain(y, 100)[2000:], rel=1e-4)


@pytest.mark.parametrize("size", [3, 10, 100])
def test_no_sample_can_be_farther_than_its_window_allows(size):
    y = np.zeros(size)
    y[-1] = 1.0
    assert abs(scores(y, size)[-1]) == pytest.approx((size - 1) / math.sqrt(size), rel=1e-6)


def test_a_constant_window_gives_no_score():
    assert np.isnan(scores(np.full(300, 0.1), 50)).all()


def test_a_gap_begins_the_window_anew_and_a_value_that_is_not_finite_is_left_out():
    y = np.random.default_rng(3).standard_normal(100)
    y[20] = np.nan
    missing = np.zeros(100, np.int64)
    missing[60] = 5
    found = scores(y, 10, missing)
    assert np.flatnonzero(np.isnan(found)).tolist() == [*range(9), 20, *range(60, 69)]
