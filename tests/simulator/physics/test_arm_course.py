"""The simulated arm: kinematics and courses."""

import math
from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from simulator.physics import arm, rigid
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


FAR_M = np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "motion",
    [
        lambda arm: ToolSpeed([2.0, 0.0, 0.0, 0.0, 0.0, 0.0], 100.0),
        lambda arm: ToolMove(rigid.displaced(arm.transform, FAR_M), 1.0, 2.0),
        lambda arm: ToolSpeed([math.nan, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0),
    ],
    ids=["too fast", "out of reach", "no number"],
)
def test_what_the_arm_cannot_do_stops_it_and_leaves_its_joints_numbers(
    motion: Callable[[Arm], ArmMotion],
) -> None:
    arm = Arm(START)
    with pytest.raises(LimitError):
        list(moved(arm, motion(arm)))
    assert arm.resting
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


angles = st.floats(-3.0, 3.0)
postures = st.tuples(*[angles] * 6)

DH_BY_HAND = (
    (0.0, 0.1625, math.pi / 2),
    (-0.425, 0.0, 0.0),
    (-0.3922, 0.0, 0.0),
    (0.0, 0.1333, math.pi / 2),
    (0.0, 0.0997, -math.pi / 2),
    (0.0, 0.0996, 0.0),
)
"""a, d, alpha of Universal Robots' UR5e row, typed here a second time."""


def judge() -> mujoco.MjModel:
    """A chain of hinges in MuJoCo: it knows rotations and offsets, and none of our matrices."""
    inner = '<site name="flange"/>'
    for a, d, alpha in reversed(DH_BY_HAND):
        inner = (
            '<body><joint type="hinge" axis="0 0 1"/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
            f'<body pos="{a} 0 {d}" axisangle="1 0 0 {alpha}">'
            '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
            f"{inner}</body></body>"
        )
    xml = f'<mujoco><compiler angle="radian"/><worldbody>{inner}</worldbody></mujoco>'
    return mujoco.MjModel.from_xml_string(xml)


def test_mujoco_puts_the_flange_in_the_same_place() -> None:
    model = judge()
    data = mujoco.MjData(model)
    generator = np.random.default_rng(1)
    for joints in generator.uniform(-3.0, 3.0, (20, 6)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        transform = arm.forward(joints)
        assert transform[:3, 3] == pytest.approx(data.site("flange").xpos, abs=1e-9)
        assert transform[:3, :3].ravel() == pytest.approx(data.site("flange").xmat, abs=1e-9)


@given(postures)
def test_every_solution_of_the_inverse_puts_the_tool_on_its_target(posture: tuple[float, ...]) -> None:
    assume(abs(math.sin(posture[4])) > 1e-3)
    tool = rigid.matrix([0.01, -0.02, 0.15, 0.1, 0.2, -0.3])
    target = arm.forward(posture, tool)
    found = list(arm.solutions(target, tool))
    assert found
    for joints in found:
        assert np.abs(arm.forward(joints, tool) - target).max() < 1e-6


@given(postures)
def test_the_inverse_near_a_posture_gives_that_posture_back(posture: tuple[float, ...]) -> None:
    # Where the wrist or the elbow is straight, or the wrist above the base, the arm has a choice.
    assume(min(abs(math.sin(posture[4])), abs(math.sin(posture[2]))) > 0.05)
    target = arm.forward(posture)
    x, y = target[:2, 3] - arm.D6_M * target[:2, 2]
    assume(math.hypot(x, y) > arm.D4_M + 0.01)
    assert arm.solve(target, posture) == pytest.approx(posture, abs=1e-6)


@given(postures)
@example((-0.25, -0.25, -0.5, -0.375, 0.0, 0.0))
def test_a_straight_wrist_keeps_the_sixth_angle_that_it_had(posture: tuple[float, ...]) -> None:
    assume(
        abs(math.sin(posture[2])) > 0.05
    )  # a stretched elbow is the edge of what can be reached, to the last bit
    straight = np.array([*posture[:4], 0.0, posture[5]])
    target = arm.forward(straight)
    x, y = target[:2, 3] - arm.D6_M * target[:2, 2]
    assume(math.hypot(x, y) > arm.D4_M + 0.01)
    assert arm.forward(arm.solve(target, straight)) == pytest.approx(target, abs=1e-6)


@given(postures)
def test_the_jacobian_is_the_slope_of_the_forward_kinematics(posture: tuple[float, ...]) -> None:
    frames = arm._frames(np.array(posture), rigid.IDENTITY)
    end, slopes = frames[-1], arm._slopes(frames)
    for joint in range(6):
        step = np.zeros(6)
        step[joint] = 1e-6
        plus, minus = arm.forward(posture + step), arm.forward(posture - step)
        assert rigid.difference(minus, plus) / 2e-6 == pytest.approx(slopes[:, joint], abs=1e-7)
    assert end == pytest.approx(arm.forward(posture))


def test_tracking_follows_a_small_step_of_the_tool() -> None:
    joints = np.array([0.0, -1.8, -2.2, -0.7, 1.6, 0.2])
    target = rigid.displaced(arm.forward(joints), np.array([1e-3, -2e-3, 1e-3, 0.01, 0.0, -0.01]))
    assert arm.forward(arm.track(joints, target)) == pytest.approx(target, abs=1e-6)


def test_a_target_out_of_reach_is_refused() -> None:
    far = rigid.matrix([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(arm.UnreachableError):
        arm.solve(far, [0.0, -1.0, 1.0, 0.0, 1.0, 0.0])
    with pytest.raises(arm.UnreachableError):
        arm.track(np.array([0.0, -1.0, 1.0, 0.0, 1.0, 0.0]), far)


directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 0.1)


@given(directions, st.floats(0.0, math.pi - 1e-9))
def test_a_rotation_vector_survives_its_matrix(direction: tuple[float, ...], angle_rad: float) -> None:
    vector = np.array(direction) * (angle_rad / math.hypot(*direction))
    assert rigid.rotation_vector(rigid.rotation(vector)) == pytest.approx(vector, abs=1e-7)


def test_half_a_turn_about_an_axis_is_its_matrix() -> None:
    assert rigid.rotation([0.0, 0.0, math.pi]) == pytest.approx(np.diag([-1.0, -1.0, 1.0]), abs=1e-12)
    assert np.abs(rigid.rotation_vector(np.diag([-1.0, -1.0, 1.0]))) == pytest.approx([0.0, 0.0, math.pi])


@given(directions, st.floats(0.0, 3.0))
def test_the_inverse_of_a_transform_undoes_it(direction: tuple[float, ...], angle_rad: float) -> None:
    transform = rigid.matrix([0.3, -0.2, 0.5, *(angle_rad * part for part in direction)])
    assert transform @ rigid.inverse(transform) == pytest.approx(np.eye(4), abs=1e-12)
