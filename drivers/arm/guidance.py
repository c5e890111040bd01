"""How fast a tool speed may be in this cycle, so that the tool stays inside its bounds. Pure."""

import math

from drivers.arm.axis import Axis
from drivers.arm.link import ArmRow
from drivers.arm.settings import ArmSettings, Pose
from drivers.core.messages import MoveAt

CYCLE_S = 0.008
"""Time between two tool speeds: 125 Hz costs ur_rtde 0.1 ms a call, 500 Hz costs it 1.2 ms (measured)."""

SETTLE_S = 4 * CYCLE_S
"""Time constant of the last half millimetre before a limit: four cycles leave room for a late one."""

MISSED_M, MISSED_RAD = 2e-4, 5e-3
"""Distance from its target at which a move has missed it (assumption: several times the repeatability of 30 um, and
that on a wrist of 0.1 m)."""

ARRIVED_M = 5e-5
"""Distance before its limit at which a `MoveAt` has arrived: near the arm's repeatability of 30 um."""


def approach_twist(axis: Axis, goal: MoveAt, row: ArmRow, now_s: float) -> Pose | None:
    """The twist that brings the tool to its limit, or None where it is there.

    It slows down towards the limit, so that the tool comes to rest before it whatever a cycle takes.
    """
    sign = math.copysign(1.0, goal.velocity_m_s)
    left_m = sign * (goal.limit_m - axis.position_m(_ahead(row, now_s)))
    if left_m <= ARRIVED_M:
        return None
    # Half of the acceleration brakes in time; the other half is for what comes late.
    braking_m_s = math.sqrt(axis.settings.acceleration_m_s2 * left_m)
    return axis.twist(sign * min(abs(goal.velocity_m_s), braking_m_s, left_m / SETTLE_S))


def bound_ahead(axis: Axis, row: ArmRow, now_s: float) -> str:
    """Which bound a free motion runs over unless it brakes now, or ""; the way back in is free."""
    settings, here_m = axis.settings, axis.position_m(row.pose)
    braking_s = 0.5 * math.hypot(*row.twist[:3]) / settings.stop_m_s2
    ahead = _ahead(row, now_s + braking_s)
    if axis.away_m(ahead) > max(settings.leash_m, axis.away_m(row.pose)):
        return leash_end(settings)
    lowest_m, highest_m = min(settings.travel_min_m, here_m), max(settings.travel_max_m, here_m)
    return "" if lowest_m <= axis.position_m(ahead) <= highest_m else travel_end(here_m)


class FreeMotion:
    """The tool speeds of a `Twist`: from what the tool does to the twist, for a while, then to rest.

    Translation and turn change together, in the time that the slower of them needs: a tool that rolls on a table
    does not slide on it while it begins. From rest it goes as far as twist times duration: the ramp up is part of
    the duration, the ramp down comes after it.

    Args:
        start: The last twist that the controller was sent.
        goal: The twist that is asked for.
        acceleration: Greatest, m/s^2 and rad/s^2.
    """

    def __init__(
        self, start: Pose, goal: Pose, begin_s: float, duration_s: float, acceleration: float
    ) -> None:
        self._start, self._goal, self._begin_s, self._duration_s = start, goal, begin_s, duration_s
        self._up_s = _largest(_mixed(goal, start, -1.0)) / acceleration
        self._peak = self._rising(duration_s)
        self._down_s = _largest(self._peak) / acceleration

    def twist(self, t_s: float) -> Pose | None:
        """The twist that the tool shall have at `t_s`; None where the motion is over."""
        elapsed_s = t_s - self._begin_s
        if elapsed_s <= self._duration_s:
            return self._rising(elapsed_s)
        left_s = self._duration_s + self._down_s - elapsed_s
        return _scaled(self._peak, left_s / self._down_s) if left_s > 0.0 else None

    def _rising(self, elapsed_s: float) -> Pose:
        share = min(1.0, elapsed_s / self._up_s) if self._up_s > 0.0 else 1.0
        return self._goal if share == 1.0 else _mixed(_scaled(self._start, 1.0 - share), self._goal, share)


def _largest(twist: Pose) -> float:
    return max(math.hypot(*twist[:3]), math.hypot(*twist[3:]))


def _scaled(twist: Pose, factor: float) -> Pose:
    x, y, z, rx, ry, rz = (factor * part for part in twist)
    return (x, y, z, rx, ry, rz)


def _mixed(first: Pose, second: Pose, factor: float) -> Pose:
    x, y, z, rx, ry, rz = (a + factor * b for a, b in zip(first, second, strict=True))
    return (x, y, z, rx, ry, rz)


def leash_end(settings: ArmSettings) -> str:
    """Why a free motion ended at the leash."""
    return f"it is at the end of its leash of {settings.leash_m:g} m"


def travel_end(position_m: float) -> str:
    """Why a free motion ended at the travel."""
    return f"it is at the end of its travel, at {position_m:.4f} m"


def line_speed(settings: ArmSettings, length_m: float, speed: float) -> float:
    """Speed of a straight move: of the tool's point, or in rad/s where it only turns.

    Args:
        length_m: Way of the tool's point.
        speed: As asked for, m/s or rad/s.
    """
    return min(speed, settings.max_speed_m_s if length_m > MISSED_M else settings.max_turn_rad_s)


def _ahead(row: ArmRow, now_s: float) -> Pose:
    """Where the tool will be, at its present speed, when the next cycle's command acts."""
    time_s = now_s - row.arrival_s + CYCLE_S
    x, y, z = (row.pose[i] + row.twist[i] * time_s for i in range(3))
    return (x, y, z, *row.pose[3:])
