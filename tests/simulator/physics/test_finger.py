"""The finger plant as its users see it: the static facts of the paper, channels, truth, skipping, refusals."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.physics.finger import FingerPlant, FingerSettings
from tests.steady import energy_j

PERIOD = frozenset({"period"})
WAVES = frozenset({"accelerometer", "load_cell", "period"})
GAP_M = 0.003


def started(plant: FingerPlant, *, key=(1, 1), location="f", gap_m=GAP_M) -> FingerPlant:
    plant.begin(key=key, location=location, gap_m=gap_m)
    plant.excite(True)
    return plant


def pressed(plant: FingerPlant, depth_m: float, at_s: float = 6.0) -> FingerPlant:
    """The probe resting `depth_m` beyond the finger's surface at rest."""
    plant.advance(at_s)
    plant.move_probe([(at_s, 0.0, 0.01, 0.0), (at_s + (GAP_M + depth_m) / 0.01, GAP_M + depth_m, 0.0, 0.0)])
    plant.advance(at_s + 6.0)
    return plant


def measured(plant: FingerPlant, span_s: float = 4.0):
    """Frequencies, force and acceleration over a span from now on."""
    start_s = plant.t_s
    plant.advance(start_s + span_s, WAVES)
    times = start_s + np.arange(int(span_s * 1000)) / 1000
    return 1.0 / plant.periods()[1], plant.sample("load_cell", times), plant.sample("accelerometer", times)


@pytest.fixture(scope="module")
def plant():
    return FingerPlant(FingerSettings())


def test_a_free_finger_oscillates_at_28_hz_through_0_9_degrees(plant):
    started(plant).advance(10.0)
    frequencies, force, _ = measured(plant)
    assert np.mean(frequencies) == pytest.approx(28.0, abs=0.5)
    assert np.max(np.abs(force)) < 0.005
    swing = []
    for i in range(100):
        plant.advance(14.0 + i * 5e-4, PERIOD)
        present = plant.state()
        swing.append(present[0] - present[2])
    assert math.degrees(np.ptp(swing)) == pytest.approx(0.9, abs=0.05)


def test_light_contact_is_erratic_about_30_hz(plant):
    frequencies, force, _ = measured(pressed(started(plant), 0.001), 8.0)
    assert np.mean(frequencies) == pytest.approx(30.0, abs=2.0)
    assert np.std(frequencies) > 1.0
    assert 0.01 < np.mean(force) < 0.2
    assert np.mean(force > 0.005) < 0.5, "the probe should touch for a part of each oscillation"


def test_full_contact_oscillates_at_50_hz_and_never_lets_go(plant):
    frequencies, force, _ = measured(pressed(started(plant), 0.012))
    assert np.mean(frequencies) == pytest.approx(50.0, abs=3.0)
    assert np.min(force) > 0.005


def test_flexing_raises_the_free_frequency(plant):
    frequencies = []
    for tendon_m in (0.0, 0.005, 0.01):
        started(plant).set_tendon(tendon_m)
        plant.advance(10.0)
        frequencies.append(np.mean(measured(plant)[0]))
    assert frequencies[0] + 0.5 < frequencies[1] < frequencies[2] - 0.5


def test_contacts_show_when_force_began_and_ended(plant):
    started(plant).advance(6.0)
    plant.move_probe([(6.0, 0.0, 0.005, 0.0)])
    plant.advance(7.0, WAVES)
    made = plant.contacts()
    assert [touching for _, touching in made[:4]] == [True, False, True, False]
    times = np.arange(6.0, 7.0, 1e-4)
    force = plant.sample("load_cell", times)
    before, during = times < made[0][0], (times > made[0][0] + 2e-4) & (times < made[1][0] - 2e-4)
    assert np.max(force[before]) < 0.005
    assert np.all(force[during] > -0.005)
    assert np.max(force[during]) > 0.005


def test_periods_are_the_distances_of_the_edges(plant):
    started(plant).advance(5.0)
    plant.advance(6.0, PERIOD)
    edges, periods = plant.periods()
    assert np.diff(edges) == pytest.approx(periods[1:], abs=1e-14)
    assert plant.periods()[0].size == 0, "a period is returned once"
    plant.advance(6.5, PERIOD)
    assert plant.periods()[0][0] - plant.periods()[0].sum() == pytest.approx(edges[-1] + 1 / 28, abs=2e-3)


def test_an_unobserved_span_has_no_periods_but_the_first_observed_period_is_whole(plant):
    started(plant).advance(4.0)
    plant.advance(4.5, PERIOD)
    edges, periods = plant.periods()
    assert edges[0] > 4.0
    assert periods[0] == pytest.approx(1 / 28, rel=0.1)


def test_a_channel_that_was_not_observed_cannot_be_sampled(plant):
    started(plant).advance(1.0, PERIOD)
    with pytest.raises(ValueError, match="load_cell"):
        plant.sample("load_cell", np.array([0.5]))
    plant.advance(1.1, frozenset({"load_cell"}))
    with pytest.raises(ValueError, match="not observed"):
        plant.sample("load_cell", np.array([0.95]))
    assert plant.sample("load_cell", np.array([1.05])).shape == (1,)


def test_samples_of_the_span_before_are_still_there(plant):
    started(plant)
    times = np.arange(0.0, 0.2, 1e-3)
    for until_s in (0.1, 0.2):
        plant.advance(until_s, WAVES)
    both = plant.sample("accelerometer", times)
    started(plant).advance(0.2, WAVES)
    assert np.array_equal(plant.sample("accelerometer", times), both)


def test_the_load_cells_noise_is_far_below_the_onset_threshold():
    plant = started(FingerPlant(FingerSettings()))
    plant.advance(1.0, WAVES)
    noise = plant.sample("load_cell", np.arange(0.0, 1.0, 1e-3))
    assert 0.0 < np.std(noise) < 0.001
    assert np.max(np.abs(noise)) < 0.0025


def test_the_noise_scale_multiplies_every_noise():
    noises = []
    for scale in (1.0, 2.0):
        plant = FingerPlant(FingerSettings(noise_scale=scale))
        plant.begin(key=(3, 4), gap_m=GAP_M)
        plant.advance(1.0, WAVES)
        times = np.arange(0.0, 1.0, 1e-3)
        noises.append((plant.sample("load_cell", times), plant.sample("accelerometer", times)))
    assert noises[1][0] == pytest.approx(2.0 * noises[0][0], rel=1e-9)
    assert noises[1][1] == pytest.approx(2.0 * noises[0][1], rel=1e-9)


def test_the_accelerometers_noise_in_the_loop_has_the_data_sheets_density():
    plant = FingerPlant(FingerSettings(accelerometer_hz=5000.0))
    plant.begin(key=(5, 6), gap_m=GAP_M)
    plant.advance(20.0, WAVES)  # 160 lines of the spectrum near 28 Hz: their mean's root to 4 %
    wave = plant.sample("accelerometer", np.arange(0.0, 20.0, 1 / 1024))
    spectrum = np.abs(np.fft.rfft(wave)) ** 2 * 2 / (1024 * wave.size)
    band = np.fft.rfftfreq(wave.size, 1 / 1024)
    near = (band > 24.0) & (band < 32.0)
    assert math.sqrt(np.mean(spectrum[near])) == pytest.approx(300e-6 * 9.80665, rel=0.15)


def test_another_trial_has_another_noise_and_the_same_trial_the_same():
    plant = FingerPlant(FingerSettings())
    waves = []
    for key in ((1, 1), (1, 2), (1, 1)):
        started(plant, key=key).advance(1.0, WAVES)
        waves.append(plant.sample("accelerometer", np.arange(0.0, 1.0, 1e-2)))
    assert np.array_equal(waves[0], waves[2])
    assert not np.array_equal(waves[0], waves[1])


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40), seed=st.integers(0, 1000))
def test_cuts_change_no_bit(cuts, seed):
    plant = FingerPlant(FingerSettings())
    times = np.arange(0.0, 1.0, 1e-3)
    outcomes = []
    for ends in ([1.0], [*sorted(cuts), 1.0]):
        plant.begin(key=(seed, 1), gap_m=0.0005)
        plant.excite(True)
        plant.move_probe([(0.0, 0.0, 0.003, 0.0)])
        waves, start_s = [], 0.0
        for end_s in ends:
            plant.advance(end_s, WAVES)
            inside = times[(times >= start_s) & (times < end_s)]
            waves.append(plant.sample("load_cell", inside) + plant.sample("accelerometer", inside))
            start_s = end_s
        outcomes.append((np.concatenate(waves), plant.periods()[0], plant.contacts(), plant.theta_rad))
    assert np.array_equal(outcomes[0][0], outcomes[1][0])
    assert np.array_equal(outcomes[0][1], outcomes[1][1])
    assert outcomes[0][2:] == outcomes[1][2:]


@pytest.mark.parametrize("noise_scale", [0.0, 1.0])
def test_unobserved_cuts_change_no_bit_across_a_jump(noise_scale):
    plant = FingerPlant(FingerSettings(noise_scale=noise_scale))
    outcomes = []
    for ends in ([95.0], np.linspace(1.0, 95.0, 40)):
        started(plant)
        for end_s in ends:
            plant.advance(end_s)
            plant.contacts()
        plant.advance(96.0, PERIOD)
        outcomes.append((plant.periods()[0].tolist(), plant.theta_rad))
    assert outcomes[0] == outcomes[1]


def test_a_jump_without_noise_ends_where_the_whole_way_ends():
    phases = []
    for budget_rad in (0.0, 1e-6):
        plant = started(FingerPlant(FingerSettings(noise_scale=0.0, error_budget_rad=budget_rad)))
        plant.advance(200.0)
        plant.advance(200.1, PERIOD)
        phases.append((plant.periods()[0], plant.theta_rad))
        account = plant.account()
        assert (account["seconds"]["cycles"] > 150.0) == (budget_rad > 0.0)
        assert sum(account["seconds"].values()) == pytest.approx(200.1)
        assert account["error_bound_rad"] <= budget_rad
    assert phases[1][0] == pytest.approx(phases[0][0], abs=1e-6)
    assert phases[1][1] == pytest.approx(phases[0][1], abs=1e-6)


def test_a_jump_with_noise_enters_the_same_law():
    def moments(budget_rad):
        plant = FingerPlant(FingerSettings(error_budget_rad=budget_rad))
        means = []
        for trial in range(40):
            started(plant, key=(9, trial)).advance(20.0)
            plant.advance(22.0, PERIOD)
            means.append(np.mean(1.0 / plant.periods()[1]))
        return np.array(means), plant.account()["seconds"]["stationary"]

    whole, nothing = moments(0.0)
    jumped, skipped_s = moments(1e-6)
    assert nothing == 0.0 < skipped_s
    # the wander is the same, so that each trial's mean frequency is too, but for the phase
    assert jumped == pytest.approx(whole, abs=0.05)
    assert np.std(jumped) == pytest.approx(np.std(whole), rel=0.1)


def test_nothing_is_jumped_while_the_probe_could_touch():
    plant = started(FingerPlant(FingerSettings()), gap_m=0.0001)
    plant.advance(60.0)
    contacts = plant.contacts()
    assert contacts
    assert plant.account()["seconds"]["stationary"] == 0.0


def test_contacts_in_an_unobserved_span_are_reported(plant):
    started(plant).advance(5.0)
    plant.move_probe([(5.0, 0.0, 0.01, 0.0), (6.0, 0.01, -0.01, 0.0), (7.0, 0.0, 0.0, 0.0)])
    plant.advance(80.0)
    contacts = plant.contacts()
    assert contacts[0][1]
    assert not contacts[-1][1]
    assert 5.0 < contacts[0][0] < contacts[-1][0] < 7.0


def test_switching_the_excitation_off_lets_the_finger_come_to_rest():
    plant = started(FingerPlant(FingerSettings(noise_scale=0.0)))
    plant.advance(5.0)
    moving = energy_j(plant)
    plant.excite(False)
    plant.advance(35.0)
    assert energy_j(plant) < 1e-12 * moving


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda p: p.advance(math.nan), "until_s is not finite"),
        (lambda p: p.advance(math.inf), "until_s is not finite"),
        (lambda p: p.advance(-1.0), "runs forward"),
        (lambda p: p.advance(1.0, frozenset({"smell"})), "no channel smell"),
        (lambda p: p.begin(key=(0, 0), location="z", gap_m=0.001), "no location 'z'"),
        (lambda p: p.begin(key=(0, 0), gap_m=math.nan), "gap_m is not finite"),
        (lambda p: p.begin(key=(0, 0), gap_m=0.001, t_s=math.inf), "t_s is not finite"),
        (lambda p: p.begin(key=(-1, 0), gap_m=0.001), "keyed by"),
        (lambda p: p.set_tendon(math.inf), "position_m is not finite"),
        (lambda p: p.set_tendon(-1.0), "no stiffness"),
        (lambda p: p.move_probe([]), "needs a piece"),
        (lambda p: p.move_probe([(0.0, math.nan, 0.0, 0.0)]), "not finite"),
        (lambda p: p.move_probe([(1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)]), "order of time"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(call, match):
    plant = FingerPlant(FingerSettings())
    plant.begin(key=(0, 0), gap_m=GAP_M)
    with pytest.raises(ValueError, match=match):
        call(plant)
    plant.advance(0.1, WAVES)
    assert math.isfinite(plant.theta_rad)


@pytest.mark.parametrize("name", ["inertia_kg_m2", "pad_n_m", "contact_n_s_m", "drive_n_m", "noise_scale"])
@pytest.mark.parametrize("number", [math.nan, math.inf, -1.0])
def test_settings_that_are_not_finite_or_negative_are_refused_by_name(name, number):
    with pytest.raises(ValueError, match=name):
        FingerSettings(**{name: number})
