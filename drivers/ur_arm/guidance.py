"""How fast a tool speed may be in this cycle, so that the tool stays inside its bounds. Pure."""

from __future__ import annotations

import math

from drivers.messages import MoveAt
from drivers.ur_arm.pipe import Row
from drivers.ur_arm.settings import Axis, Pose, UrArmSettings

CYCLE_S = 0.008
"""Time between two tool speeds: 125 Hz costs the client 0.1 ms a call, 500 Hz costs it 1.2 ms (measured)."""

SETTLE_S = 4 * CYCLE_S
"""Time constant of the last half millimetre before a limit: four cycles leave room for a late one."""

ARRIVED_M = 5e-5
"""Distance before its limit at which a `MoveAt` has arrived: near the arm's repeatability of 30 um."""


class Guidance:
    """Bounds of one arm's tool speeds.

    Args:
        settings: Of the arm.
    """

    def __init__(self, settings: UrArmSettings) -> None:
        self._settings = settings
        self._axis = Axis(settings)

    def approach(self, goal: MoveAt, row: Row, now_s: float) -> Pose | None:
        """The twist that brings the tool to its limit, or None where it is there.

        It slows down towards the limit, so that the tool comes to rest before it whatever a cycle takes.
        """
        sign = math.copysign(1.0, goal.velocity_m_s)
        left_m = sign * (goal.limit_m - self._axis.position_m(_ahead(row, now_s)))
        if left_m <= ARRIVED_M:
            return None
        speed_m_s = min(
            abs(goal.velocity_m_s),
            # Half of the acceleration brakes in time; the other half is for what comes late.
            math.sqrt(self._settings.acceleration_m_s2 * left_m),
            left_m / SETTLE_S,
        )
        return self._axis.twist(sign * speed_m_s)

    def fence(self, row: Row, now_s: float) -> str:
        """Which bound a free motion runs over unless it brakes now, or ""; the way back in is free."""
        settings, axis = self._settings, self._axis
        braking_s = 0.5 * math.hypot(*row.twist[:3]) / settings.stop_m_s2
        ahead, here_m = _ahead(row, now_s + braking_s), axis.position_m(row.pose)
        if axis.away_m(ahead) > max(settings.leash_m, axis.away_m(row.pose)):
            return f"it is at the end of its leash of {settings.leash_m:g} m"
        lowest_m, highest_m = min(settings.travel_min_m, here_m), max(settings.travel_max_m, here_m)
        if not lowest_m <= axis.position_m(ahead) <= highest_m:
            return f"it is at the end of its travel, at {here_m:.4f} m"
        return ""


def way(start: Pose, end: Pose) -> tuple[float, float]:
    """How far it is from one pose to another: metres, and radians of turning."""
    (a, *axis_a), (b, *axis_b) = _quaternion(start), _quaternion(end)
    cosine = abs(a * b + sum(x * y for x, y in zip(axis_a, axis_b, strict=True)))
    return math.dist(start[:3], end[:3]), 2.0 * math.acos(min(1.0, cosine))


def _quaternion(pose: Pose) -> tuple[float, ...]:
    angle_rad = math.hypot(*pose[3:])
    factor = math.sin(0.5 * angle_rad) / angle_rad if angle_rad else 0.0
    return (math.cos(0.5 * angle_rad), *(factor * part for part in pose[3:]))


def _ahead(row: Row, now_s: float) -> Pose:
    """Where the tool will be, at its present speed, when the next cycle's command acts."""
    time_s = now_s - row.arrival_s + CYCLE_S
    x, y, z = (row.pose[i] + row.twist[i] * time_s for i in range(3))
    return (x, y, z, *row.pose[3:])
