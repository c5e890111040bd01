"""Every way in which the emulated arm moves, and how it ends in a protective stop."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator.devices.ur_controller.controller import HALT_M_S2, Safety
from simulator.devices.ur_controller.script import STEP_S
from tests.simulator.devices.ur_desk import Desk, desk, down

MOVE_L, SPEED_L, SPEED_STOP, TEACH, STOP_L = 3, 10, 15, 18, 33

PLANE_M = 0.17
"""A centimetre under the tool where it starts."""


def pressed(one: Desk) -> None:
    """Let go while the plane pushes: the arm gives way upwards."""
    one.call(MOVE_L, [*down(one, 0.014), 0.05, 0.5])
    one.write(TEACH)


MOTIONS: dict[str, Callable[[Desk], None]] = {
    "moveL": lambda one: one.write(MOVE_L, [*down(one, -0.1), 0.2, 1.0]),
    "moveL, asynchronous": lambda one: one.write(MOVE_L, [*down(one, -0.1), 0.2, 1.0], flag=1),
    "speedL": lambda one: one.write(SPEED_L, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, 0.002]),
    "speedL for long": lambda one: one.write(SPEED_L, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, 5.0]),
    "led by hand": pressed,
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_protective_stop_stops_the_arm_in_every_motion(motion: str) -> None:
    one = desk(plane_m=PLANE_M)
    MOTIONS[motion](one)
    one.run(15)
    assert not one.controller.arm.resting, "it moves"
    one.controller.protective_stop("by hand")
    assert one.controller.safety is Safety.PROTECTIVE_STOP
    twist = one.controller.arm.twist
    fastest = max(np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:]))
    one.run(2 + int(fastest / HALT_M_S2 / STEP_S))
    assert one.controller.arm.resting
    where = one.controller.arm.joints_rad.copy()
    one.run(500)
    assert (one.controller.arm.joints_rad == where).all()
    assert not one.controller.playing


def test_an_arm_that_is_led_gives_way_until_nothing_pushes() -> None:
    one = desk(plane_m=PLANE_M)
    pressed(one)
    assert one.controller.force[2] == pytest.approx(40.0, abs=1.0)  # 4 mm at 10 kN/m
    one.run(2000)
    assert abs(one.controller.force[2]) < 0.05


@pytest.mark.parametrize(
    ("order", "reason"),
    [
        (lambda one: one.write(MOVE_L, [*one.pose, 0.0, 0.5]), "speed 0.0"),
        (lambda one: one.write(MOVE_L, [*one.pose, 0.1, 0.0]), "acceleration 0.0"),
        (lambda one: one.write(SPEED_STOP, [0.0]), "acceleration 0.0"),
        (lambda one: one.write(STOP_L, [0.0], flag=1), "acceleration 0.0"),
        (lambda one: one.write(STOP_L, [1.0]), "without `async`"),
        (lambda one: one.write(1), "command 1 is not emulated"),
    ],
)
def test_what_makes_no_sense_ends_the_program_with_a_reason_and_the_arm_at_rest(
    order: Callable[[Desk], object], reason: str
) -> None:
    one = desk()
    order(one)
    one.run(50)
    assert not one.controller.playing
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


def test_accelerations_are_the_change_of_the_speeds() -> None:
    one = desk()
    one.write(SPEED_L, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, 0.002])
    one.run(20)
    before = one.controller.arm.joint_speeds_rad_s
    one.run(1)
    change = (one.controller.arm.joint_speeds_rad_s - before) / STEP_S
    assert np.abs(change).max() > 0.1
    assert one.controller.arm.joint_accelerations_rad_s2 == pytest.approx(change)
    one.write(SPEED_STOP, [1.0])
    one.run(200)
    assert one.controller.arm.joint_accelerations_rad_s2 == pytest.approx(np.zeros(6), abs=1e-9)
