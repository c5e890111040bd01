"""The errors of commands that an arm does not take, in full; the bounds of its tool speeds, to the number."""

import math

import pytest

from drivers.arm.axis import Axis, way
from drivers.arm.commands import valid
from drivers.arm.guidance import (
    ARRIVED_M,
    CYCLE_S,
    SETTLE_S,
    FreeMotion,
    approach_twist,
    bound_ahead,
    line_speed,
)
from drivers.arm.link import ArmRow
from drivers.arm.settings import ArmSettings
from drivers.core.errors import CommandError
from drivers.core.messages import Excite, Home, Listen, MoveAt, MovePose, MoveTo, Stop, Tare, Twist
from tests.refusals import refused

START = (0.4, 0.0, 0.2, 0.0, 3.0, 0.0)
REST = (0.0,) * 6
NOW_S, NAN = 20.0, math.nan
SETTINGS = ArmSettings(
    rate_hz=500.0,
    host="-",
    start_pose=START,
    max_speed_m_s=0.05,
    max_turn_rad_s=0.5,
    leash_m=0.1,
    travel_min_m=-0.02,
    travel_max_m=0.04,
    acceleration_m_s2=0.5,
    stop_m_s2=1.0,
)
STREAMS = ("arm.pose", "arm.force", "arm.position")


WRONG = [(0.1,) * 5, (0.1,) * 7, (0.01, 0.0, 0.0, 0.0, 0.0, NAN), (-math.inf, *REST[1:])]


def checked(command):
    return valid("arm", SETTINGS, STREAMS, command)


def pose(x=0.0, z=0.0, turn=0.0):
    return MovePose("arm", (x, 0.0, z, turn, 0.0, 0.0), 0.01)


@pytest.mark.parametrize(
    ("command", "reason", "remedy"),
    [
        (Tare("arm", "arm.pose"), "arm.pose cannot be tared", "arm.force, arm.pose, arm.position"),
        (Excite("arm", True), "an arm only moves", "another device"),
        *((Twist("arm", twist, 1.0), "no twist", "six finite numbers") for twist in WRONG),
        *((Twist("arm", REST, time_s), "no duration", "up to 60 s") for time_s in (0.0, -1.0, NAN, 61.0)),
        *((MovePose("arm", offset, 0.01), "no offset", "six finite numbers") for offset in WRONG),
        *((MovePose("arm", REST, speed), "no speed", "above zero") for speed in (0.0, -0.01, NAN)),
        (pose(turn=3.2), "more than pi", "shorter way"),
        (pose(x=0.11), "its leash is 0.1 m", "more leash_m"),
        (pose(z=0.021), "its travel is -0.02 to 0.04 m", "inside it"),
    ],
)
def test_a_refused_command_says_what_where_and_what_to_do(command, reason, remedy):
    with refused(CommandError, "arm: ", reason, remedy):
        checked(command)


@pytest.mark.parametrize(
    "command",
    [
        MoveAt("arm", -0.01, -0.02),
        MoveAt("arm", 0.05, 0.04),
        MoveTo("arm", 0.04, 0.05),
        Twist("arm", REST, 60.0),
        Twist("arm", REST, 0.5),
        Twist("arm", (0.05, 0.0, 0.0, 0.0, 0.5, 0.0), 1.0),
        Home("arm"),
        Stop("arm"),
        Listen("arm", frozenset(STREAMS)),
        Tare("arm", "arm.force"),
        pose(x=0.1),
        pose(z=0.02),
        pose(z=-0.04),
        pose(turn=math.pi),
    ],
)
def test_what_is_just_within_its_bounds_is_taken(command):
    assert checked(command) == command


@pytest.mark.parametrize("z", [0.02 + 1e-8, -0.04 - 1e-8])
def test_a_place_beyond_the_travel_by_more_than_rounding_is_refused(z):
    with pytest.raises(CommandError, match="travel"):
        checked(pose(z=z))


@pytest.mark.parametrize("axis", range(6))
def test_a_twist_is_clamped_about_each_axis_by_the_limit_of_its_kind(axis):
    asked, clamped = [0.0] * 6, [0.0] * 6
    asked[axis], clamped[axis] = -3.0, -0.05 if axis < 3 else -0.5
    assert checked(Twist("arm", tuple(asked), 1.0)).twist == pytest.approx(tuple(clamped))


@pytest.mark.parametrize("axis", range(3))
def test_a_move_that_turns_about_any_axis_may_turn_as_fast_as_the_arm_may(axis):
    offset = [0.0] * 6
    offset[3 + axis] = 0.1
    assert checked(MovePose("arm", tuple(offset), 1.0)).speed_m_s == 0.5


def row(z=0.2, twist=REST, x=0.4):
    return ArmRow(NOW_S, 1.0, (x, 0.0, z, 0.0, 3.0, 0.0), twist, REST)


def approach(velocity_m_s, left_m, speed_m_s=0.0, later_s=-CYCLE_S):
    """The speed along the axis; `later_s` after the row, by default when the next command acts at the row's time."""
    goal = MoveAt("arm", velocity_m_s, 0.03)
    z = 0.2 - 0.03 + math.copysign(left_m, velocity_m_s)
    twist = approach_twist(
        Axis(SETTINGS), goal, row(z, (0.0, 0.0, -speed_m_s, 0.0, 0.0, 0.0)), NOW_S + later_s
    )
    if twist is None:
        return None
    assert twist[:2] == twist[3:5] == (0.0, 0.0)
    return -twist[2]


def test_an_approach_goes_as_asked_then_as_it_can_brake_and_then_settles():
    assert approach(0.02, 0.01) == 0.02
    assert approach(-0.02, 0.01) == -0.02
    assert approach(0.05, 0.002) == pytest.approx(math.sqrt(0.5 * 0.002))
    assert approach(-0.05, 0.002) == pytest.approx(-math.sqrt(0.5 * 0.002))
    assert approach(0.05, 0.0002) == pytest.approx(0.0002 / SETTLE_S)
    assert approach(0.05, 1.01 * ARRIVED_M) == pytest.approx(1.01 * ARRIVED_M / SETTLE_S)
    assert approach(0.05, 0.99 * ARRIVED_M) is None


def test_what_is_left_is_seen_from_where_the_tool_will_be_a_cycle_later():
    speed_m_s = math.sqrt(0.5 * (0.004 - 0.04 * (0.01 + CYCLE_S)))
    assert approach(0.05, 0.004, speed_m_s=0.04, later_s=0.01) == pytest.approx(speed_m_s)


def fence(z=0.2, twist=REST, x=0.4, later_s=-CYCLE_S):
    return bound_ahead(Axis(SETTINGS), row(z, twist, x), NOW_S + later_s)


def going(x=0.0, z=0.0):
    return (x, 0.0, z, 0.0, 0.0, 0.0)


def test_the_fence_is_seen_in_time_to_brake_and_named():
    """0.1 m/s at 1 m/s2 takes half of 0.1 s at full speed: 5 mm."""
    assert fence(0.1651, going(z=-0.1)) == ""
    assert fence(0.1649, going(z=-0.1)) == "it is at the end of its travel, at 0.0351 m"
    assert fence(0.2149, going(z=0.1)) == ""
    assert fence(0.2151, going(z=0.1)) == "it is at the end of its travel, at -0.0151 m"
    assert fence(x=0.4949, twist=going(x=0.1)) == ""
    assert fence(x=0.4951, twist=going(x=0.1)) == "it is at the end of its leash of 0.1 m"
    assert fence(0.1649 + 0.1 * CYCLE_S, going(z=-0.1), later_s=0.0) != ""
    assert fence(0.1651 + 0.1 * CYCLE_S, going(z=-0.1), later_s=0.0) == ""


def test_the_way_to_brake_is_as_long_as_the_deceleration_makes_it_and_no_turn_adds_to_it():
    """0.1 m/s at 2 m/s2 takes a quarter of 0.1 s at full speed: 2.5 mm."""
    axis = Axis(SETTINGS.model_copy(update={"stop_m_s2": 2.0}))
    for turn_rad_s in (0.0, 3.0):
        twist = (0.0, 0.0, -0.1, turn_rad_s, 0.0, 0.0)
        assert bound_ahead(axis, row(0.1626, twist), NOW_S - CYCLE_S) == ""
        assert "travel" in bound_ahead(axis, row(0.1624, twist), NOW_S - CYCLE_S)


def test_a_turn_alone_brakes_no_way():
    assert fence(0.1601, (0.0, 0.0, 0.0, 3.0, 3.0, 3.0)) == ""


def test_beyond_a_bound_the_way_back_and_rest_are_free():
    for z in (0.14, 0.24):
        assert fence(z) == ""
        back = math.copysign(0.05, 0.2 - z)
        assert fence(z, going(z=back)) == ""
        assert "travel" in fence(z, going(z=-back))
    assert fence(x=0.55) == ""
    assert fence(x=0.55, twist=going(x=-0.1)) == ""
    assert "leash" in fence(x=0.55, twist=going(x=0.1))


def test_a_free_motion_takes_the_longer_of_the_two_times_up_and_down():
    free = FreeMotion(going(x=0.02), (0.02, 0.0, 0.0, 0.3, 0.0, 0.4), NOW_S, 2.0, 0.5)
    assert free.twist(NOW_S) == pytest.approx(going(x=0.02))
    assert free.twist(NOW_S + 0.5) == pytest.approx((0.02, 0.0, 0.0, 0.15, 0.0, 0.2))
    assert free.twist(NOW_S + 1.0) == (0.02, 0.0, 0.0, 0.3, 0.0, 0.4)
    assert free.twist(NOW_S + 2.0) == (0.02, 0.0, 0.0, 0.3, 0.0, 0.4)
    assert free.twist(NOW_S + 2.75) == pytest.approx((0.005, 0.0, 0.0, 0.075, 0.0, 0.1))
    assert free.twist(NOW_S + 3.0) is None
    assert free.twist(NOW_S + 9.0) is None


def test_a_free_motion_that_turns_back_passes_through_rest_on_its_way():
    """From 0.02 to -0.02 m/s at 0.5 m/s2: 0.08 s."""
    free = FreeMotion(going(x=0.02), going(x=-0.02), NOW_S, 1.0, 0.5)
    assert free.twist(NOW_S + 0.02) == pytest.approx(going(x=0.01))
    assert free.twist(NOW_S + 0.04) == pytest.approx(REST)
    assert free.twist(NOW_S + 0.06) == pytest.approx(going(x=-0.01))
    assert free.twist(NOW_S + 0.081) == going(x=-0.02)


@pytest.mark.parametrize("axis", range(3))
def test_a_free_motion_ramps_translation_and_turn_apart_about_any_axis(axis):
    """0.4 rad/s at 0.5 rad/s2 takes 0.8 s; 0.3 m/s beside it takes less."""
    goal = [0.3, 0.0, 0.0, 0.0, 0.0, 0.0]
    goal[3 + axis] = 0.4
    free = FreeMotion(REST, tuple(goal), NOW_S, 2.0, 0.5)
    assert free.twist(NOW_S + 0.4) == pytest.approx([0.5 * part for part in goal])
    assert free.twist(NOW_S + 0.81) == tuple(goal)


def test_a_free_motion_shorter_than_its_ramp_comes_down_from_where_it_got_to():
    free = FreeMotion(REST, going(x=0.05), NOW_S, 0.05, 0.5)
    assert free.twist(NOW_S + 0.05) == pytest.approx(going(x=0.025))
    assert free.twist(NOW_S + 0.075) == pytest.approx(going(x=0.0125))
    assert free.twist(NOW_S + 0.1001) is None


def test_a_free_motion_that_begins_at_its_twist_keeps_it_at_once():
    free = FreeMotion(going(x=0.01), going(x=0.01), NOW_S, 1.0, 0.5)
    assert free.twist(NOW_S) == free.twist(NOW_S + 0.5) == going(x=0.01)


def test_a_straight_move_is_a_turn_where_its_point_hardly_moves():
    assert line_speed(SETTINGS, 2e-4, 0.4) == 0.4
    assert line_speed(SETTINGS, 2e-4, 0.6) == 0.5
    assert line_speed(SETTINGS, 2.1e-4, 0.4) == 0.05
    assert line_speed(SETTINGS, 1.0, 0.01) == 0.01


@pytest.mark.parametrize("axis", range(3))
def test_the_way_counts_every_axis_of_a_turn(axis):
    turned = [0.0, 0.0, 0.0]
    turned[axis] = 0.4
    more = [0.0, 0.0, 0.0]
    more[axis] = 1.5
    assert way((0.1, 0.2, 0.3, *turned), (0.1, 0.2, 0.3, *more)) == pytest.approx((0.0, 1.1))


def test_the_way_of_no_turn_is_nothing_however_its_cosine_is_rounded():
    for turn in (0.1, 0.7, 1.3, 3.0):
        assert way((0.0, 0.0, 0.0, turn, turn, turn), (0.0, 0.0, 0.0, turn, turn, turn))[1] < 1e-7
