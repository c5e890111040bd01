"""The arm keeps to its speeds and accelerations, and comes to rest where it is sent."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from simulator.physics import rigid
from simulator.physics.arm_motion import (
    Arm,
    ArmMotion,
    JointMove,
    JointSpeed,
    LimitError,
    StiffPlane,
    ToolMove,
    ToolSpeed,
)

DT_S = 0.002
START = (0.0, -1.8, -2.2, -0.71, 1.5708, 0.0)


def moved(arm: Arm, motion: ArmMotion, until: Callable[[], bool] | None = None) -> Iterator[Arm]:
    arm.motion = motion
    for _ in range(5000):
        arm.step(DT_S)
        yield arm
        if motion.done if until is None else until():
            return
    pytest.fail("the motion never ends")


def test_a_straight_move_stays_on_its_line_and_keeps_to_its_limits() -> None:
    arm = Arm(START)
    start = arm.pose
    target = rigid.displaced(arm.transform, np.array([0.03, 0.0, -0.04, 0.0, 0.0, 0.1]))
    speeds = []
    for state in moved(arm, ToolMove(target, 0.05, 0.4)):
        way = state.pose[:3] - start[:3]
        assert np.linalg.norm(np.cross(way, [0.6, 0.0, -0.8])) < 1e-9
        speeds.append(float(np.linalg.norm(state.twist[:3])))
    assert max(speeds) <= 0.05 * (1 + 1e-6)
    assert np.abs(np.diff([0.0, *speeds])).max() <= 0.4 * DT_S * (1 + 1e-3)
    assert arm.transform == pytest.approx(target, abs=1e-9)
    assert arm.resting


def test_a_joint_move_brings_all_joints_to_their_angles_together() -> None:
    arm = Arm(START)
    goal = np.add(START, [0.2, -0.1, 0.05, 0.0, 0.1, -0.4])
    shares = []
    for state in moved(arm, JointMove(goal, 0.5, 1.0)):
        done = (state.joints_rad - START)[[0, 1, 2, 4, 5]] / [0.2, -0.1, 0.05, 0.1, -0.4]
        shares.append(np.ptp(done))
        assert np.abs(state.joint_speeds_rad_s).max() <= 0.5 * (1 + 1e-6)
    assert max(shares) < 1e-9
    assert arm.joints_rad == pytest.approx(goal)
    assert arm.resting


def test_a_tool_speed_is_reached_at_its_acceleration_and_kept() -> None:
    arm = Arm(START)
    twists = [
        state.twist.copy()
        for state in moved(
            arm, ToolSpeed([0.0, 0.0, -0.02, 0.0, 0.0, 0.05], 0.2), lambda: arm.twist[2] <= -0.02
        )
    ]
    assert len(twists) * DT_S == pytest.approx(0.02 / 0.2, abs=2 * DT_S)
    assert np.abs(np.diff(np.array(twists)[:, 2])).max() <= 0.2 * DT_S * (1 + 1e-6)
    assert twists[-1] == pytest.approx(
        [0.0, 0.0, -0.02, 0.0, 0.0, 0.05 * min(1.0, 0.1 * 0.2 / 0.05)], abs=1e-3
    )


def test_a_stop_takes_the_braking_distance_of_its_deceleration() -> None:
    arm = Arm(START)
    list(moved(arm, ToolSpeed([0.0, 0.0, -0.1, 0.0, 0.0, 0.0], 1.0), lambda: arm.twist[2] <= -0.1))
    height_m = arm.pose[2]
    list(moved(arm, ToolSpeed(np.zeros(6), 1.0)))
    assert arm.resting
    assert height_m - arm.pose[2] == pytest.approx(0.1**2 / 2, abs=0.1 * DT_S)


def test_joint_speeds_stop_at_their_deceleration() -> None:
    arm = Arm(START)
    list(moved(arm, JointSpeed([0.2] + [0.0] * 5, 1.0), lambda: arm.joint_speeds_rad_s[0] >= 0.2))
    assert len(list(moved(arm, JointSpeed(np.zeros(6), 1.0)))) * DT_S == pytest.approx(0.2, abs=2 * DT_S)
    assert arm.resting


def test_a_move_that_begins_in_motion_brakes_before_it_sets_out() -> None:
    arm = Arm(START)
    target = rigid.displaced(arm.transform, np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]))
    list(moved(arm, ToolSpeed([0.0, 0.0, -0.05, 0.0, 0.0, 0.0], 1.0), lambda: arm.twist[2] <= -0.05))
    before = arm.twist.copy()
    for state in moved(arm, ToolMove(target, 0.05, 1.0)):
        assert np.linalg.norm(state.twist[:3] - before[:3]) <= 1.0 * DT_S * (1 + 1e-3)
        before = state.twist.copy()
    assert arm.transform == pytest.approx(target, abs=1e-9)


def test_a_tool_that_would_be_too_fast_stops_the_arm_instead() -> None:
    arm = Arm(START)
    arm.motion = ToolSpeed([2.0, 0.0, 0.0, 0.0, 0.0, 0.0], 100.0)
    with pytest.raises(LimitError):
        for _ in range(100):
            arm.step(DT_S)
    assert arm.resting


def test_a_way_out_of_reach_stops_the_arm_instead() -> None:
    arm = Arm(START)
    arm.motion = ToolMove(rigid.displaced(arm.transform, np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])), 1.0, 2.0)
    with pytest.raises(LimitError):
        for _ in range(5000):
            arm.step(DT_S)
    assert arm.resting
    assert np.isfinite(arm.joints_rad).all()


def test_a_speed_that_is_no_number_stops_the_arm_and_leaves_its_joints_numbers() -> None:
    arm = Arm(START)
    arm.motion = ToolSpeed([math.nan, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0)
    with pytest.raises(LimitError):
        arm.step(DT_S)
    assert np.isfinite(arm.joints_rad).all()


def test_another_tool_moves_the_point_and_not_the_joints() -> None:
    arm = Arm(START)
    flange = arm.transform.copy()
    arm.mount(rigid.matrix([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    assert arm.transform[:3, 3] == pytest.approx(flange[:3, 3] + 0.1 * flange[:3, 2])
    assert arm.joints_rad == pytest.approx(START)


def test_a_plane_pushes_back_by_its_stiffness_and_never_pulls() -> None:
    plane = StiffPlane(height_m=0.1, stiffness_n_m=1000.0)
    below = plane.wrench(np.array([0.0, 0.0, 0.098, 0.0, 0.0, 0.0]), np.zeros(6), 0.0)
    assert below == pytest.approx([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    assert not plane.wrench(np.array([0.0, 0.0, 0.102, 0.0, 0.0, 0.0]), np.zeros(6), 0.0).any()
