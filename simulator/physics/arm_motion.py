"""An arm that moves within its limits, and what its tool may touch. Pure: time comes in steps, no I/O.

The arm follows its commands exactly; what a real one adds (following error, vibration) is not modelled.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simulator.physics import arm
from simulator.physics.rigid import IDENTITY, Array, difference, displaced, pose
from simulator.physics.stage_axis import StageAxis

TOOL_SPEED_M_S = 1.5
"""Fastest tool speed before the arm stops itself (default of the e-Series safety configuration)."""

YIELD_M_S_N, YIELD_RAD_S_N_M = 0.005, 0.05
"""How fast a tool that yields goes under what is left of a force or torque (assumption: soft enough to stand still on
a plane of 100 kN/m)."""

YIELD_M_S2 = 10.0
"""Greatest acceleration of a tool that yields; rad/s^2 for a turn (assumption)."""

SERVO_RAD_S2 = 40.0
"""Greatest acceleration of a joint that follows a servo target (assumption)."""

_AT_REST: Array = np.zeros(6)

_SPEED_SLACK = 1.0 + 1e-9
"""Rounding must not trip a speed limit."""


class LimitError(RuntimeError):
    """The commanded motion exceeds a limit: the arm stops itself."""


class Surroundings(Protocol):
    """What the tool may touch."""

    def wrench(self, pose: Array, twist: Array, t_s: float) -> Sequence[float] | Array:
        """What acts on the tool, at its point, base frame, shape (6,): N and N m.

        Args:
            pose: Of the tool, shape (6,): metres and rotation vector.
            twist: Of the tool, shape (6,): m/s and rad/s.
            t_s: Time of the surroundings at the end of this cycle; it never goes back.
        """


@dataclass(frozen=True, slots=True)
class StiffPlane:
    """A level plane that pushes back upwards, without friction or damping.

    Attributes:
        height_m: Of the plane above the base's origin.
        stiffness_n_m: Force per depth (assumption: a stiff pad on a table).
    """

    height_m: float = -math.inf
    stiffness_n_m: float = 10_000.0

    def wrench(self, pose: Array, twist: Array, t_s: float) -> Array:
        """See `Surroundings.wrench`."""
        depth_m = max(0.0, self.height_m - float(pose[2]))
        return np.array([0.0, 0.0, self.stiffness_n_m * depth_m, 0.0, 0.0, 0.0])


class ArmMotion(ABC):
    """One thing that the arm is doing; `done` when there is nothing left of it."""

    done = False

    @abstractmethod
    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """The joints (6,) and the tool's transform (4, 4) after `dt_s`."""


class Arm:
    """A UR5e.

    Args:
        joints_rad: Where it starts, shape (6,), at rest.

    Attributes:
        joints_rad: Shape (6,).
        joint_speeds_rad_s: Shape (6,).
        joint_accelerations_rad_s2: Shape (6,), over the last step.
        tool: Transform of the tool's point in the flange's frame, (4, 4).
        transform: Of the tool in the base, (4, 4).
        twist: Of the tool, base frame, shape (6,): m/s and rad/s.
        scaling: How fast the motion's time passes, 0 to 1.
        planned_speeds_rad_s: Of the joints, in the motion's time.
        planned_twist: Of the tool, in the motion's time.
    """

    def __init__(self, joints_rad: Sequence[float]) -> None:
        self.joints_rad = np.array(joints_rad, dtype=np.float64)
        self.tool = IDENTITY
        self.transform = arm.forward(self.joints_rad)
        self.scaling = 1.0
        self.motion: ArmMotion = Still()
        self.joint_speeds_rad_s = self.planned_speeds_rad_s = self.joint_accelerations_rad_s2 = _AT_REST
        self.twist = self.planned_twist = _AT_REST

    @property
    def pose(self) -> Array:
        """Of the tool in the base, shape (6,)."""
        return pose(self.transform)

    @property
    def resting(self) -> bool:
        """Whether nothing moves."""
        return not (self.planned_speeds_rad_s.any() or self.planned_twist.any())

    def mount(self, tool: Array) -> None:
        """Take another point as the tool's.

        Raises:
            ValueError: it is not finite.
        """
        if not np.isfinite(tool).all():
            raise ValueError("a tool's point that is not finite")
        self.tool = tool
        self.transform = arm.forward(self.joints_rad, tool)

    def step(self, dt_s: float) -> None:
        """Go on for `dt_s`.

        Raises:
            LimitError: the step would break a limit of the arm. It has not been made, and the arm stands.
        """
        if self.resting and self.motion.done:
            self.joint_accelerations_rad_s2 = _AT_REST
            return
        paced_s = dt_s * self.scaling
        if paced_s == 0.0:
            self._take(_AT_REST, _AT_REST, dt_s)
            return
        try:
            joints, transform = self.motion.advance(self, paced_s)
            speeds = (joints - self.joints_rad) / paced_s
            twist = difference(self.transform, transform) / paced_s
            _check(joints, speeds * self.scaling, twist * self.scaling)
        except (arm.UnreachableError, LimitError) as error:
            self.planned_speeds_rad_s = self.planned_twist = _AT_REST
            self._take(_AT_REST, _AT_REST, dt_s)
            self.motion = Still()
            raise LimitError(str(error)) from error
        self.joints_rad, self.transform = joints, transform
        self.planned_speeds_rad_s, self.planned_twist = speeds, twist
        self._take(speeds * self.scaling, twist * self.scaling, dt_s)

    def brake(self, deceleration_m_s2: float) -> None:
        """Come to rest from the present speed, whatever the pace was."""
        self.planned_speeds_rad_s, self.planned_twist = self.joint_speeds_rad_s, self.twist
        self.scaling = 1.0
        self.motion = ToolSpeed(np.zeros(6), deceleration_m_s2)

    def _take(self, speeds_rad_s: Array, twist: Array, dt_s: float) -> None:
        self.joint_accelerations_rad_s2 = (speeds_rad_s - self.joint_speeds_rad_s) / dt_s
        self.joint_speeds_rad_s, self.twist = speeds_rad_s, twist


def _check(joints: Array, speeds: Array, twist: Array) -> None:
    if not _within(joints, arm.JOINT_LIMIT_RAD):
        raise LimitError("a joint is at its limit")
    if not _within(speeds, arm.JOINT_SPEED_RAD_S * _SPEED_SLACK):
        raise LimitError("a joint is too fast")
    if not _length(twist[:3]) <= TOOL_SPEED_M_S * _SPEED_SLACK:
        raise LimitError("the tool is too fast")


def _within(values: Array, limit: float) -> bool:
    """Whether none is beyond a limit; what is not a number is."""
    return all(abs(value) <= limit for value in values.tolist())


def _length(vector: Array) -> float:
    # of three numbers: numpy takes ten times as long
    return math.hypot(*vector.tolist())


class Still(ArmMotion):
    """Stands where it is."""

    done = True

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        return state.joints_rad, state.transform


class ToolSpeed(ArmMotion):
    """Brings the tool to a twist and keeps it there (`speedl`; `stopl` with a twist of zero).

    Args:
        twist: Shape (6,): m/s and rad/s, base frame.
        acceleration_m_s2: For the translation, and in rad/s^2 for the rotation (the manual's default).
    """

    def __init__(self, twist: Sequence[float] | Array, acceleration_m_s2: float) -> None:
        self._target = np.array(twist, dtype=np.float64)
        self._acceleration = _positive("acceleration", acceleration_m_s2)

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        twist = _toward(self._target, state.planned_twist, self._acceleration * dt_s)
        self.done = not twist.any() and not self._target.any()
        return _driven(state, twist, dt_s)


class JointSpeed(ArmMotion):
    """Brings the joints to speeds and keeps them there (`speedj`; `stopj` with zeros).

    Args:
        speeds_rad_s: Shape (6,).
        acceleration_rad_s2: Of the joint that changes most.
    """

    def __init__(self, speeds_rad_s: Sequence[float] | Array, acceleration_rad_s2: float) -> None:
        self._target = np.array(speeds_rad_s, dtype=np.float64)
        self._acceleration = _positive("acceleration", acceleration_rad_s2)

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        change = self._target - state.planned_speeds_rad_s
        speeds = state.planned_speeds_rad_s + change * _share(
            float(np.abs(change).max()), self._acceleration * dt_s
        )
        joints = state.joints_rad + speeds * dt_s
        self.done = not speeds.any() and not self._target.any()
        return joints, arm.forward(joints, state.tool)


class JointServo(ArmMotion):
    """Follows a continuously updated target (`servoj`).

    Args:
        target_rad: Shape (6,).
        lookahead_s: Time constant with which the joints approach them.
    """

    def __init__(self, target_rad: Sequence[float] | Array, lookahead_s: float) -> None:
        self._target = np.array(target_rad, dtype=np.float64)
        self._lookahead_s = _positive("lookahead time", lookahead_s)

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        left = self._target - state.joints_rad
        # no faster than it can brake on the way that is left
        fastest = np.minimum(np.sqrt(2.0 * SERVO_RAD_S2 * np.abs(left)), arm.JOINT_SPEED_RAD_S)
        wanted = np.clip(left / max(self._lookahead_s, dt_s), -fastest, fastest)
        change = np.clip(wanted - state.planned_speeds_rad_s, -SERVO_RAD_S2 * dt_s, SERVO_RAD_S2 * dt_s)
        joints = state.joints_rad + (state.planned_speeds_rad_s + change) * dt_s
        return joints, arm.forward(joints, state.tool)


class Yielding(ArmMotion):
    """Gives way to what acts on the tool, up to a commanded wrench (`force_mode`, `freedrive_mode`).

    Args:
        frame: Orientation of the axes in the base, (3, 3).
        free: Along and about which axes it gives way, shape (6,).
        wrench: What the tool shall push with along those, shape (6,): N and N m; zeros let it be led by hand.
        fastest: Shape (6,): m/s and rad/s.
        felt: What acts on the tool, base frame, shape (6,).
        gain: Of the usual speed under a force.
    """

    def __init__(
        self,
        frame: Array,
        free: Sequence[bool],
        wrench: Sequence[float] | Array,
        fastest: Sequence[float] | Array,
        felt: Callable[[], Array],
        gain: float = 1.0,
    ) -> None:
        self._turn = frame
        self._wrench = np.array(wrench, dtype=np.float64)
        self._fastest = np.where(free, np.abs(fastest), 0.0)
        self._felt = felt
        self._speeds = gain * np.array([YIELD_M_S_N] * 3 + [YIELD_RAD_S_N_M] * 3, dtype=np.float64)

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        left = self._wrench + (self._felt().reshape(2, 3) @ self._turn).ravel()
        wanted = np.clip(self._speeds * left, -self._fastest, self._fastest).reshape(2, 3) @ self._turn.T
        return _driven(state, _toward(wanted.ravel(), state.planned_twist, YIELD_M_S2 * dt_s), dt_s)


class _Travel(ArmMotion):
    """A move between two places of rest; what still moves when it begins is stopped first."""

    def __init__(self, speed: float, acceleration: float) -> None:
        self._speed = _positive("speed", speed)
        self._acceleration = _positive("acceleration", acceleration)
        self._elapsed_s = 0.0
        self._profile: StageAxis | None = None

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        if self._profile is None:
            if not state.resting:
                return self._brake(state, dt_s)
            self._profile = StageAxis(acceleration_m_s2=self._acceleration, max_speed_m_s=self._speed)
            self._profile.move_to(0.0, self._begin(state), self._speed)
        self._elapsed_s += dt_s
        left_s = self._profile.arrival_s - self._elapsed_s
        self.done = left_s <= -dt_s  # the step that ends at rest comes after the last one that moved
        share = 1.0 if left_s <= 0.0 else self._profile.position(self._elapsed_s) / self._profile.target_m
        return self._at(state, share)

    @abstractmethod
    def _brake(self, state: Arm, dt_s: float) -> tuple[Array, Array]: ...

    @abstractmethod
    def _begin(self, state: Arm) -> float:
        """Take the start from `state`; the length of the way."""

    @abstractmethod
    def _at(self, state: Arm, share: float) -> tuple[Array, Array]: ...


class ToolMove(_Travel):
    """Carries the tool along a line (`movel`).

    Args:
        target: Transform of the tool, (4, 4).
        speed_m_s: Of translation; of rotation in rad/s where that is the longer way (assumption).
        acceleration_m_s2: Likewise.
    """

    def __init__(self, target: Array, speed_m_s: float, acceleration_m_s2: float) -> None:
        super().__init__(speed_m_s, acceleration_m_s2)
        self._target = target
        self._start = self._way = target

    def _brake(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        return ToolSpeed(np.zeros(6), self._acceleration).advance(state, dt_s)

    def _begin(self, state: Arm) -> float:
        self._start = state.transform
        self._way = difference(self._start, self._target)
        return max(float(np.linalg.norm(self._way[:3])), float(np.linalg.norm(self._way[3:])))

    def _at(self, state: Arm, share: float) -> tuple[Array, Array]:
        transform = displaced(self._start, self._way * share)
        return arm.track(state.joints_rad, transform, state.tool), transform


class JointMove(_Travel):
    """Carries the joints to angles, all arriving together (`movej`).

    Args:
        target_rad: Shape (6,).
        speed_rad_s: Of the joint that has farthest to go.
        acceleration_rad_s2: Likewise.
    """

    def __init__(
        self, target_rad: Sequence[float] | Array, speed_rad_s: float, acceleration_rad_s2: float
    ) -> None:
        super().__init__(speed_rad_s, acceleration_rad_s2)
        self._target = np.array(target_rad, dtype=np.float64)
        self._start = self._target

    def _brake(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        return JointSpeed(np.zeros(arm.JOINTS), self._acceleration).advance(state, dt_s)

    def _begin(self, state: Arm) -> float:
        self._start = state.joints_rad
        return float(np.abs(self._target - self._start).max())

    def _at(self, state: Arm, share: float) -> tuple[Array, Array]:
        joints = self._start + (self._target - self._start) * share
        return joints, arm.forward(joints, state.tool)


def _share(wanted: float, allowed: float) -> float:
    return 1.0 if wanted <= allowed else allowed / wanted


def _positive(what: str, value: float) -> float:
    if not 0.0 < value < math.inf:
        raise ValueError(f"{what} {value} is not positive and finite")
    return value


def _toward(target: Array, twist: Array, most: float) -> Array:
    """A twist that comes closer to another: translation and turn change by at most so much each."""
    change = target - twist
    for part in (slice(0, 3), slice(3, 6)):
        change[part] *= _share(_length(change[part]), most)
    return twist + change


def _driven(state: Arm, twist: Array, dt_s: float) -> tuple[Array, Array]:
    transform = displaced(state.transform, twist * dt_s)
    return arm.track(state.joints_rad, transform, state.tool), transform
