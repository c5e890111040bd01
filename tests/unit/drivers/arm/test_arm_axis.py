"""The approach axis and the geometry of poses; settings that make no sense."""

import math

import pytest
from pydantic import ValidationError

from drivers.arm.axis import Axis, way
from drivers.core.clock import WallClock
from drivers.core.messages import MoveTo, Refused
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


def test_an_offset_turns_after_the_start_pose_in_the_base_frame() -> None:
    axis = Axis(settings(start_pose=(0.4, 0.0, 0.2, 0.0, 0.0, math.pi / 2.0)))
    pose = axis.displaced((0.01, 0.02, 0.03, math.pi / 2.0, 0.0, 0.0))
    # A quarter about z, then one about x: the tool's axes x, y, z end on z, -x, -y. That is a third of a turn.
    third = 2.0 * math.pi / 3.0 / math.sqrt(3.0)
    assert pose == pytest.approx((0.41, 0.02, 0.23, third, -third, third))
    assert axis.displaced((0.0,) * 6) == axis.pose(0.0)


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


def test_an_arm_that_is_not_open_refuses_and_closes_in_peace() -> None:
    arm = UrArm("arm", settings(), WallClock())
    arm.apply(MoveTo("arm", 0.0, 0.01))
    (refused,) = arm.poll()
    assert isinstance(refused, Refused)
    assert refused.reason == "it is not open"
    assert not arm.read()
    arm.close()
    arm.close()
