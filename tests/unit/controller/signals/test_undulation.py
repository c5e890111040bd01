"""The wave along the way, against plain least squares."""

import numpy as np
import pytest

from controller.signals.undulation import NUISANCES, fit_wave, wave_fit

KAPPA_RAD_M = 1465.0
CELL_M = 0.00027


def way(**changes):
    waves = {"kappa_rad_m": np.array([KAPPA_RAD_M, -KAPPA_RAD_M]), "straight": np.array([0, 1])}
    lengths = {"cell_m": CELL_M, "memory_m": 0.008, "least_m": 0.005, "longest": 200, "background_fs": 0.0}
    return waves | lengths | {"lag": 56, "stretch": 0, "pause": 5000, "patience": 500} | changes


def fitted(z, x_m, constants=None, missing=None):
    constants = constants or way()
    ratios, amplitudes = np.empty(len(z)), np.empty(len(z))
    missing = np.zeros(len(z), np.int64) if missing is None else missing
    fit_wave(wave_fit(**constants), np.asarray(z, complex), x_m, missing, ratios, amplitudes)
    return ratios, amplitudes


def noise(n, seed=1):
    rng = np.random.default_rng(seed)
    return 5e-5 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))


def echo(x_m, surface_m=0.055, size=0.001):
    gap_m = surface_m - x_m
    return size * (1.0 + gap_m / 0.01) ** -2 * np.exp(-1j * KAPPA_RAD_M * gap_m)


def test_the_sums_give_what_plain_weighted_least_squares_give():
    """Independent of the recursion: a design matrix, weights, numpy's solver."""
    x_m = np.arange(120) * 0.0003  # each sample is longer than a cell
    z = 0.1 - 0.05j + 3.0 * x_m * (0.01 + 0.02j) + echo(x_m) + noise(120)
    ratios, amplitudes = fitted(z, x_m, way(kappa_rad_m=np.array([KAPPA_RAD_M]), straight=np.array([0])))
    # the median of three lags by one sample, a cell's mean is of the one sample in it, the first only starts the way
    medians = [np.median([part[:-2], part[1:-1], part[2:]], axis=0) for part in (z.real, z.imag)]
    middle = medians[0] + 1j * medians[1]
    cells, places_m = middle[1:], x_m[2:-1]
    cells[0], places_m[0] = middle[:2].mean(), x_m[1:3].mean()  # the first cell holds two
    for count in (40, 80, len(cells)):
        z_c, x_c = cells[:count], places_m[:count]
        weights = np.exp(-(x_c[-1] - x_c) / 0.008)
        root = np.sqrt(weights)[:, None]
        wave = np.exp(1j * KAPPA_RAD_M * x_c)
        plain = np.column_stack([np.ones(count), x_c]).astype(complex)
        full = np.column_stack([plain, wave])

        def left(design, z_c=z_c, root=root, weights=weights):
            found = np.linalg.lstsq(root * design, root[:, 0] * z_c, rcond=None)[0]
            return float(np.sum(weights * np.abs(z_c - design @ found) ** 2)), found

        without, _ = left(plain)
        with_wave, found = left(full)
        freedom = weights.sum() ** 2 / np.sum(weights**2) - NUISANCES
        expected = (without - with_wave) / (with_wave / freedom + 1e-14)
        place = count + 2
        assert amplitudes[place] == pytest.approx(abs(found[2]), rel=1e-6)
        assert ratios[place] == pytest.approx(expected, rel=1e-3)


def test_the_same_way_gives_the_same_amplitude_at_any_speed():
    found = []
    for speed_m_s in (0.003, 0.01, 0.03, 0.1):
        x_m = np.arange(0.0, 0.045, speed_m_s * 1e-3)
        _, amplitudes = fitted(0.1 + echo(x_m), x_m)
        found.append(amplitudes[np.isfinite(amplitudes)][-1])
    assert found == pytest.approx([found[0]] * 4, rel=0.03)


def test_neither_standing_still_nor_a_slope_of_the_level_is_a_wave():
    ratios, _ = fitted(0.1 + noise(20_000), np.full(20_000, 0.01))
    assert np.isnan(ratios).all()
    x_m = np.arange(0.0, 0.05, 1e-5)
    ratios, amplitudes = fitted(0.1 + 0.5 * x_m + noise(len(x_m)), x_m)
    assert np.nanmax(ratios) < 18.0
    assert np.nanmax(amplitudes) < 5e-5


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e9, 50.0])
def test_one_bad_sample_costs_at_most_a_cell(bad):
    x_m = np.arange(0.0, 0.05, 1e-5)
    z = 0.1 + echo(x_m) + noise(len(x_m))
    spoiled = z.copy()
    spoiled[3000] = bad
    good, _ = fitted(z, x_m)
    ratios, _ = fitted(spoiled, x_m)
    last = np.flatnonzero(np.isfinite(good))[-1]
    assert ratios[last] == pytest.approx(good[last], rel=0.05)


def test_lost_samples_cost_a_cell_and_no_false_wave():
    x_m = np.arange(0.0, 0.05, 1e-5)
    z = 0.1 + noise(len(x_m))
    keep = np.ones(len(x_m), bool)
    keep[2000:2100] = False
    missing = np.zeros(keep.sum(), np.int64)
    missing[2000] = 100
    ratios, _ = fitted(z[keep], x_m[keep], missing=missing)
    assert np.nanmax(ratios) < 18.0


def test_a_jump_of_the_level_restarts_the_fit_and_is_no_wave():
    x_m = np.arange(0.0, 0.05, 1e-5)
    z = 0.1 + noise(len(x_m))
    z[2500:] += 0.02
    ratios, _ = fitted(z, x_m)
    assert np.nanmax(ratios) < 18.0
    after = np.flatnonzero(np.isfinite(ratios) & (np.arange(len(x_m)) > 2500))
    assert after[0] > 2500 + 490  # 5 mm of way at 10 um a sample, less what was half done


def still(x_m, size):
    return size * np.exp(1j * KAPPA_RAD_M * x_m)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_wave_that_does_not_grow_is_background_and_one_that_grows_upon_it_is_not(sense):
    x_m = np.arange(170) * 0.0003
    z = 0.1 + noise(170) + still(sense * x_m, 1e-4)
    kind, unset = way(background_fs=1.5e-4), way()
    assert np.nanmax(fitted(z, x_m, unset)[0]) > 18.0
    assert np.nanmax(fitted(z, x_m, kind)[0]) < 18.0
    ratios, _ = fitted(z + echo(x_m, size=0.02), x_m, kind)
    assert 0.055 - x_m[np.flatnonzero(ratios > 18.0)[0]] > 0.03


def test_once_the_room_has_proved_quiet_a_wave_below_the_largest_background_is_detected():
    x_m = np.arange(170) * 0.0003
    z = 0.1 + 0.1 * noise(170) + echo(x_m, size=0.0015)
    gap_m = {}
    for lag in (56, 10_000):  # the second never learns
        ratios, _ = fitted(z, x_m, way(background_fs=1.5e-4, lag=lag))
        gap_m[lag] = 0.055 - x_m[np.flatnonzero(ratios > 18.0)[0]]
    assert gap_m[56] > gap_m[10_000] + 0.003


def test_two_walls_whose_waves_cancel_where_a_room_is_learned_are_learned_over_a_stretch():
    x_m = np.arange(170) * 0.0003
    z = 0.1 + 0.1 * noise(170) + still(x_m, 1e-4) * np.where(x_m < 0.007, 0.3, 1.0)
    alone, over_40 = (way(background_fs=1.5e-4, stretch=stretch) for stretch in (0, 40))
    assert np.nanmax(fitted(z, x_m, alone)[0]) > 18.0 > np.nanmax(fitted(z, x_m, over_40)[0])


@pytest.mark.parametrize(("away_m", "object_near"), [(0.15, False), (0.12, False), (0.055, True)])
def test_a_wall_far_ahead_grows_beyond_what_is_granted_and_is_no_object(away_m, object_near):
    x_m = np.arange(150) * 0.0003
    size = 1e-4 * (1.0 + away_m / 0.01) ** 2  # 1e-4 at the start, whatever its distance
    z = 0.1 + 0.1 * noise(150) + echo(x_m, surface_m=away_m, size=size)
    ratios, amplitudes = fitted(z, x_m, way(background_fs=1.5e-4, stretch=22))
    assert np.nanmax(amplitudes) > 1.5e-4
    assert (np.nanmax(ratios) > 18.0) == object_near


def test_a_weak_echo_straight_ahead_is_seen_beside_a_louder_wall_that_is_not():
    """Held against the loudest wave of all it would be background; against its own past it grows."""
    x_m = np.arange(170) * 0.0003
    kappas = KAPPA_RAD_M * np.array([1.0, 0.7, -1.0, -0.7])
    wall = 1.2e-4 * np.exp(0.7j * KAPPA_RAD_M * x_m)
    z = 0.1 + 0.05 * noise(170) + wall + echo(x_m, size=0.0008)
    gap_m = {}
    for straight in ([0, 2], []):
        about = way(background_fs=1.5e-4, kappa_rad_m=kappas, straight=np.array(straight, dtype=np.int64))
        seen = np.flatnonzero(fitted(z, x_m, about)[0] > 18.0)
        gap_m[len(straight)] = 0.055 - x_m[seen[0]] if len(seen) else 0.0
    assert gap_m[2] > gap_m[0] + 0.002


def test_what_was_learned_of_a_room_is_forgotten_with_the_fit_and_there_is_no_drift_over_100_metres():
    x_m = np.arange(340) * 0.0003
    z = 0.1 + noise(340) + np.where(np.arange(340) < 170, 0.0, still(x_m, 9e-5) + 0.3)
    assert np.nanmax(fitted(z, x_m, way(background_fs=1.5e-4))[0][170:]) < 18.0
    x_m = 0.02 * np.sin(np.arange(400_000) * 5e-4)
    z = 0.1 + 0.001 * np.exp(1j * KAPPA_RAD_M * x_m)
    _, amplitudes = fitted(z, x_m)
    known = amplitudes[np.isfinite(amplitudes)]
    assert known[-1000:] == pytest.approx(0.001, rel=0.02)
