"""The Franka link's half that needs no robot, with the real library's types; what moves: tests/franka_moves.py."""

from types import SimpleNamespace
from typing import Any

import franky
import numpy as np
import pytest
from pydantic import ValidationError

from drivers.arm.link import LinkError
from drivers.core.clock import WallClock
from drivers.core.errors import PortError
from drivers.franka_arm.link import FrankaLink
from drivers.franka_arm.settings import FrankaArmSettings

POSE = (0.5, 0.1, 0.4, 1.2, -2.0, 0.3)


class Robot:
    """What the link asks of a robot, at rest; what it is told to do is kept."""

    def __init__(self) -> None:
        self.motions: list[Any] = []
        self.is_in_control = False
        self.translation_velocity_limit = SimpleNamespace(get=lambda: 1.7)
        self.rotation_velocity_limit = SimpleNamespace(get=lambda: 2.5)
        self.translation_acceleration_limit = SimpleNamespace(get=lambda: 13.0)
        self.model = SimpleNamespace(zero_jacobian=lambda frame, state: np.eye(6, 7))
        self.ms = 0
        self.mode = "Idle"

    @property
    def state(self) -> Any:
        return SimpleNamespace(
            time=franky.Duration(self.ms),
            dq=np.arange(7.0),
            robot_mode=SimpleNamespace(name=self.mode),
            last_motion_errors="[cartesian_reflex]",
            O_F_ext_hat_K=np.arange(6.0),
            O_T_EE=franky.Affine(np.array(POSE[:3]), _xyzw(POSE[3:])),
        )

    def move(self, motion: Any, asynchronous: bool) -> None:
        assert asynchronous, "a call that waits for the motion's end would hold the control thread"
        self.motions.append(motion)

    def join_motion(self, timeout: float) -> bool:
        assert timeout < 0.1
        return not self.is_in_control


def _xyzw(rotation_rad: tuple[float, ...]) -> Any:
    angle = np.linalg.norm(rotation_rad)
    return np.array([*(np.sin(angle / 2) * np.array(rotation_rad) / angle), np.cos(angle / 2)])


def settings(**changes: Any) -> FrankaArmSettings:
    return FrankaArmSettings.model_validate({"host": "127.0.0.1", "start_pose": POSE, **changes})


@pytest.fixture
def link() -> FrankaLink:
    made = FrankaLink(settings(rate_hz=500.0), WallClock())
    made._franky, made._robot = franky, Robot()
    return made


def test_a_row_has_the_pose_as_a_rotation_vector_the_measured_twist_and_the_force_less_the_tare(
    link: FrankaLink,
) -> None:
    row = link.read()
    assert row is not None
    assert row.pose == pytest.approx(POSE)
    assert row.twist == (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
    assert row.force == (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
    assert link.tare()
    link._robot.ms = 2
    after = link.read()
    assert after is not None and after.force == (0.0,) * 6
    assert (row.device_s, after.device_s) == (0.0, 0.002)


def test_at_half_the_rate_every_second_cycle_is_a_row(link: FrankaLink) -> None:
    rows = []
    for link._robot.ms in range(8):
        rows.append(link.read())
    assert [row is not None for row in rows] == [True, False] * 4


@pytest.mark.parametrize(
    ("mode", "why"), [("Reflex", "reflex"), ("UserStopped", "user stop"), ("Guiding", "hand")]
)
def test_a_robot_that_will_not_move_says_why(link: FrankaLink, mode: str, why: str) -> None:
    link._robot.mode = mode
    row = link.read()
    assert row is not None
    assert why in row.fault and "cartesian_reflex" in row.fault
    assert not row.running
    assert not link.feed_watchdog()


def test_a_move_goes_to_the_pose_at_the_speed_that_was_asked_for(link: FrankaLink) -> None:
    link.read()
    assert link.move((0.6, *POSE[1:]), 0.17, 1.3)
    (motion,) = link._robot.motions
    assert motion.reference_type == franky.ReferenceType.Absolute
    assert motion.target.pose.end_effector_pose.translation == pytest.approx((0.6, 0.1, 0.4))
    # a quaternion and its opposite are one rotation
    assert abs(motion.target.pose.end_effector_pose.quaternion @ _xyzw(POSE[3:])) == pytest.approx(1.0)
    factor = motion.relative_dynamics_factor
    assert (factor.velocity, factor.acceleration) == pytest.approx((0.1, 0.1))


@pytest.mark.parametrize(
    ("to", "share"),
    [
        ((0.6, 0.1, 0.4, 1.2, -2.0, 0.3), 0.5 / 1.7),
        ((0.5, 0.1, 0.4, 1.2, -2.0, 0.9), 0.5 / 2.5),
        ((0.6, 0.1, 0.4, 1.2, -2.0, 0.9), 0.5 / 2.5),
        (POSE, 0.5 / 1.7),
    ],
    ids=["goes", "turns", "both", "stays"],
)
def test_what_turns_is_no_faster_than_the_same_number_of_radians(
    link: FrankaLink, to: tuple[float, ...], share: float
) -> None:
    """0.5 m/s or rad/s of a Panda's 1.7 m/s and 2.5 rad/s, both of which franky scales by one factor."""
    link.read()
    assert link.move(to, 0.5, 1.3)  # type: ignore[arg-type]
    assert link._robot.motions[-1].relative_dynamics_factor.velocity == pytest.approx(share)


def test_a_move_waits_for_tool_speeds_to_end_and_is_refused_where_they_do_not(link: FrankaLink) -> None:
    link._robot.is_in_control = True
    assert not link.move(POSE, 0.1, 1.0)
    assert link._robot.motions == []


def test_a_tool_speed_ends_by_itself_without_a_newer_one(link: FrankaLink) -> None:
    assert link.speed((0.01, 0.0, 0.0, 0.0, 0.0, 0.2), 0.5)
    (motion,) = link._robot.motions
    assert motion.target.end_effector_twist.linear == pytest.approx([0.01, 0.0, 0.0])
    assert motion.target.end_effector_twist.angular == pytest.approx([0.0, 0.0, 0.2])
    assert motion.duration.to_msec() <= 100


def test_nothing_at_the_address_is_a_port_that_does_not_answer() -> None:
    link = FrankaLink(settings(host="127.0.0.9", enforce_realtime=False), WallClock())
    with pytest.raises(LinkError) as raised:
        link.open(again=False)
    assert raised.value.kind is PortError
    assert "127.0.0.9" in raised.value.reason


def test_a_rate_that_is_no_whole_part_of_the_cycles_is_refused() -> None:
    with pytest.raises(ValidationError, match="rate_hz"):
        settings(rate_hz=300.0)
