"""From steps to gain, hysteresis and resolution, on series whose answer is known by hand."""

import math

import numpy as np
import pytest

from behaviors.weights import WeightsSettings
from controller.measures import weights
from controller.measures.bridge_calibration import DETECTED_SIGMA, Step, calibrate, steps_of
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock

LOADS_N = [1.0, 2.0, 3.0, 4.0]
GAIN_V_N, WIDTH, TOP_N = 0.05, 0.06, 4.0


def volts(load_n, going, zero_v=0.0):
    """A loop of the given width in its middle, closed at the top and symmetric about the line."""
    open_ = {1.0: 0.5, 2.0: 1.0, 3.0: 0.5}.get(load_n, 0.0) * WIDTH * GAIN_V_N * TOP_N / 2.0
    return zero_v + GAIN_V_N * load_n + (open_ if going == "down" else -open_ if going == "up" else 0.0)


def loop(cycle, zero_v=0.0, sd_v=0.001, samples=100, wander=0.0):
    """One cycle up and down."""
    there = [(load_n, "up") for load_n in LOADS_N] + [(load_n, "down") for load_n in LOADS_N[-2::-1]]
    at_v = [volts(n, going, zero_v) * (1.0 + wander) for n, going in there]
    return [Step(*leg, cycle, mean_v, sd_v, samples) for leg, mean_v in zip(there, at_v, strict=True)]


def trial(cycles=3, zero_v=0.0, **how):
    zero = Step(0.0, "zero", -1, zero_v, 0.001, 100)
    return [zero, *(step for cycle in range(cycles) for step in loop(cycle, zero_v, **how))]


def test_the_gain_is_the_slope_through_zero_of_a_symmetric_loop_with_students_interval():
    found = calibrate(trial(), 0.0)
    # by hand: up and down cancel but at the top, which is in the list once
    assert found["gain_v_n"] == pytest.approx(GAIN_V_N, rel=1e-12)
    assert found["gain_low_v_n"] <= GAIN_V_N <= found["gain_high_v_n"]
    assert found["loads"] == 21
    found = calibrate(trial(), 0.0)
    residual_v = WIDTH * GAIN_V_N * TOP_N / 2.0
    squares = 2.0 * (2.0 * (0.5 * residual_v) ** 2 + residual_v**2)
    loads = 2.0 * (1.0 + 4.0 + 9.0) + 16.0
    half = 2.446912 * math.sqrt(squares / 6.0 / loads)  # t(0.975, 6) from a printed table
    assert found["gain_high_v_n"] - found["gain_v_n"] == pytest.approx(half, rel=1e-6)
    few, many = calibrate(trial(2), 0.0), calibrate(trial(50), 0.0)
    assert many["gain_high_v_n"] == pytest.approx(few["gain_high_v_n"])


def test_hysteresis_is_the_largest_difference_over_the_output_at_the_top():
    for cycles, held in ((3, True), (1, False)):
        found = calibrate(trial(cycles), 0.0)
        assert found["hysteresis"] == pytest.approx(WIDTH, rel=1e-9)
        known = found["hysteresis_low"] <= WIDTH <= found["hysteresis_high"]
        assert known == held, "one cycle gives no interval"
    assert math.isnan(found["hysteresis_low"])


def test_an_empty_bridge_that_is_not_at_zero_is_taken_off_and_preloads_count_for_nothing():
    found = calibrate(trial(zero_v=0.7), 0.0)
    assert found["gain_v_n"] == pytest.approx(GAIN_V_N)
    assert found["zero_v"] == 0.7
    zero, *cycles = trial()
    preload = [Step(4.0, "up", -1, 9.9, 0.5, 100), Step(0.0, "zero", -1, 7.7, 0.5, 100)]
    loaded, plain = (calibrate(steps, 0.0) for steps in ([zero, *preload, *cycles], [zero, *cycles]))
    assert repr(loaded) == repr(plain), "NaN is equal to NaN"


def test_what_is_left_after_a_cycle_is_the_remanence_and_cycles_that_differ_show_in_repeatability():
    left_v = 0.02 * GAIN_V_N * TOP_N
    steps = [*trial(1), Step(0.0, "zero", 0, left_v, 0.001, 100)]
    found = calibrate(steps, 0.0)
    assert found["remanence"] == pytest.approx(0.02)
    assert found["gain_v_n"] == calibrate(trial(1), 0.0)["gain_v_n"]
    assert math.isnan(calibrate(trial(1), 0.0)["remanence"])
    steps = [*trial(1), *loop(1, wander=0.01), *loop(2, wander=-0.01)]
    found = calibrate(steps, 0.0)
    assert found["gain_repeat_v_n"] == pytest.approx(0.01 * GAIN_V_N, rel=1e-6)
    assert found["hysteresis_high"] - found["hysteresis_low"] > 0.0


def test_the_resolution_is_a_multiple_of_one_samples_noise_and_the_weights_own_widens_every_interval():
    found = calibrate(trial(sd_v=0.002), 0.0)
    assert found["resolution_n"] == pytest.approx(DETECTED_SIGMA * 0.002 / GAIN_V_N)
    # 21 x 99 degrees of freedom: no narrower than a standard deviation's own interval, 1.96 / sqrt(2 x 2079)
    assert found["resolution_high_n"] / found["resolution_n"] - 1.0 > 1.96 / math.sqrt(2.0 * 2079.0) * 0.99
    sure, unsure = calibrate(trial(), 0.0), calibrate(trial(), 0.02)
    fit, wider = (each["gain_high_v_n"] - each["gain_v_n"] for each in (sure, unsure))
    assert wider == pytest.approx(math.hypot(fit, 1.959964 * 0.02 * GAIN_V_N))
    assert unsure["resolution_high_n"] > sure["resolution_high_n"]
    assert unsure["hysteresis_low"] < sure["hysteresis_low"]


def test_the_intervals_hold_the_truth_as_often_as_stated():
    """200 series of a straight bridge with noise: 95 % of the gains' intervals, to three standard deviations."""
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(200):
        steps = [Step(0.0, "zero", -1, 0.0, 0.001, 100)]
        for load_n, going in [(n, "up") for n in LOADS_N] + [(n, "down") for n in LOADS_N[-2::-1]]:
            steps.append(Step(load_n, going, 0, GAIN_V_N * load_n + 0.003 * rng.normal(), 0.001, 100))
        found = calibrate(steps, 0.0)
        held += found["gain_low_v_n"] <= GAIN_V_N <= found["gain_high_v_n"]
    assert abs(held / 200 - 0.95) <= 3.0 * math.sqrt(0.95 * 0.05 / 200)


def test_what_is_no_ladder_calibrates_nothing():
    assert calibrate([], 0.0) == {}
    zero = Step(0.0, "zero", -1, 0.0, 0.001, 9)
    assert calibrate([zero, Step(1.0, "up", 0, 0.05, 0.001, 9)], 0.0) == {}
    dead = [zero._replace(sd_v=0.0), *(Step(n, "up", 0, 0.0, 0.0, 9) for n in (1.0, 2.0))]
    assert calibrate(dead, 0.0) == {}


# --- from a recording to steps -----------------------------------------------------------------------


def recorded(loads, samples=50, short=()):
    """A recording: each load hangs for a second, and is recorded in the second half of it; column 1 is Fy."""
    recording = TrialRecording(1)
    seq = 0
    for place, load_n in enumerate(loads):
        row = np.array([[0.0, load_n, 0.0]])
        t_s = float(place)
        recording.add(SampleBlock("operator.load", place, t_s, row, times_s=np.array([t_s])))
        n = 1 if place in short else samples
        values = np.tile([9.0, GAIN_V_N * load_n, 9.0], (n, 1))
        recording.add(SampleBlock("board.fingertip", seq, place + 0.5, values, rate_hz=1000.0))
        seq += 500
    return recording


def steps(loads, preloads=1, **how):
    streams = {"load_stream": "operator.load", "bridges_stream": "board.fingertip"}
    return steps_of(recorded(loads, **how), **streams, bridge="y", preloads=preloads)


def test_loads_are_distinguished_by_direction_and_cycle():
    found = steps([0.0, 2.0, 0.0, 1.0, 2.0, 1.0, 0.0, 1.0, 2.0, 1.0])
    cycles = [[(1.0, "up", n), (2.0, "up", n), (1.0, "down", n)] for n in (0, 1)]
    preload = [(0.0, "zero", -2), (2.0, "up", -1), (0.0, "zero", -1)]
    expected = [*preload, *cycles[0], (0.0, "zero", 0), *cycles[1]]
    assert [(step.load_n, step.going, step.cycle) for step in found] == expected
    assert [step.mean_v for step in found] == pytest.approx([GAIN_V_N * step.load_n for step in found])
    assert {step.samples for step in found} == {50}


def test_a_load_that_was_asked_for_again_after_a_pause_counts_once_and_an_empty_recording_has_no_steps():
    whole = steps([0.0, 1.0, 2.0, 1.0, 0.0], preloads=0)
    broken = steps([0.0, 1.0, 2.0, 2.0, 1.0, 0.0], preloads=0)
    assert [step[:3] for step in broken] == [step[:3] for step in whole]
    unrecorded = steps([0.0, 0.0, 1.0, 2.0, 1.0, 0.0], preloads=0, short=(0,))
    assert [step[:3] for step in unrecorded] == [step[:3] for step in whole]
    empty = TrialRecording(1)
    assert steps_of(empty, load_stream="a", bridges_stream="b", bridge="x", preloads=0) == []


@pytest.mark.parametrize(("gain_v_n", "judged"), [(0.0, "not_calibrated"), (-GAIN_V_N, "calibrated")])
def test_a_bridge_that_does_not_show_the_weights_is_not_calibrated(gain_v_n, judged):
    settings = WeightsSettings(weights_x_n=(1.0, 2.0, 4.0), preloads=1, cycles=2)
    loads_n = settings.loads_n("x")
    rng, recording, visits = np.random.default_rng(2), TrialRecording(1), []
    for turn, load_n in enumerate(loads_n):
        bridges_v = rng.normal([gain_v_n * load_n, 0.0, 0.0], 1e-3, (500, 3))
        recording.add(SampleBlock("board.fingertip", 1000 * turn, float(turn), bridges_v, rate_hz=1000.0))
        visits += [("RECORDING", float(turn)), ("HANGING", turn + 0.5)]
    hung = np.array([[load_n, 0.0, 0.0] for load_n in loads_n])
    recording.add(SampleBlock("operator.load", 0, 0.0, hung, times_s=np.arange(len(loads_n)) - 0.1))
    outcome, row = weights.measure(
        TrialEvidence({"bridge": "x"}, recording, visits=visits), settings, "calibrated"
    )
    assert outcome == judged
    assert row["gain_v_n"] == (None if gain_v_n == 0.0 else pytest.approx(gain_v_n, rel=0.01))
