"""Every way in which the emulated arm moves: how it ends in a protective stop, and what the slider does to it."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator.devices.ur_controller.controller import Runtime, Safety
from simulator.devices.ur_controller.script import STEP_S
from tests.simulator.devices.ur_desk import Desk, desk, down

MOVE_J, MOVE_L, FORCE, END_FORCE, SPEED_J, SPEED_L = 1, 3, 6, 7, 9, 10
SERVO_J, SPEED_STOP, SERVO_STOP = 11, 15, 16
GAIN, HISTORY, PROTECTIVE_STOP, STOP_L, STOP_J, FIND_JOINTS, FREEDRIVE = 21, 27, 31, 33, 34, 46, 52

PLANE_M = 0.17
"""A centimetre under the tool where it starts."""

LIMITS = (0.1, 0.1, 0.05, 1.0, 1.0, 1.0)


def turned(one: Desk, by_rad: float) -> list[float]:
    joints = one.controller.arm.joints_rad
    return [float(joints[0]) + by_rad, *joints[1:]]


def push(one: Desk, force_n: float = 20.0, kind: int = 2) -> None:
    """Force mode along the base's z."""
    wrench = (0.0, 0.0, -force_n, 0.0, 0.0, 0.0)
    one.write(FORCE, [*[0.0] * 6, *wrench, *LIMITS], flags=[kind, 0, 0, 1, 0, 0, 0])


def pressed(one: Desk) -> None:
    """Let go while the plane pushes: the arm gives way upwards."""
    one.call(MOVE_L, [*down(one, 0.014), 0.05, 0.5])
    one.write(FREEDRIVE, [0.0] * 6, flags=[1] * 6)


MOTIONS: dict[str, Callable[[Desk], None]] = {
    "moveJ": lambda one: one.write(MOVE_J, [*turned(one, 1.0), 1.0, 2.0]),
    "moveJ, asynchronous": lambda one: one.write(MOVE_J, [*turned(one, 1.0), 1.0, 2.0], flag=1),
    "moveL": lambda one: one.write(MOVE_L, [*down(one, -0.1), 0.2, 1.0]),
    "moveL, asynchronous": lambda one: one.write(MOVE_L, [*down(one, -0.1), 0.2, 1.0], flag=1),
    "servoJ": lambda one: one.write(SERVO_J, [*turned(one, 0.5), 0.0, 0.0, 0.002, 0.1, 300.0]),
    "speedJ": lambda one: one.write(SPEED_J, [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.002]),
    "speedL": lambda one: one.write(SPEED_L, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, 0.002]),
    "speedL for long": lambda one: one.write(SPEED_L, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, 5.0]),
    "forceMode": push,
    "freedrive": pressed,
}


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("by", ["the program", "the controller"])
def test_a_protective_stop_stops_the_arm_in_every_motion(motion: str, by: str) -> None:
    one = desk(plane_m=PLANE_M)
    MOTIONS[motion](one)
    one.run(15)
    assert not one.controller.arm.resting, "it moves"
    # a blocking move reads no command before its end
    if by == "the program" and motion not in ("moveJ", "moveL"):
        one.write(0)
        one.run(1)
        one.write(PROTECTIVE_STOP)
        one.run(1)
    else:
        one.controller.protective_stop("by hand")
    assert one.controller.safety is Safety.PROTECTIVE_STOP
    twist = one.controller.arm.twist
    fastest = max(np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:]))
    one.run(2 + int(fastest / one.controller.settings.halt_m_s2 / STEP_S))
    assert one.controller.arm.resting
    where = one.controller.arm.joints_rad.copy()
    one.run(500)
    assert (one.controller.arm.joints_rad == where).all()
    assert one.controller.runtime is Runtime.STOPPED


def test_force_mode_goes_no_faster_than_its_limit_in_free_air() -> None:
    one = desk()
    push(one, 50.0)
    one.run(200)
    assert one.controller.arm.twist[2] == pytest.approx(-LIMITS[2], rel=1e-6)


def test_force_mode_of_type_1_pushes_towards_the_origin_of_its_frame() -> None:
    one = desk()
    origin = one.pose[:3] + np.array([0.0, -0.3, 0.0])
    wrench = [0.0, 20.0, 0.0, 0.0, 0.0, 0.0]
    one.write(FORCE, [*origin, 0.0, 0.0, 0.0, *wrench, *LIMITS], flags=[1, 0, 1, 0, 0, 0, 0])
    one.run(150)
    assert one.controller.arm.twist[:3] == pytest.approx([0.0, -LIMITS[1], 0.0], abs=1e-3)


def test_force_mode_of_type_3_pushes_along_the_way_that_the_tool_goes() -> None:
    one = desk()
    wrench = [20.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    numbers = [*[0.0] * 6, *wrench, *LIMITS]
    one.write(FORCE, numbers, flags=[3, 1, 0, 0, 0, 0, 0])
    one.run(150)  # at rest the frame is as given: the base's x
    assert one.controller.arm.twist[:3] == pytest.approx([LIMITS[0], 0.0, 0.0], abs=1e-3)
    turned_round = [0.0, 0.0, 0.0, 0.0, 0.0, np.pi, *wrench, *LIMITS]
    one.write(FORCE, turned_round, flags=[3, 1, 0, 0, 0, 0, 0])
    one.run(150)
    assert one.controller.arm.twist[0] == pytest.approx(LIMITS[0], abs=1e-3), "whichever way its x was given"


def test_more_gain_makes_force_mode_quicker() -> None:
    one, twin = desk(), desk()
    one.call(GAIN, [1.0])
    for each in (one, twin):
        push(each, 4.0)
        each.run(100)
    assert one.controller.arm.twist[2] == pytest.approx(2.0 * twin.controller.arm.twist[2])


@pytest.mark.parametrize(
    ("order", "reason"),
    [
        (lambda one: push(one, kind=4), "force mode has no type 4"),
        (lambda one: (push(one), one.run(5), one.write(MOVE_L, [*one.pose, 0.1, 0.5])), "in force mode"),
        (lambda one: one.write(GAIN, [7.0]), "a gain of 7.0"),
        (lambda one: one.write(MOVE_L, [*one.pose, 0.0, 0.5]), "speed 0.0"),
        (lambda one: one.write(MOVE_L, [*one.pose, 0.1, 0.0]), "acceleration 0.0"),
        (lambda one: one.write(MOVE_J, [*one.controller.arm.joints_rad, 0.0, 1.0]), "speed 0.0"),
        (lambda one: one.write(SPEED_STOP, [0.0]), "acceleration 0.0"),
        (lambda one: one.write(STOP_L, [0.0]), "acceleration 0.0"),
        (lambda one: one.write(STOP_J, [-1.0]), "acceleration -1.0"),
        (lambda one: one.write(SERVO_STOP, [float("nan")]), "acceleration nan"),
        (lambda one: one.write(HISTORY, flag=-100_000), "joints -100000 steps ago"),
        (lambda one: one.write(FIND_JOINTS, [5.0, *[0.0] * 5]), "no joint angles put the tool there"),
        (lambda one: one.write(SPEED_L, [float("nan"), *[0.0] * 5, 0.5, 0.002]), "protective stop: "),
    ],
)
def test_what_makes_no_sense_ends_the_program_with_a_reason_and_the_arm_at_rest(
    order: Callable[[Desk], object], reason: str
) -> None:
    one = desk()
    order(one)
    one.run(50)
    assert one.controller.runtime is Runtime.STOPPED
    assert reason in one.log
    assert one.controller.arm.resting


def test_more_force_than_the_limit_is_a_protective_stop_whatever_was_tared() -> None:
    one = desk(plane_m=PLANE_M)
    one.call(MOVE_L, [*down(one, 0.02), 0.02, 0.5])
    one.controller.zero_force()
    assert one.controller.safety is Safety.NORMAL
    one.write(SPEED_L, [0.0, 0.0, -0.02, 0.0, 0.0, 0.0, 1.0, 0.002])
    one.run(500)
    assert one.controller.safety is Safety.PROTECTIVE_STOP
    assert "above 150 N" in one.log
    assert one.controller.raw_force[2] == pytest.approx(150.0, abs=5.0), "it does not press on"


def slide(one: Desk, fraction: float) -> None:
    one.controller.write_inputs({"speed_slider_mask": 1, "speed_slider_fraction": fraction})


def test_the_slider_scales_a_speed_that_goes_on_without_a_jump() -> None:
    one = desk()
    one.write(SPEED_L, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, 0.002])
    one.run(200)
    slide(one, 0.5)
    speeds_m_s = []
    for _ in range(200):
        one.run(1)
        speeds_m_s.append(one.controller.arm.twist[2])
    assert speeds_m_s[-1] == pytest.approx(0.05, rel=1e-6)
    assert np.abs(np.diff([0.1, *speeds_m_s])).max() < 1e-3
    slide(one, 0.0)
    one.run(200)
    where = one.pose.copy()
    one.run(50)
    assert (one.pose == where).all()


def test_a_stop_of_the_controller_s_own_is_as_short_at_every_pace() -> None:
    one = desk()
    slide(one, 0.1)
    one.run(1)
    one.write(SPEED_L, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 5.0, 0.002])
    one.run(1000)
    assert one.controller.arm.twist[2] == pytest.approx(0.1, rel=0.01)
    one.controller.protective_stop("by hand")
    one.run(11)  # 0.1 m/s at 5 m/s2
    assert one.controller.arm.resting


@pytest.mark.parametrize("fraction", [-0.1, 1.1, float("nan")])
def test_a_fraction_that_is_none_leaves_the_slider(fraction: float) -> None:
    one = desk()
    slide(one, fraction)
    assert one.controller.panel.slider == 1.0


def test_accelerations_are_the_change_of_the_speeds() -> None:
    one = desk()
    one.write(SPEED_J, [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.002])
    one.run(20)
    assert one.controller.arm.joint_accelerations_rad_s2[0] == pytest.approx(1.0)
    one.run(200)
    assert one.controller.arm.joint_accelerations_rad_s2 == pytest.approx(np.zeros(6), abs=1e-9)
