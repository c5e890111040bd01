import math

import pytest

from benchmarks.centering import APART, OURS, Searches, eighty_five, gains_of, half_m, interval, made, score


def test_measured_gains_are_those_of_the_fingers_and_the_middle_is_found_better_with_them():
    right, left = gains_of(1.5)
    assert right == pytest.approx(10 ** (-0.75 / 20), rel=0.01)
    assert left == pytest.approx(10 ** (0.75 / 20), rel=0.01)
    apart = OURS.having(APART, 1.5)
    calibrated = apart.having("detectors.right_ours.gain", right).having("detectors.left_ours.gain", left)
    places = [{"object_x_m": x_m, "speed_m_s": 0.03} for x_m in (-0.009, 0.009)]
    plain, better = (made(Searches(way, places, 3)) for way in (apart, calibrated))
    for one, other in zip(plain, better, strict=True):
        assert abs(other["error_m"]) < 0.5 * abs(one["error_m"]) < 0.00125


def test_jaws_that_open_63_mm_leave_half_of_the_rest_to_either_side_of_a_pipe():
    assert half_m("pipe") == pytest.approx(0.5 * (0.063 - 0.01905))


def test_every_method_is_asked_for_the_same_85_places():
    first, again = (eighty_five(5, 2, 0.01) for _ in range(2))
    assert first == again
    places = [row["object_x_m"] for row in first]
    assert len(places) == 85
    assert set(places).isdisjoint(row["object_x_m"] for row in eighty_five(5, 3, 0.01))
    assert sum(x_m >= 0.006 for x_m in places) == sum(x_m <= -0.006 for x_m in places) == 29


def row(outcome, error_m=None, touched=0):
    about = {"object_x_m": 0.001, "left_m": 0.016, "right_m": -0.014, "search_s": 3.0}
    return {"outcome": outcome, "error_m": error_m, "touched": touched, **about}


def test_a_search_that_touched_is_counted_and_its_error_is_not():
    good = [row("centered", error_m) for error_m in (0.001, -0.003)]
    lost = [row("not_found"), row("false_contact")]
    found = score([[*good, row("touched", 0.0001, touched=1), *lost]])
    assert (found["searches"], found["centred"]) == (5, 2)
    assert (found["touched"], found["unseen"], found["stopped"]) == (1, 1, 1)
    assert [found[key] for key in ("worst_m", "mean_m", "median_m")] == pytest.approx([0.003, -0.001, 0.002])
    assert found["seen_m"] == pytest.approx(0.5 * (0.063 - 0.01905) - 0.015)
    assert found["worst_lo_m"] is None, "one repeat has no interval"


def test_the_interval_is_students():
    # t(0.975, 2 degrees of freedom) = 4.3027; sd 1, n = 3
    mean, low, high = interval([1.0, 2.0, 3.0])
    assert mean == 2.0
    assert (low, high) == pytest.approx((2.0 - 4.3027 / math.sqrt(3), 2.0 + 4.3027 / math.sqrt(3)), abs=1e-4)
