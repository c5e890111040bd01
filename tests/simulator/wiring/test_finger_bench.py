"""A trial that begins with the probe inside the finger, as an earlier run left it."""

import numpy as np
import pytest

from simulator.physics.finger_part import FingerBenchSettings, finger_bench
from simulator.physics.stage_axis import StageAxis

PLANT = FingerBenchSettings(noise_scale=0.0)
CELL = frozenset({"load_cell"})
PLACES_M = (0.0035, 0.008, 0.0155)


def begun(position_m):
    bench = finger_bench(PLANT)
    axis = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.026, position_m=position_m)
    bench.mount(axis)
    bench.begin(0.0, 1, 1, {"location": "f"}, PLANT.model_dump(mode="json"))
    return bench, axis


def forces_n(bench, until_s):
    from_s = bench.t_s
    bench.advance(until_s, CELL)
    return bench.sample("load_cell", np.arange(from_s + 0.001, until_s, 0.001))


@pytest.mark.parametrize("position_m", PLACES_M)
def test_the_finger_rests_against_the_probe_with_the_force_of_one_that_went_there_slowly(position_m):
    there, _ = begun(position_m)
    rests_n = forces_n(there, 0.5)
    assert np.ptp(rests_n) < 1e-9, "nothing moves"
    went, axis = begun(0.0)
    axis.move_to(0.0, position_m, 0.002)
    went.on_plan(0.0)
    went.advance(40.0, CELL)
    assert rests_n[-1] == pytest.approx(went.force_n, rel=1e-3)
    assert there.contacts == [(0.0, True)]


def test_contact_ends_where_the_probe_goes_back():
    bench, axis = begun(0.0155)
    pressed_n = forces_n(bench, 0.1)[-1]
    axis.move_to(0.1, 0.0, 0.002)
    bench.on_plan(0.1)
    assert forces_n(bench, 9.0).max() < 1.2 * pressed_n
    assert bench.force_n == 0.0
    assert [made for _, made in bench.contacts[:2]] == [True, False]


def test_a_probe_that_does_not_reach_the_finger_leaves_it_alone():
    bench, _ = begun(PLANT.surface_m)
    assert forces_n(bench, 0.1).max() == 0.0
    assert bench.contacts == []


def test_the_account_is_of_all_trials_whatever_settings_they_vary():
    bench, _ = begun(0.0)
    bench.advance(1.0, CELL)
    bench.begin(1.0, 1, 2, {"location": "f"}, {"noise_scale": 0.5})
    bench.advance(3.0, CELL)
    assert sum(bench.account()["seconds"].values()) == pytest.approx(3.0)


def test_an_arm_that_reads_the_force_in_a_moment_that_a_force_sensor_did_not_hear_gets_the_present_one():
    bench, _ = begun(0.008)
    towards = (0.0, 0.0, -1.0)

    def now_n():
        return bench.wrench(np.array([bench.t_s]), towards)[0, 2]

    assert now_n() == pytest.approx(bench.force_n), "nobody else reads it"
    bench.advance(0.1, frozenset())
    bench.feel(True)  # another device begins to, between two advances
    assert now_n() == pytest.approx(bench.force_n)
    bench.advance(0.2, frozenset())
    assert now_n() == pytest.approx(bench.force_n)
    bench.begin(0.2, 1, 2, {"location": "f"}, PLANT.model_dump(mode="json"))
    assert now_n() == pytest.approx(bench.force_n)
