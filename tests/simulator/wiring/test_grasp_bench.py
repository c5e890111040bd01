"""A gripper that lifts what has a weight: what the pad, the arm and the truth make of it."""

import numpy as np
import pytest

from simulator.physics.pad_part import GraspBenchSettings, grasp_bench

ABOVE_M = 0.07
SUBSCRIBED = frozenset({"pad"})
WEIGHT_N = 0.2 * 9.80665
LIFT_M = 0.02


class Path:
    """A tool that stands over the object, goes down (8 to 9 s), and up (12 to 14 s)."""

    def place(self, t_s, position_m):
        pass

    def offsets(self, times_s):
        found = np.zeros((len(times_s), 6))
        found[:, 2] = np.interp(times_s, [8.0, 9.0, 12.0, 14.0], [ABOVE_M, 0.0, 0.0, LIFT_M])
        return found


def begun(**about):
    settings = GraspBenchSettings(lean_rad=0.0, **about)
    bench = grasp_bench(settings)
    bench.mount(Path())
    bench.restart()
    bench.begin(0.0, 5, 1, {}, settings.model_dump(mode="json"))
    bench.jaws.calibrate()
    bench.jaws.advance(5.0)
    bench.jaws.go(0.0, 40_000.0, 300.0)
    bench.jaws.advance(10.0)
    return bench


def gripped(current_ma=152.0, observe=SUBSCRIBED, **about):
    bench = begun(**about)
    bench.advance(10.0, observe)
    bench.jaws.go(1.0, 20_000.0, current_ma)
    bench.advance(11.9)
    return bench


def volts(bench, until_s, step_s=0.01):
    """What the pad shows from now on, as a board reads it."""
    parts, last = [], round(bench.t_s * 1000)
    for now in range(last, round(until_s * 1000) + 1, round(step_s * 1000)):
        bench.advance(now / 1000)
        parts.append(bench.sample("pad", np.arange(last + 1, now + 1) / 1000))
        last = now
    return np.concatenate(parts)


def weighed_n(bench):
    return -bench.wrench(np.array([bench.t_s]), (1.0, 0.0, 0.0))[0, 2]


def test_the_pad_feels_the_grip_and_then_half_of_the_weight():
    bench = gripped(pad_noise_scale=0.0)
    before = volts(bench, 11.99)[-1]
    assert before[1] / 0.0326 == pytest.approx(bench.jaws.contact_n, rel=0.05), "Fy, and its hysteresis"
    assert abs(before[2]) < 0.01
    assert weighed_n(bench) == 0.0
    lifted = volts(bench, 15.0)
    assert weighed_n(bench) == pytest.approx(WEIGHT_N)
    assert lifted[-1, 2] / 1.0291 == pytest.approx(0.5 * WEIGHT_N, rel=0.1), "Ft, and its hysteresis"
    assert bench.slips == []


def test_too_weak_a_grip_lets_the_object_slip_and_the_pad_senses_it():
    bench = gripped(pad_friction=0.1)
    quiet = volts(bench, 11.99)[:, 2]
    slipping = volts(bench, 14.0)[:, 2]
    (began_s, began), (_, ended) = bench.slips
    assert (began, ended) == (True, False)
    assert 12.0 < began_s < 12.2
    assert np.std(np.diff(slipping)) > 2.0 * np.std(np.diff(quiet))
    assert 0.0 < weighed_n(bench) < WEIGHT_N


def test_a_stronger_grip_holds_what_slips():
    bench = gripped(pad_friction=0.12)
    bench.advance(12.5)
    assert bench.slips
    bench.jaws.go(1.0, 20_000.0, 300.0)
    bench.advance(13.9)
    assert weighed_n(bench) == pytest.approx(WEIGHT_N)
    assert bench.slips[-1][0] < 13.0


def test_a_released_object_falls_back_on_the_table():
    bench = gripped(300.0)
    bench.advance(14.5)
    assert weighed_n(bench) == pytest.approx(WEIGHT_N)
    bench.jaws.go(0.0, 40_000.0, 300.0)
    bench.advance(16.0)
    assert weighed_n(bench) == 0.0
    bench.advance(16.5)
    assert bench.distances(np.array([16.5])).min() > 0.0


def test_neither_turns_nor_an_earlier_listener_change_what_the_pad_shows():
    fine, coarse = volts(gripped(), 13.0), volts(gripped(), 13.0, step_s=0.1)
    assert np.array_equal(fine, coarse)
    late = gripped(observe=frozenset())
    late.advance(11.91, SUBSCRIBED)
    samples = volts(late, 13.0)
    assert np.array_equal(samples, fine[-len(samples) :])


def test_the_truth_about_a_lift_does_not_depend_on_who_listens():
    heard, unheard = (gripped(observe=streams, pad_friction=0.1) for streams in (SUBSCRIBED, frozenset()))
    for bench in (heard, unheard):
        bench.advance(15.0)
    assert heard.slips == unheard.slips != []
    assert heard.lifts == unheard.lifts != []


def test_the_truth_knows_what_left_the_table_and_what_the_fingers_only_slid_on():
    lifted, slid = gripped(), gripped(pad_friction=0.05)
    for bench in (lifted, slid):
        bench.advance(15.0)
        assert bench.lifts[-1].t_s == pytest.approx(15.0)
        assert bench.lifts[-1].carried == pytest.approx(weighed_n(bench) / WEIGHT_N)
    assert lifted.lifts[-1].rise_m == pytest.approx(LIFT_M, abs=0.001), "but for what the pads give"
    assert slid.lifts[-1].rise_m == 0.0
