"""An arm that moves within its limits, and what its tool may touch. Pure: time comes in steps, no I/O.

The arm follows its commands exactly; what a real one adds (following error, vibration) is not modelled.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

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

LED_M_S, LED_RAD_S = 0.25, 1.0
"""How fast an arm can be led by hand (assumption)."""

_AT_REST: Array = np.zeros(6)

_SPEED_SLACK = 1.0 + 1e-9
"""Rounding must not trip a speed limit."""


class LimitError(RuntimeError):
    """The commanded motion exceeds a limit: the arm stops itself."""


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
    """

    def __init__(self, joints_rad: Sequence[float] | Array) -> None:
        self.joints_rad = np.array(joints_rad, dtype=np.float64)
        self.tool = IDENTITY
        self.transform = arm.forward(self.joints_rad)
        self.motion: ArmMotion | None = None
        self.joint_speeds_rad_s = self.joint_accelerations_rad_s2 = self.twist = _AT_REST

    @property
    def pose(self) -> Array:
        """Of the tool in the base, shape (6,)."""
        return pose(self.transform)

    @property
    def resting(self) -> bool:
        """Whether nothing moves."""
        return not (self.joint_speeds_rad_s.any() or self.twist.any())

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
        if self.motion is None or (self.resting and self.motion.done):
            self.joint_accelerations_rad_s2 = _AT_REST
            return
        try:
            joints, transform = self.motion.advance(self, dt_s)
            speeds = (joints - self.joints_rad) / dt_s
            twist = difference(self.transform, transform) / dt_s
            _check(joints, speeds, twist)
        except (arm.UnreachableError, LimitError) as error:
            self._take(_AT_REST, _AT_REST, dt_s)
            self.motion = None
            raise LimitError(str(error)) from error
        self.joints_rad, self.transform = joints, transform
        self._take(speeds, twist, dt_s)

    def brake(self, deceleration_m_s2: float) -> None:
        """Come to rest from the present speed."""
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
        twist = _toward(self._target, state.twist, self._acceleration * dt_s)
        self.done = not twist.any() and not self._target.any()
        return _driven(state, twist, dt_s)


class Yielding(ArmMotion):
    """Gives way to what acts on the tool: led by hand (`freedrive_mode`, `teach_mode`).

    Args:
        felt: What acts on the tool, base frame, shape (6,): N and N m.
    """

    def __init__(self, felt: Callable[[], Array]) -> None:
        self._felt = felt

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        speeds, fastest = np.repeat([(YIELD_M_S_N, YIELD_RAD_S_N_M), (LED_M_S, LED_RAD_S)], 3, axis=1)
        wanted = np.clip(speeds * self._felt(), -fastest, fastest)
        return _driven(state, _toward(wanted, state.twist, YIELD_M_S2 * dt_s), dt_s)


class ToolMove(ArmMotion):
    """Carries the tool along a line (`movel`) between two places of rest; what still moves when it begins stops first.

    Args:
        target: Transform of the tool, (4, 4).
        speed_m_s: Of translation; of rotation in rad/s where that is the longer way (assumption).
        acceleration_m_s2: Likewise.
    """

    def __init__(self, target: Array, speed_m_s: float, acceleration_m_s2: float) -> None:
        self._speed = _positive("speed", speed_m_s)
        self._acceleration = _positive("acceleration", acceleration_m_s2)
        self._elapsed_s = 0.0
        self._profile: StageAxis | None = None
        self._target = target
        self._start = self._way = target

    def advance(self, state: Arm, dt_s: float) -> tuple[Array, Array]:
        """See `ArmMotion.advance`."""
        if self._profile is None:
            if not state.resting:
                return ToolSpeed(np.zeros(6), self._acceleration).advance(state, dt_s)
            self._start = state.transform
            self._way = difference(self._start, self._target)
            length = max(float(np.linalg.norm(self._way[:3])), float(np.linalg.norm(self._way[3:])))
            self._profile = StageAxis(acceleration_m_s2=self._acceleration, max_speed_m_s=self._speed)
            self._profile.move_to(0.0, length, self._speed)
        self._elapsed_s += dt_s
        left_s = self._profile.arrival_s - self._elapsed_s
        self.done = left_s <= -dt_s  # the step that ends at rest comes after the last one that moved
        share = 1.0 if left_s <= 0.0 else self._profile.position(self._elapsed_s) / self._profile.target_m
        transform = displaced(self._start, self._way * share)
        return arm.track(state.joints_rad, transform, state.tool), transform


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
