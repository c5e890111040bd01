"""The approach axis of an arm, and the geometry of its poses. Pure."""

import math
from collections.abc import Iterable, Iterator, Sequence

from drivers.arm.settings import ArmSettings, Pose

Quaternion = tuple[float, float, float, float]


class Axis:
    """The approach axis: poses ⇄ positions.

    Attributes:
        direction: Of the axis, in the base frame.
    """

    def __init__(self, settings: ArmSettings) -> None:
        self.settings = settings
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


def way(start: Pose, end: Pose) -> tuple[float, float]:
    """How far it is from one pose to another: metres, and radians of turning."""
    (a, *axis_a), (b, *axis_b) = quaternion(start[3:]), quaternion(end[3:])
    cosine = abs(a * b + sum(x * y for x, y in zip(axis_a, axis_b, strict=True)))
    return math.dist(start[:3], end[:3]), 2.0 * math.acos(min(1.0, cosine))


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
    return rotation_vector(
        (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        )
    )


def rotation_vector(unit: Quaternion) -> tuple[float, float, float]:
    """The rotation vector (rad), at most pi long, of a unit quaternion (w, x, y, z)."""
    w, x, y, z = unit
    length = math.hypot(x, y, z)
    # The quaternion and its opposite are one rotation; the one with w >= 0 turns by no more than pi.
    factor = math.copysign(2.0 * math.atan2(length, abs(w)) / length, w) if length else 0.0
    return (factor * x, factor * y, factor * z)
