"""Nothing goes to the arm that is not finite, of the right length and inside its bounds."""

import math

import pytest
from pydantic import ValidationError

from drivers.arm.axis import Axis, way
from drivers.arm.commands import valid
from drivers.arm.guidance import FreeMotion, Guidance, line_speed
from drivers.arm.link import ArmRow
from drivers.core.clock import WallClock
from drivers.core.errors import CommandError
from drivers.core.messages import (
    Command,
    Excite,
    Home,
    Listen,
    MoveAt,
    MovePose,
    MoveTo,
    Refused,
    Stop,
    Tare,
    Twist,
)
from drivers.ur_arm.driver import UrArm
from drivers.ur_arm.settings import UrArmSettings

START = (0.4, 0.0, 0.2, 0.0, math.pi, 0.0)
STREAMS = ("arm.force", "arm.pose", "arm.position")
NAN, INF = math.nan, math.inf


def settings(**changes: object) -> UrArmSettings:
    given = {
        "host": "127.0.0.2",
        "start_pose": START,
        "max_speed_m_s": 0.05,
        "max_turn_rad_s": 0.5,
        **changes,
    }
    return UrArmSettings.model_validate(given)


def checked(command: Command) -> Command:
    return valid("arm", settings(), STREAMS, command)


@pytest.mark.parametrize(
    "command",
    [
        MoveAt("arm", NAN, 0.01),
        MoveAt("arm", INF, 0.01),
        MoveAt("arm", 0.0, 0.01),
        MoveAt("arm", 0.01, NAN),
        MoveAt("arm", 0.01, 0.06),
        MoveAt("arm", -0.01, -0.06),
        MoveTo("arm", INF, 0.01),
        MoveTo("arm", 0.01, -0.01),
        MoveTo("arm", 0.01, NAN),
        Twist("arm", (0.01, 0.0, 0.0), 1.0),  # type: ignore[arg-type]
        Twist("arm", (0.01,) * 7, 1.0),  # type: ignore[arg-type]
        Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, NAN), 1.0),
        Twist("arm", (INF, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0),
        Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0),
        Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), NAN),
        Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 1e9),
        MovePose("arm", (0.01, 0.0, 0.0), 0.01),  # type: ignore[arg-type]
        MovePose("arm", (0.01,) * 7, 0.01),  # type: ignore[arg-type]
        MovePose("arm", (0.01, 0.0, 0.0, 0.0, 0.0, NAN), 0.01),
        MovePose("arm", (-INF, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01),
        MovePose("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0),
        MovePose("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), NAN),
        MovePose("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), -0.01),
        MovePose("arm", (0.15, 0.15, 0.0, 0.0, 0.0, 0.0), 0.01),
        MovePose("arm", (0.0, 0.0, -0.06, 0.0, 0.0, 0.0), 0.01),
        MovePose("arm", (0.0, 0.0, 0.0, 0.0, 0.0, 3.2), 0.01),
        Tare("arm", "arm.pose"),
        Excite("arm", True),
    ],
)
def test_a_command_that_makes_no_sense_is_an_error_of_one_line(command: Command) -> None:
    with pytest.raises(CommandError) as caught:
        checked(command)
    message = str(caught.value)
    assert message.startswith("arm: ")
    assert "\n" not in message
    assert "; " in message


def test_too_great_a_speed_is_clamped_and_keeps_its_sign() -> None:
    assert checked(MoveAt("arm", -1.0, -0.01)) == MoveAt("arm", -0.05, -0.01)
    assert checked(MoveTo("arm", 0.01, 1.0)) == MoveTo("arm", 0.01, 0.05)


def test_a_twist_is_clamped_as_a_whole() -> None:
    clamped = checked(Twist("arm", (0.06, 0.0, 0.08, 0.0, 0.0, 0.1), 1.0))
    assert isinstance(clamped, Twist)
    # 0.1 m/s is twice too fast: all six are halved.
    assert clamped.twist == pytest.approx((0.03, 0.0, 0.04, 0.0, 0.0, 0.05))
    turning = checked(Twist("arm", (0.01, 0.0, 0.0, 0.0, 1.0, 0.0), 1.0))
    assert isinstance(turning, Twist)
    assert turning.twist == pytest.approx((0.005, 0.0, 0.0, 0.0, 0.5, 0.0))


def test_a_move_is_clamped_by_what_it_does() -> None:
    assert checked(MovePose("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0)).speed_m_s == 0.05  # type: ignore[attr-defined]
    # One that turns may only turn, and then its speed is in rad/s; on its way the limit of the way holds.
    assert checked(MovePose("arm", (0.0, 0.0, 0.0, 0.0, 0.3, 0.0), 1.0)).speed_m_s == 0.5  # type: ignore[attr-defined]
    assert line_speed(settings(), 0.01, 0.5) == 0.05
    assert line_speed(settings(), 0.0, 0.4) == 0.4


def test_an_offset_turns_after_the_start_pose_in_the_base_frame() -> None:
    axis = Axis(settings(start_pose=(0.4, 0.0, 0.2, 0.0, 0.0, math.pi / 2.0)))
    pose = axis.displaced((0.01, 0.02, 0.03, math.pi / 2.0, 0.0, 0.0))
    # A quarter about z, then one about x: the tool's axes x, y, z end on z, -x, -y. That is a third of a turn.
    third = 2.0 * math.pi / 3.0 / math.sqrt(3.0)
    assert pose == pytest.approx((0.41, 0.02, 0.23, third, -third, third))
    assert axis.displaced((0.0,) * 6) == axis.pose(0.0)


def test_a_free_motion_ramps_up_and_down_with_translation_and_turn_together() -> None:
    start, goal = (0.0,) * 6, (0.01, 0.0, 0.0, 0.0, 0.25, 0.0)
    free = FreeMotion(start, goal, 10.0, 2.0, 0.5)
    # 0.25 rad/s at 0.5 rad/s2 takes half a second.
    assert free.twist(10.25) == pytest.approx((0.005, 0.0, 0.0, 0.0, 0.125, 0.0))
    assert free.twist(11.0) == goal
    assert free.twist(12.125) == pytest.approx((0.0075, 0.0, 0.0, 0.0, 0.1875, 0.0))
    assert free.twist(12.5) is None
    steps = [free.twist(10.0 + (number + 0.5) * 1e-3) for number in range(2600)]
    assert sum(twist[0] for twist in steps if twist) * 1e-3 == pytest.approx(2.0 * 0.01)


def test_a_free_motion_that_takes_over_begins_with_what_the_tool_does() -> None:
    free = FreeMotion((0.02, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.02, 0.0, 0.0, 0.0, 0.0), 0.0, 1.0, 0.5)
    assert free.twist(0.0) == pytest.approx((0.02, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert free.twist(0.1) == (0.0, 0.02, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "command",
    [
        Home("arm"),
        Stop("arm"),
        Listen("arm", frozenset(STREAMS)),
        Tare("arm", "arm.force"),
        MoveTo("arm", 0.05, 0.01),
    ],
)
def test_what_is_in_order_goes_through_as_it_is(command: Command) -> None:
    assert checked(command) == command


@pytest.mark.parametrize(
    "changes",
    [
        {"travel_min_m": 0.05, "travel_max_m": 0.05},
        {"approach_axis": [0.0, 0.0, -2.0]},
        {"start_pose": [0.4, 0.0, 0.2]},
        {"start_pose": [0.4, 0.0, 0.2, 0.0, NAN, 0.0]},
        {"max_speed_m_s": 0.3},
        {"watchdog_hz": 0.0},
        {"link_timeout_s": 0.01},
        {"speed": 1.0},
    ],
)
def test_settings_that_make_no_sense_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        settings(**changes)


def test_lists_of_a_profile_are_vectors() -> None:
    assert settings(start_pose=[0, 0, 0.5, 0, 3, 0]).start_pose == (0.0, 0.0, 0.5, 0.0, 3.0, 0.0)


def test_a_position_is_a_place_on_the_axis_and_back() -> None:
    axis = Axis(settings(approach_axis=(0.6, 0.0, -0.8)))
    pose = axis.pose(0.01)
    assert pose == pytest.approx((0.406, 0.0, 0.192, 0.0, math.pi, 0.0))
    assert axis.position_m(pose) == pytest.approx(0.01)
    assert axis.twist(0.02) == pytest.approx((0.012, 0.0, -0.016, 0.0, 0.0, 0.0))


def test_the_way_between_poses_is_a_length_and_an_angle() -> None:
    assert way((0.0, 0.0, 0.0, 0.1, 0.0, 0.0), (0.0, 0.3, 0.4, -0.2, 0.0, 0.0)) == pytest.approx((0.5, 0.3))
    # The same orientation, written twice.
    assert way(START, (0.4, 0.0, 0.2, 0.0, -math.pi, 0.0)) == pytest.approx((0.0, 0.0), abs=1e-7)


def fenced(pose: tuple[float, ...], twist: tuple[float, ...]) -> str:
    row = ArmRow(0.0, 0.0, pose, twist, (0.0,) * 6)  # type: ignore[arg-type]
    return Guidance(settings(leash_m=0.1, stop_m_s2=1.0)).fence(row, 0.0)


def test_a_motion_towards_a_bound_is_stopped_while_it_can_still_brake() -> None:
    # 0.05 m/s at 1 m/s2 takes 1.25 mm, and 0.4 mm go by before the next cycle acts.
    towards = (0.0, 0.0, -0.05, 0.0, 0.0, 0.0)
    assert "travel" in fenced((0.4, 0.0, 0.1515, 0.0, math.pi, 0.0), towards)
    assert fenced((0.4, 0.0, 0.1520, 0.0, math.pi, 0.0), towards) == ""


def test_a_motion_back_from_beyond_a_bound_is_free() -> None:
    beyond = (0.4, 0.0, 0.14, 0.0, math.pi, 0.0)
    assert fenced(beyond, (0.0, 0.0, 0.05, 0.0, 0.0, 0.0)) == ""
    assert fenced(beyond, (0.0, 0.0, -0.05, 0.0, 0.0, 0.0)) != ""
    aside = (0.52, 0.0, 0.2, 0.0, math.pi, 0.0)
    assert fenced(aside, (-0.05, 0.0, 0.0, 0.0, 0.0, 0.0)) == ""
    assert "leash" in fenced(aside, (0.05, 0.0, 0.0, 0.0, 0.0, 0.0))


def test_an_arm_that_is_not_open_refuses_and_closes_in_peace() -> None:
    arm = UrArm("arm", settings(), WallClock())
    arm.apply(MoveTo("arm", 0.0, 0.01))
    (refused,) = arm.poll()
    assert isinstance(refused, Refused)
    assert refused.reason == "it is not open"
    assert not arm.read()
    arm.close()
    arm.close()
