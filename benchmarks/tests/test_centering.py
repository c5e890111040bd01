import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.centering import (
    CenteringScene,
    Place,
    Searched,
    eighty_five,
    gains_of,
    interval,
    methods,
    score,
    search,
)
from config.script import run_trials
from controller.campaign import EXIT_DONE
from simulator.physics.aura import LEFT, RIGHT

SEED = 3


@pytest.fixture(scope="module")
def pipe():
    return methods("mock/centering")


def place(**about):
    return Place(**({"seed": 1, "number": 1, "object": "pipe", "object_x_m": 0.0, "speed_m_s": 0.03} | about))


ROWS = [
    {"object_x_m": 0.008, "speed_m_s": 0.03, "method": "ours"},
    {"object_x_m": -0.0105, "speed_m_s": 0.01, "method": "ours"},
    {"object_x_m": 0.0015, "speed_m_s": 0.03, "method": "paper"},
    {"object_x_m": -0.0072, "speed_m_s": 0.01, "method": "paper"},
]


def test_the_study_finds_the_middles_that_the_loop_finds(tmp_path, pipe):
    outcome, run = run_trials("mock/centering", ROWS, seed=SEED, out=tmp_path, say=lambda line: None)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    rests = {
        event["trial"]: event["t_s"]
        for event in run.events
        if (event["state"], event["next"]) == ("ENTERING", "BASELINE")
    }
    assert len(run.trials) == len(ROWS)
    for row in run.trials:
        where = Place(
            SEED, row["trial"], "pipe", row["object_x_m"], row["speed_m_s"], begin_s=rests[row["trial"]]
        )
        found = search(where, pipe[row["method"]])
        assert found.outcome == "found"
        # both fly the same plant and detectors; a last bit may put a decision off by one sample of the envelope
        assert found.error_m == pytest.approx(row["error_m"], abs=1e-3 * row["speed_m_s"]), row
        assert found.touches == row["touched"]


def test_fingers_a_decibel_and_a_half_apart_still_find_the_middle_and_calibrated_ones_better(pipe):
    ours = pipe["ours"]
    calibrated = replace(ours, gains=gains_of(1.5, ours))
    for x_m in (-0.009, 0.001, 0.009):
        where = place(object_x_m=x_m, mismatch_db=1.5)
        plain, better = (abs(search(where, method).error_m) for method in (ours, calibrated))
        assert plain < 0.0025
        assert better < 0.5 * plain


def test_a_second_search_after_half_a_turn_takes_away_what_fingers_differ_by_and_costs_its_time(pipe):
    ours = pipe["ours"]
    turned = replace(ours, turned=True)
    for x_m in (-0.009, 0.009):
        once, twice = (search(place(object_x_m=x_m, mismatch_db=1.5), way) for way in (ours, turned))
        assert (once.outcome, twice.outcome) == ("found", "found")
        assert abs(twice.error_m) < 0.0002
        assert abs(once.error_m) > 0.0005
        assert twice.search_s > 2.0 * once.search_s


def test_measured_gains_are_those_of_the_fingers(pipe):
    right, left = gains_of(1.5, pipe["ours"])
    assert right == pytest.approx(10 ** (-0.75 / 20), rel=0.01)
    assert left == pytest.approx(10 ** (0.75 / 20), rel=0.01)


def test_a_finger_pushes_the_pipe_along_and_that_is_a_touch():
    bench = CenteringScene(place(speed_m_s=0.01))
    room_m = bench.gap_m(LEFT, 0.0)
    assert room_m == pytest.approx(0.5 * (0.063 - 0.01905)), "jaws open 63 mm, a pipe of 19.05"
    bench.arm.move_at(0.0, 0.03, room_m + 0.002)
    bench.receive(1, 2000)
    assert bench.touches == 1
    assert bench.object_x_m == pytest.approx(0.002)
    assert bench.gap_m(RIGHT, room_m + 0.002) == pytest.approx(2 * room_m)


def test_a_predicted_span_has_not_happened():
    bench, other = CenteringScene(place()), CenteringScene(place())
    for one in (bench, other):
        one.arm.move_at(0.0, 0.03, 0.03)
    seen, _, clear = bench.foresee(1, 1500)
    assert not clear
    assert (bench.touches, bench.object_x_m) == (0, 0.0)
    received, _ = bench.receive(1, 1500)
    np.testing.assert_array_equal(seen, received)
    np.testing.assert_array_equal(received, other.receive(1, 1500)[0])
    assert bench.touches == 1


def test_every_method_is_asked_for_the_same_85_places():
    first, again = (eighty_five(5, 2, 0.01) for _ in range(2))
    assert first == again
    assert len(first) == 85
    assert {one.object_x_m for one in first}.isdisjoint(one.object_x_m for one in eighty_five(5, 3, 0.01))
    assert (
        sum(one.object_x_m >= 0.006 for one in first) == sum(one.object_x_m <= -0.006 for one in first) == 29
    )


def test_a_search_that_touched_is_counted_and_its_error_is_not():
    good = [Searched("found", error_m) for error_m in (0.001, -0.003)]
    pushed = Searched("found", 0.0001, touches=1)
    lost = [Searched("unseen"), Searched("contact")]
    found = score([[*good, pushed, *lost]])
    assert (found["searches"], found["centred"]) == (5, 2)
    assert (found["touched"], found["unseen"], found["stopped"]) == (1, 1, 1)
    assert [found[key] for key in ("worst_m", "mean_m", "median_m")] == pytest.approx([0.003, -0.001, 0.002])
    assert found["worst_lo_m"] is None, "one repeat has no interval"


def test_the_interval_is_students():
    # t(0.975, 2 degrees of freedom) = 4.3027; sd 1, n = 3
    mean, low, high = interval([1.0, 2.0, 3.0])
    assert mean == 2.0
    assert (low, high) == pytest.approx((2.0 - 4.3027 / math.sqrt(3), 2.0 + 4.3027 / math.sqrt(3)), abs=1e-4)
