"""Touches out of a recording whose angles are known by hand, and what their errors amount to."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controller.measures.pointer import Touch, errors_of, touches_of, turned_rad
from controller.measures.trial import spans_of
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock

DOWN = Rotation.from_rotvec([0.0, 3.1416, 0.0])
"""The start pose: the tool looks down. Its rotation vector is as long as half a turn, where the sign jumps."""


def posed(angle_rad, n=10, jitter=0.0):
    """Poses turned about base y: x, y, z and the rotation vector, shape (n, 6)."""
    turns = [Rotation.from_rotvec([jitter * (-1) ** i, angle_rad, 0.0]) * DOWN for i in range(n)]
    return np.array([[0.4, -0.1, 0.25, *turn.as_rotvec()] for turn in turns])


def recorded(angles, errors, force_n=3.0, jitter=0.0):
    """A recording of touches of a second each, after a second at the start pose; with the visits."""
    recording, visits = TrialRecording(1), [("HOMING", 0.0), ("ZEROING", 1.0)]
    recording.add(SampleBlock("arm.pose", 0, 1.0, posed(0.0, jitter=jitter), rate_hz=500.0))
    t_s = 2.0
    for angle_rad, error_rad in zip(angles, errors, strict=True):
        visits += [("DESCENDING", t_s), ("RECORDING", t_s + 0.5), ("LIFTING", t_s + 0.9)]
        measured = angle_rad + error_rad
        forces = np.tile([force_n * math.sin(measured), force_n * math.cos(measured), 0.1], (50, 1))
        # Recorded during the descent as well, before it touches: not part of the touch.
        recording.add(SampleBlock("signals.tip", int(t_s * 1000), t_s, np.full((50, 3), 9.0), rate_hz=1000.0))
        recording.add(SampleBlock("signals.tip", int(t_s * 1000) + 600, t_s + 0.6, forces, rate_hz=1000.0))
        recording.add(
            SampleBlock("arm.pose", int(t_s * 500), t_s + 0.6, posed(angle_rad, jitter=jitter), rate_hz=500.0)
        )
        t_s += 1.0
    return recording, visits


def touches(angles, errors, *, broken_s=(), **how):
    recording, visits = recorded(angles, errors, **how)
    return touches_of(
        recording,
        visits,
        forces_stream="signals.tip",
        pose_stream="arm.pose",
        angles=len(angles) // 2,
        broken_s=broken_s,
    )


ANGLES = [-1.5, 0.0, 1.5, 1.5, 0.0, -1.5]
ERRORS = [0.01, 0.02, -0.03, 0.01, 0.04, -0.02]


@pytest.mark.parametrize("jitter", [0.0, 1e-4])
def test_true_and_measured_angles_are_those_of_arm_and_forces(jitter):
    found = touches(ANGLES, ERRORS, jitter=jitter)
    assert [touch.true_rad for touch in found] == pytest.approx(ANGLES, abs=1e-6)
    assert [touch.error_rad for touch in found] == pytest.approx(ERRORS, abs=1e-6)
    assert [touch.force_n for touch in found] == pytest.approx([3.0] * 6)
    assert [touch.going for touch in found] == ["up"] * 3 + ["down"] * 3


def test_a_touch_that_a_pause_broke_off_does_not_count():
    whole = touches(ANGLES, ERRORS)
    with_broken = touches([-1.5, *ANGLES], [0.5, *ERRORS], broken_s={2.9})
    assert with_broken == [
        touch._replace(going=other.going) for touch, other in zip(whole, with_broken, strict=True)
    ]


def test_errors_are_taken_between_half_a_turn_either_way():
    touch = Touch(true_rad=-1.57, measured_rad=1.57 + math.pi, spread_rad=0.0, force_n=1.0, going="up")
    assert touch.error_rad == pytest.approx(3.14 + math.pi - 2.0 * math.pi)


def test_the_errors_over_all_touches_are_their_mean_spread_and_largest():
    errors = errors_of(touches(ANGLES, ERRORS))
    assert errors.bias == pytest.approx(np.mean(ERRORS), abs=1e-6)
    assert errors.sd == pytest.approx(np.std(ERRORS, ddof=1), abs=1e-6)
    assert errors.rms == pytest.approx(math.sqrt(np.mean(np.square(ERRORS))), abs=1e-6)
    assert errors.largest == pytest.approx(0.04, abs=1e-6)
    assert errors.hysteresis == pytest.approx(0.04, abs=1e-6), (
        "up 0.01 at -1.5 rad, up -0.03 and down 0.01 at 1.5 rad"
    )


def test_a_sweep_that_was_not_finished_has_errors_and_no_hysteresis():
    recording, visits = recorded(ANGLES, ERRORS)
    found = touches_of(recording, visits[:-6], forces_stream="signals.tip", pose_stream="arm.pose", angles=3)
    assert len(found) == 4
    errors = errors_of(found)
    assert errors.bias == pytest.approx(np.mean(ERRORS[:4]), abs=1e-6)
    assert math.isnan(errors.hysteresis)


def test_without_a_start_pose_nothing_is_true():
    recording, visits = recorded(ANGLES, ERRORS)
    assert (
        touches_of(recording, visits[2:], forces_stream="signals.tip", pose_stream="arm.pose", angles=3) == []
    )
    assert math.isnan(errors_of([]).bias)


def test_a_turn_counts_about_base_y():
    start = DOWN.as_rotvec()
    now = (Rotation.from_rotvec([0.0, 0.7, 0.0]) * DOWN).as_rotvec()
    assert turned_rad(start, now) == pytest.approx(0.7)
    assert turned_rad(now, start) == pytest.approx(-0.7)


def test_a_pose_whose_rotation_vector_jumps_between_both_signs_of_half_a_turn_has_a_mean_all_the_same():
    """Half a turn one way is half a turn the other way: a controller reports either."""
    recording, visits = recorded(ANGLES, ERRORS)
    jumping = np.array([[0.0] * 3 + [0.0, sign * (math.pi - 1e-4), 0.0] for sign in (1.0, -1.0, 1.0, -1.0)])
    other = TrialRecording(1)
    for stream in recording.streams:
        for block in recording.blocks(stream):
            if not (stream == "arm.pose" and block.t0_s == 1.0):
                other.add(block)
    other.add(SampleBlock("arm.pose", 0, 1.0, jumping, rate_hz=500.0))
    found = touches_of(other, visits, forces_stream="signals.tip", pose_stream="arm.pose", angles=3)
    assert [touch.true_rad for touch in found] == pytest.approx(ANGLES, abs=1e-3)


def test_every_visit_to_a_state_has_its_span():
    visits = [("A", 0.0), ("B", 1.0), ("A", 2.0)]
    assert spans_of(visits, "A") == [(0.0, 1.0), (2.0, math.inf)]
    assert spans_of(visits, "C") == []
