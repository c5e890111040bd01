"""What the arm is, where it starts, and how far and fast it may go."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from drivers.settings import Settings

Vector = Annotated[tuple[float, float, float], Strict(False)]
Pose = Annotated[tuple[float, float, float, float, float, float], Strict(False)]
Quaternion = tuple[float, float, float, float]

UNIT_TOLERANCE = 1e-3
"""How far the length of a direction may be from 1 (assumption: three digits in a profile)."""


class UrArmSettings(Settings):
    """A UR arm on its controller.

    Poses are those of the tool's point in the base frame: x, y, z in metres and a rotation vector in radians, as
    the pendant shows them. Positions are on the approach axis, which grows towards the object: its zero is
    `start_pose`, its direction `approach_axis`.
    """

    host: str = Field(min_length=1)
    """Address of the controller."""
    start_pose: Pose
    """Where an approach begins, and where `Home` goes; moves on the axis keep its orientation."""
    approach_axis: Vector = (0.0, 0.0, -1.0)
    """Unit vector in the base frame towards the object (assumption: a table under the arm)."""
    travel_min_m: float = Field(-0.05, ge=-1.0, le=1.0)
    """Least position in metres, kept in the arm's process."""
    travel_max_m: float = Field(0.05, ge=-1.0, le=1.0)
    """Greatest position in metres, kept in the arm's process."""
    leash_m: float = Field(0.2, gt=0.0, le=1.0)
    """How far from `start_pose` a `Twist` may carry the tool, and from how far `Home` sets out (assumption)."""
    max_speed_m_s: float = Field(0.05, gt=0.0, le=0.25)
    """Greatest speed of the tool; above 0.25 m/s a collaborative arm asks for a risk assessment (ISO 10218-1)."""
    max_turn_rad_s: float = Field(0.5, gt=0.0, le=3.0)
    """Greatest angular speed of the tool (assumption)."""
    home_speed_m_s: float = Field(0.02, gt=0.0, le=0.25)
    """Speed of `Home` (assumption)."""
    acceleration_m_s2: float = Field(0.5, gt=0.0, le=5.0)
    """Acceleration of every motion; rad/s^2 for rotation (assumption: under half of the controller's 1.2)."""
    stop_m_s2: float = Field(3.0, gt=0.0, le=20.0)
    """Deceleration of a `Stop` (the client's own script stops at 3 m/s^2 after a contact)."""
    watchdog_hz: float = Field(10.0, ge=5.0, le=50.0)
    """The controller stops the program when commands come more rarely (client: 10 Hz)."""
    link_timeout_s: float = Field(0.1, ge=0.05, le=1.0)
    """How long the controller's time may stand still before the link counts as lost (measured: 50-100 ms)."""
    loop_timeout_s: float = Field(0.5, ge=0.05, le=5.0)
    """How long the program may not look at an arm that moves before the arm's process stops it. Assumption: more than
    the guard's bound on a late loop (`limits.late_s`, at most 0.3 s in the profiles), so that the guard acts first."""
    open_timeout_s: float = Field(12.0, ge=1.0, le=60.0)
    """Longest connection; the client itself waits 5 s for its script to run."""
    reconnect_s: float = Field(6.0, ge=0.0, le=60.0)
    """How long a lost link is tried again before the device has failed; 0 does not try (assumption)."""
    recover_s: float = Field(10.0, ge=1.0, le=60.0)
    """Longest recovery at `Home`; a protective stop stays locked for 5 s (dashboard manual)."""
    realtime_priority: int = Field(10, ge=0, le=90)
    """SCHED_FIFO priority of the arm's process where the system allows it; 0 does not ask."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.travel_min_m < self.travel_max_m:
            raise ValueError(
                f"travel_min_m = {self.travel_min_m} is not below travel_max_m = {self.travel_max_m}"
            )
        if abs(math.hypot(*self.approach_axis) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"approach_axis has length {math.hypot(*self.approach_axis):.4g}, not 1")
        return self


class Axis:
    """The approach axis: poses ⇄ positions.

    Args:
        settings: Of the arm.
    """

    def __init__(self, settings: UrArmSettings) -> None:
        length = math.hypot(*settings.approach_axis)
        self.direction = tuple(part / length for part in settings.approach_axis)
        self._start = settings.start_pose

    def position_m(self, pose: Pose) -> float:
        """Position of a pose on the axis; what is beside the axis does not count."""
        return sum((pose[i] - self._start[i]) * self.direction[i] for i in range(3))

    def pose(self, position_m: float) -> Pose:
        """The pose at a position, with the start's orientation."""
        x, y, z = (self._start[i] + position_m * self.direction[i] for i in range(3))
        return (x, y, z, *self._start[3:])

    def displaced(self, offset: Pose) -> Pose:
        """The start pose moved by an offset: metres along base axes, then a rotation vector, base frame, rad."""
        x, y, z = (self._start[i] + offset[i] for i in range(3))
        turn, start = (offset[3], offset[4], offset[5]), (self._start[3], self._start[4], self._start[5])
        return (x, y, z, *(turned(turn, start) if any(turn) else start))

    def twist(self, velocity_m_s: float) -> Pose:
        """The twist of a velocity along the axis."""
        x, y, z = (velocity_m_s * part for part in self.direction)
        return (x, y, z, 0.0, 0.0, 0.0)

    def away_m(self, pose: Pose) -> float:
        """Distance of a pose from the start, in any direction."""
        return math.dist(pose[:3], self._start[:3])


def quaternion(rotation_rad: Sequence[float]) -> Quaternion:
    """The unit quaternion (w, x, y, z) of a rotation vector."""
    angle_rad = math.hypot(*rotation_rad)
    factor = math.sin(0.5 * angle_rad) / angle_rad if angle_rad else 0.0
    x, y, z = (factor * part for part in rotation_rad)
    return (math.cos(0.5 * angle_rad), x, y, z)


def turned(turn: Sequence[float], rotation_rad: Sequence[float]) -> tuple[float, float, float]:
    """The rotation vector, at most pi long, of a rotation (second) that is turned further (first), in one frame."""
    return next(turned_by((turn,), rotation_rad))


def turned_by(
    turns: Iterable[Sequence[float]], rotation_rad: Sequence[float]
) -> Iterator[tuple[float, float, float]]:
    """The same for each of some turns, all of one rotation."""
    start = quaternion(rotation_rad)
    for turn in turns:
        yield _product(quaternion(turn), start)


def _product(turn: Quaternion, start: Quaternion) -> tuple[float, float, float]:
    (a, b, c, d), (e, f, g, h) = turn, start
    w = a * e - b * f - c * g - d * h
    x = a * f + b * e + c * h - d * g
    y = a * g - b * h + c * e + d * f
    z = a * h + b * g - c * f + d * e
    length = math.hypot(x, y, z)
    # The quaternion and its opposite are one rotation; the one with w >= 0 turns by no more than pi.
    factor = math.copysign(2.0 * math.atan2(length, abs(w)) / length, w) if length else 0.0
    return (factor * x, factor * y, factor * z)
