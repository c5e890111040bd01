"""The fingertip on its table against closed forms; sticking and slipping: tests/stability/test_tip_exact.py."""

import math

import numpy as np
import pytest

from simulator.physics.slip import BridgeSettings, SlipPlant
from tests.stability.tip_oracles import FT, bare


def spring(settings):
    return settings.mass_kg * (2 * math.pi * settings.mode_hz) ** 2


def dragged(settings, speed_m_s, seconds, *, key=(1, 1), press_m=1e-3):
    """Arm at constant speed from t = 0 on, pressed all the time."""
    plant = SlipPlant(settings)
    plant.begin(key=key, press_m=press_m)
    n = round(seconds * settings.rate_hz)
    t_s = np.arange(1, n + 1) / settings.rate_hz
    values = plant.advance(speed_m_s * t_s, np.full(n, press_m), np.zeros(n))
    return values[:, 0], plant.slid_m, t_s


@pytest.mark.parametrize(("frequency_hz", "damping"), [(180.0, 0.03), (375.0, 0.01), (60.0, 0.2)])
def test_a_free_tip_rings_as_in_closed_form(frequency_hz, damping):
    settings = bare(mode_hz=frequency_hz, damping_ratio=damping)
    speed_m_s = 0.01
    force_n, _, t_s = dragged(settings, speed_m_s, 0.2, press_m=-1e-3)
    # an arm that jumps to a speed leaves the tip behind by v / omega_d exp(-zeta omega t) sin(omega_d t)
    omega = 2 * math.pi * frequency_hz
    omega_d = omega * math.sqrt(1 - damping**2)
    behind_m = speed_m_s / omega_d * np.exp(-damping * omega * t_s) * np.sin(omega_d * t_s)
    assert (
        np.max(np.abs(force_n - spring(settings) * behind_m))
        < 1e-12 * spring(settings) * speed_m_s / omega * 1e3
    )


@pytest.mark.parametrize(("roughness", "within"), [(0.0, 0.005), (0.05, 0.03)])
def test_sliding_drags_with_the_kinetic_friction_on_average(roughness, within):
    """On a rough table a little more: patches that hold take longer to pass."""
    settings = bare(roughness=roughness, static_excess=0.0, damping_ratio=0.2)
    force_n, slid_m, _ = dragged(settings, 0.02, 3.0)
    assert slid_m[-1] - slid_m[0] == pytest.approx(0.06, rel=0.1)
    assert force_n[500:].mean() == pytest.approx(0.2 * 5.0, rel=within)


def test_the_arms_way_is_what_has_slid_and_what_is_stretched():
    """Over some hundred sticks and slips; the contact holds no more than static friction bears."""
    settings = bare(static_excess=0.2)
    force_n, slid_m, t_s = dragged(settings, 0.01, 10.0)
    held_m = 0.01 * t_s - force_n / spring(settings) - slid_m
    most_m = 1.2 * 0.2 * 5.0 / (settings.contact_ratio * spring(settings))
    assert np.abs(held_m).max() <= most_m * (1.0 + 1e-9)
    assert held_m.max() > 0.99 * most_m


def test_sliding_back_meets_the_same_table():
    """Friction belongs to the place: a patch is as rough on the way back."""
    settings = bare(roughness=0.3, damping_ratio=0.3)
    plant = SlipPlant(settings)
    tip = plant._tip
    from simulator.physics.slip_kernel import _patch_friction

    frictions = [_patch_friction(tip, patch) for patch in range(-500, 500)]
    assert np.mean(frictions) == pytest.approx(0.2, rel=0.05)
    assert np.std(frictions) == pytest.approx(0.06, rel=0.1)
    assert frictions == [_patch_friction(tip, patch) for patch in range(-500, 500)]


@pytest.mark.parametrize("sizes", [[1] * 600, [7] * 86, [600], [64] * 10])
def test_blocks_of_any_size_give_the_same_samples(sizes):
    settings = bare(
        roughness=0.1,
        rolling_n=0.1,
        bumps_hz=20.0,
        loads_hz=5.0,
        bridges=(FT.model_copy(update={"noise": 0.01, "hysteresis": 0.05, "step": 0.001}),),
    )
    t_s = np.arange(1, 601) / 1000.0
    tracks = 0.01 * t_s, np.full(600, 1e-3), 0.1 * t_s
    plant = SlipPlant(settings)
    plant.begin(key=(3, 4), press_m=1e-3)
    whole = plant.advance(*tracks)
    plant.begin(key=(3, 4), press_m=1e-3)
    pieces, start = [], 0
    for size in sizes:
        pieces.append(plant.advance(*(track[start : start + size] for track in tracks)))
        start += size
    assert np.array_equal(np.concatenate(pieces), whole)


def test_what_is_shown_of_some_samples_is_what_is_shown_of_all():
    plant = SlipPlant(bare(bridges=(FT.model_copy(update={"noise": 0.01, "step": 0.001}),) * 2))
    plant.begin(key=(3, 4), press_m=1e-3)
    t_s = np.arange(1, 601) / 1000.0
    felt = plant.feel(0.01 * t_s, np.full(600, 1e-3), np.zeros(600))
    plant.begin(key=(3, 4), press_m=1e-3)
    whole = plant.advance(0.01 * t_s, np.full(600, 1e-3), np.zeros(600))
    some = np.array([0, 1, 17, 18, 599])
    assert np.array_equal(plant.shown(felt[some], some), whole[some])
    assert not np.array_equal(felt, whole)


def test_a_tip_at_rest_in_the_air_is_where_one_that_might_be_shaken_is():
    # bumps that never come: each sample is computed
    still, computed = (SlipPlant(bare(rolling_n=0.1, bumps_hz=hz)) for hz in (0.0, 1e-12))
    track = np.concatenate([np.zeros(50), np.linspace(0.0, 1e-3, 50), np.full(2000, 1e-3)])
    for arm_m in (np.zeros(track.size), track):
        pairs = []
        for plant in (still, computed):
            plant.begin(key=(3, 4), press_m=-1e-3)
            values = plant.advance(arm_m, track - 5e-4, np.zeros(track.size))
            pairs.append((values, plant.slid_m, plant.normal_n))
        for mine, theirs in zip(*pairs, strict=True):
            assert np.array_equal(mine, theirs)
    assert np.ptp(values) > 0.0


def test_keys_give_other_noise_and_another_table_and_the_same_key_the_same():
    settings = bare(roughness=0.1)
    first, again, other = (dragged(settings, 0.01, 0.5, key=key)[0] for key in ((1, 1), (1, 1), (1, 2)))
    assert np.array_equal(first, again)
    assert np.max(np.abs(first - other)) > 0.01


def test_bumps_come_once_a_second_and_their_rings_are_exponential_in_size():
    settings = bare(bumps_hz=1.0, damping_ratio=0.1, roughness=0.05)
    plant = SlipPlant(settings)
    plant.begin(key=(5, 1), press_m=0.01)
    n = 1_000_000
    force_n = plant.advance(np.zeros(n), np.full(n, 0.01), np.zeros(n))[:, 0]
    quiet = np.abs(force_n) < 1e-3
    starts = np.flatnonzero(~quiet[1:] & (np.convolve(quiet, np.ones(20), "full")[: n - 1] >= 20))
    peaks = np.array([np.abs(force_n[start : start + 15]).max() for start in starts])
    # overlapping bumps are counted once, and the smallest not at all
    assert 900 < starts.size < 1100
    expected_n = 1.5 * settings.slip_event_n
    # the ring has lost a little by its first peak, and its contact holds a little of it
    assert 0.6 * expected_n < peaks.mean() < 1.1 * expected_n
    assert np.std(peaks) == pytest.approx(peaks.mean(), rel=0.15)


def test_load_steps_have_the_size_that_is_asked_for():
    settings = bare(loads_hz=0.2, load_low=0.5, load_high=0.5, damping_ratio=0.3)
    plant = SlipPlant(settings)
    plant.begin(key=(6, 1), press_m=0.1)
    n = 200_000
    force_n = plant.advance(np.zeros(n), np.full(n, 0.1), np.zeros(n))[:, 0]
    levels = np.abs(force_n)[np.abs(np.gradient(force_n)) < 1e-9]
    assert levels.max() == pytest.approx(0.5, rel=1e-6)
    assert np.sum(np.isclose(levels, 0.5, rtol=1e-6)) > 0.2 * n


def test_hysteresis_is_the_largest_difference_of_loading_and_unloading():
    bridge = BridgeSettings(
        name="F", normal_cosine=1.0, gain=0.0694, full_scale_n=7.0, hysteresis=0.06, noise=0.0
    )
    settings = bare(bridges=(bridge,))
    plant = SlipPlant(settings)
    plant.begin(key=(1, 1))
    up = np.linspace(0.0, 7.0 / settings.normal_n_m, 701)
    press_m = np.concatenate([up, up[::-1]])
    for _ in range(2):  # the first loading is another: it starts without a past
        volts = plant.advance(np.zeros(press_m.size), press_m, np.zeros(press_m.size))[:, 0]
    loading, unloading = volts[:701], volts[701:][::-1]
    assert np.max(np.abs(unloading - loading)) == pytest.approx(0.06 * 0.0694 * 7.0, rel=1e-6)
    force_n = press_m * settings.normal_n_m
    assert (force_n @ volts) / (force_n @ force_n) == pytest.approx(0.0694, rel=1e-3)


@pytest.mark.parametrize(
    "tracks", [([0.0], [0.0], [0.0, 0.0]), ([np.nan], [0.0], [0.0]), ([0.0], [np.inf], [0.0])]
)
def test_tracks_that_differ_in_length_or_are_not_finite_are_refused(tracks):
    plant = SlipPlant(bare())
    with pytest.raises(ValueError, match="one finite value for each sample"):
        plant.advance(*(np.array(track) for track in tracks))


def test_an_empty_span_changes_nothing():
    plant = SlipPlant(bare())
    assert plant.advance(np.empty(0), np.empty(0), np.empty(0)).shape == (0, 1)
    assert plant.t_s == 0.0
