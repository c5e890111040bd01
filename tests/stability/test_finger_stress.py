"""Where solvers of contact break: grazing, chatter, no damping, a loop far from its lock, converters at their end."""

import math
import tracemalloc

import numpy as np
import pytest

from simulator.physics.finger import FingerPlant, FingerSettings
from tests.stability.finger_oracles import modal
from tests.steady import energy_j

QUIET = {"noise_scale": 0.0}
SWITCHES = frozenset({"switches"})
PERIOD = frozenset({"period"})


def begun(s: FingerSettings, gap_m: float) -> FingerPlant:
    plant = FingerPlant(s)
    plant.begin(key=(0, 0), gap_m=gap_m)
    return plant


def touches(gap_m: float, until_s: float) -> list[tuple[float, bool]]:
    """Contacts of the excited finger with a probe that rests `gap_m` away."""
    plant = begun(FingerSettings(**QUIET), gap_m)
    plant.excite(True)
    plant.advance(until_s, SWITCHES)
    return plant.contacts()


def test_a_graze_is_seen_to_the_last_bit_of_its_depth():
    # the gap at which the finger's first swing just reaches the probe, by bisection on the plant ...
    low_m, high_m, until_s = 0.0, 1e-3, 0.022
    while high_m - low_m > 2e-19 and low_m < 0.5 * (low_m + high_m) < high_m:
        middle_m = 0.5 * (low_m + high_m)
        if touches(middle_m, until_s):
            low_m = middle_m
        else:
            high_m = middle_m
    # ... against the extremum of theta in 40 digits, which is flat: an instant 1e-9 s off costs 1e-20 m
    turn_s = touches(low_m, until_s)[0][0]
    scene = {"pieces": [(0.0, 0.0, 0.0, 0.0)], "gap_m": 1.0, "until_s": until_s, "samples_s": [turn_s]}
    _, (theta_rad,) = modal(FingerSettings(**QUIET), **scene)
    # bound: theta of 1e-3 rad is known to 1e-19, times the arm, and its square root enters through the instant
    assert low_m == pytest.approx(-theta_rad * 0.05, abs=1e-18)


def test_chatter_with_ever_shorter_flights_ends_in_contact():
    # a finger that is let fall against a hard, hardly damped stop: each flight is shorter than the one before, until
    # the static force outweighs what is left; 1e3 is far above the 1e2 or so flights that this damping allows
    s = FingerSettings(**QUIET, pad_n_m=1e7, contact_n_s_m=20.0)
    plant = begun(s, 0.0)
    plant.move_probe([(0.0, 0.0, 0.05, 0.0), (0.02, 0.001, 0.0, 0.0)])
    plant.advance(30.0, SWITCHES)
    contacts = plant.contacts()
    assert 5 < len(contacts) < 1000
    assert contacts[-1][1], "it should end in contact"
    late = [t for t, _ in contacts]
    assert late[-1] < 5.0
    compliance = s.arm_f_m**2 * (1 / s.joint_n_m_rad + 1 / s.base_n_m_rad) + 1 / s.pad_n_m
    assert plant.force_n == pytest.approx(0.001 / compliance, rel=1e-6)


def test_an_undamped_stop_is_left_with_the_energy_it_was_met_with():
    # no damper anywhere: the probe rests, so that link and mounting keep their energy over hundreds of contacts
    s = FingerSettings(**QUIET, joint_n_m_s_rad=0.0, base_n_m_s_rad=0.0, contact_n_s_m=0.0)
    plant = begun(s, 0.0005)
    plant.excite(True)
    plant.advance(0.25)
    plant.excite(False)
    energies, contacts = [], 0
    for i in range(400):
        plant.advance(0.25 + (i + 1) * 0.05)
        contacts += len(plant.contacts())
        if plant.force_n == 0.0:
            energies.append(energy_j(plant))
    assert contacts > 200
    # rounding of 1e-16 a piece, about 5e3 pieces
    assert np.ptp(energies) < 1e-12 * energies[0]


def test_no_damping_keeps_the_energy_over_ten_thousand_cycles():
    # a shorter twin of 1e6 cycles in `make bench`: rounding walks, so that its root allows ten times more there
    s = FingerSettings(**QUIET, joint_n_m_s_rad=0.0, base_n_m_s_rad=0.0)
    plant = begun(s, 1.0)
    plant.excite(True)
    plant.advance(0.25)
    plant.excite(False)
    plant.advance(0.5)
    before_j = energy_j(plant)
    plant.advance(0.5 + 10_000 / 28.0)
    assert energy_j(plant) == pytest.approx(before_j, rel=1e-12)


@pytest.mark.parametrize(("lowest_hz", "range_hz"), [(10.0, 70.0), (4.0, 90.0), (20.0, 30.0)])
def test_the_loop_locks_from_far_off(lowest_hz, range_hz):
    oscillator = {"oscillator_lowest_hz": lowest_hz, "oscillator_range_hz": range_hz}
    plant = begun(FingerSettings(**QUIET, **oscillator), 0.003)
    plant.advance(1.0, PERIOD)
    idle_hz = 1.0 / plant.periods()[1][-1]
    assert idle_hz == pytest.approx(lowest_hz + range_hz / 2, rel=0.02), "idle, it is in the middle"
    plant.excite(True)
    plant.advance(12.0)
    plant.advance(13.0, PERIOD)
    frequencies = 1.0 / plant.periods()[1]
    assert np.ptp(frequencies) < 0.01
    # an XOR locks within a quarter of a period of resonance, which is 27 Hz here: off it, but on its flank
    assert 24.0 < frequencies[-1] < 33.0


def test_a_signal_below_the_hysteresis_loses_the_lock_and_nothing_else():
    plant = begun(FingerSettings(**QUIET, hysteresis_m_s2=50.0), 0.003)
    plant.excite(True)
    plant.advance(60.0)
    plant.advance(61.0, PERIOD | SWITCHES)
    assert not any("comparator" in kind for _, kind in plant.switches())
    assert np.mean(1.0 / plant.periods()[1]) == pytest.approx(45.0, rel=0.01)
    assert math.isfinite(plant.theta_rad)


def test_the_lock_comes_back_after_full_contact():
    plant = begun(FingerSettings(**QUIET), 0.003)
    plant.excite(True)
    there = [(0.0, 0.0, 0.0, 0.0), (4.0, 0.0, 0.02, 0.0), (4.75, 0.015, 0.0, 0.0)]
    plant.move_probe([*there, (8.0, 0.015, -0.02, 0.0)])
    plant.advance(7.0)
    plant.advance(8.0, PERIOD)
    pressed_hz = np.mean(1.0 / plant.periods()[1])
    plant.advance(20.0)
    plant.advance(21.0, PERIOD)
    assert pressed_hz == pytest.approx(50.0, abs=3.0)
    assert np.mean(1.0 / plant.periods()[1]) == pytest.approx(28.0, abs=0.5)


def test_the_load_cell_ends_at_its_range_and_a_saturated_converter_leaves_the_loop_alone():
    plant = begun(FingerSettings(**QUIET, load_cell_range_n=0.1), 0.0)
    plant.move_probe([(0.0, 0.0, 0.01, 0.0), (1.0, 0.01, 0.0, 0.0)])
    plant.advance(3.0, frozenset({"load_cell"}))
    assert plant.sample("load_cell", np.array([2.9]))[0] == 0.1
    periods, waves = [], []
    times = np.arange(2.0, 3.0, 1e-3)
    for range_m_s2 in (30.0, 0.5):
        plant = begun(FingerSettings(**QUIET, accelerometer_range_m_s2=range_m_s2), 0.003)
        plant.excite(True)
        plant.advance(2.0)
        plant.advance(3.0, PERIOD | {"accelerometer"})
        waves.append(plant.sample("accelerometer", times))
        periods.append(plant.periods()[1])
    assert np.max(np.abs(waves[0])) > 1.0
    assert np.max(waves[1]) == 0.5 == -np.min(waves[1])
    assert np.array_equal(np.clip(waves[0], -0.5, 0.5), waves[1])
    assert np.array_equal(*periods), "the comparator sees the sign, which no converter removes"


def test_a_contact_beyond_all_means_ends_with_a_clear_error(monkeypatch):
    monkeypatch.setattr("simulator.physics.finger_course.MOST_PIECES", 10_000)
    # more than a profile may ask for
    settings = FingerSettings(**QUIET).model_copy(update={"contact_n_s_m": 1e9})
    plant = begun(settings, 0.0)
    plant.move_probe([(0.0, 0.0, 0.01, 0.0)])
    with pytest.raises(RuntimeError, match="too damped"):
        plant.advance(0.1, SWITCHES)


def test_an_unaffordable_damping_is_refused_with_its_cost():
    assert FingerSettings(contact_n_s_m=1e6).contact_n_s_m == 1e6
    with pytest.raises(ValueError, match=r"contact_n_s_m = 1e\+09: .* 8.8e\+03 s of computing"):
        FingerSettings(contact_n_s_m=1e9)
    for name, value in (("joint_n_m_s_rad", 1e6), ("base_n_m_s_rad", 1e6), ("high_pass_quality", 1e-310)):
        with pytest.raises(ValueError, match=rf"{name} = .* that is free would cost .* s of computing"):
            FingerSettings(**{name: value})


def test_memory_does_not_grow_with_virtual_time():
    plant = FingerPlant(FingerSettings())
    plant.begin(key=(0, 0), gap_m=0.001)
    plant.excite(True)
    observe = PERIOD | {"load_cell"}

    def minute(start_s: float) -> None:
        for i in range(60):
            plant.advance(start_s + i + 1, observe)
            plant.sample("load_cell", np.arange(start_s + i, start_s + i + 1, 1e-2))
            plant.periods()
            plant.contacts()

    minute(0.0)
    tracemalloc.start()
    minute(60.0)
    first = tracemalloc.get_traced_memory()[0]
    for k in range(2, 6):
        minute(60.0 * k)
    grown = tracemalloc.get_traced_memory()[0] - first
    tracemalloc.stop()
    # four minutes of edges alone, kept as floats in lists, would be 400 kB; buffers may still find their size
    assert grown < 200_000
