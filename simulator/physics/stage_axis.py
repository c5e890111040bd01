"""Motion of one axis: trapezoidal speed profiles in closed form, without a clock."""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

HISTORY_PIECES = 64
"""Pieces remembered, present plan included: the last dozen commands (at most 5 pieces each)."""

STAGE_M_S2 = 0.5
"""Acceleration of the bench's stage. Assumption: 12 mm/s in 24 ms, ordinary for a small lead-screw stage."""

STAGE_HOME_M_S = 0.02
"""Speed at which the bench's stage goes home (assumption)."""

STAGE_M_S = 0.026
"""Fastest speed of the bench's stage. Assumption: a small lead-screw stage."""


SANE = 1e6
"""No bench has a place, a speed, an acceleration, a frequency or a time larger than this, in SI units."""


class MotionPiece(NamedTuple):
    """Motion of constant acceleration, from its start until the next piece begins."""

    t_start_s: float
    position_m: float
    velocity_m_s: float
    acceleration_m_s2: float

    def position(self, t_s: float) -> float:
        """Position in metres at `t_s`."""
        elapsed_s = t_s - self.t_start_s
        return self.position_m + elapsed_s * (self.velocity_m_s + 0.5 * self.acceleration_m_s2 * elapsed_s)

    def velocity(self, t_s: float) -> float:
        """Velocity in m/s at `t_s`."""
        return self.velocity_m_s + self.acceleration_m_s2 * (t_s - self.t_start_s)


class AxisMotion:
    """How something moves along one axis: pieces, with a memory of the last dozen changes.

    Changes come in order of time; the motion before the last of them is still available.

    Args:
        t_s: The earliest time that will be requested.
        position_m: Where it stands until the first change.
    """

    def __init__(self, t_s: float = 0.0, position_m: float = 0.0) -> None:
        self._pieces: deque[MotionPiece] = deque(maxlen=HISTORY_PIECES)
        self.place(t_s, position_m)

    @property
    def arrival_s(self) -> float:
        """Time from which the last piece holds."""
        return self._pieces[-1].t_start_s

    @property
    def target_m(self) -> float:
        """Where the last piece begins."""
        return self._pieces[-1].position_m

    def place(self, t_s: float, position_m: float) -> None:
        """Stand still at a position from `t_s` on, and forget what was before: a new trial, a new zero."""
        self._pieces.clear()
        self._pieces.append(MotionPiece(t_s, sane("position_m", position_m), 0.0, 0.0))

    def replace(self, t_s: float, plan: Sequence[MotionPiece]) -> None:
        """Move by these pieces from `t_s` on, where the first of them begins."""
        while self._pieces and self._pieces[-1].t_start_s >= t_s:
            self._pieces.pop()
        self._pieces.extend(plan)

    def position(self, t_s: float) -> float:
        """Position in metres."""
        return self._piece(t_s).position(t_s)

    def velocity(self, t_s: float) -> float:
        """Velocity in m/s."""
        return self._piece(t_s).velocity(t_s)

    def pieces(self, t_s: float) -> list[MotionPiece]:
        """The motion from `t_s` on: the first piece starts at `t_s`, the last holds for ever."""
        present = self._piece(t_s)
        first = MotionPiece(t_s, present.position(t_s), present.velocity(t_s), present.acceleration_m_s2)
        return [first, *(piece for piece in self._pieces if piece.t_start_s > t_s)]

    def _piece(self, t_s: float) -> MotionPiece:
        for piece in reversed(self._pieces):
            if piece.t_start_s <= t_s:
                return piece
        raise ValueError(f"t_s = {t_s!r} is before the motion that is remembered")


class StageAxis(AxisMotion):
    """An axis that accelerates at a fixed rate, cruises, brakes, and stands exactly on its target.

    A command replaces the plan from its time on; the axis keeps position and velocity through it.

    Args:
        acceleration_m_s2: Magnitude of every acceleration and braking.
        max_speed_m_s: No command makes it faster.
        position_m: Where it stands until the first command.
        t_s: The earliest time that will be requested.
    """

    def __init__(
        self, *, acceleration_m_s2: float, max_speed_m_s: float, position_m: float = 0.0, t_s: float = 0.0
    ) -> None:
        super().__init__(t_s, position_m)
        self.acceleration_m_s2 = _positive("acceleration_m_s2", acceleration_m_s2)
        self.max_speed_m_s = _positive("max_speed_m_s", max_speed_m_s)

    def move_to(self, t_s: float, target_m: float, speed_m_s: float) -> None:
        """Go to a target at a speed; it brakes first where it is too fast or goes the other way."""
        sane("target_m", target_m)
        speed_m_s = min(_positive("speed_m_s", speed_m_s), self.max_speed_m_s)
        self.replace(t_s, _trapezoid(self._start(t_s), target_m, speed_m_s, self.acceleration_m_s2))

    def move_at(self, t_s: float, velocity_m_s: float, limit_m: float) -> None:
        """Go at a signed velocity as far as the limit, and stand there; one already beyond it stops."""
        _positive("velocity_m_s", abs(velocity_m_s))
        ahead_m = (sane("limit_m", limit_m) - self.position(t_s)) * math.copysign(1.0, velocity_m_s)
        if ahead_m < 0.0:
            self.stop(t_s)
        else:
            self.move_to(t_s, limit_m, abs(velocity_m_s))

    def stop(self, t_s: float, deceleration_m_s2: float | None = None) -> None:
        """Brake to a standstill, at the axis's own rate or at another."""
        slowing = self.acceleration_m_s2 if deceleration_m_s2 is None else deceleration_m_s2
        self.replace(t_s, _brake(self._start(t_s), slowing))

    def stall(self, t_s: float) -> None:
        """Stand still at once, wherever it is: a motor that has lost its way."""
        self.replace(t_s, [MotionPiece(t_s, self.position(t_s), 0.0, 0.0)])

    def moving(self, t_s: float) -> bool:
        """True until the present plan stands still."""
        return t_s < self.arrival_s

    def _start(self, t_s: float) -> MotionPiece:
        piece = self._piece(t_s)
        return MotionPiece(t_s, piece.position(t_s), piece.velocity(t_s), 0.0)


def _trapezoid(
    start: MotionPiece, target_m: float, speed_m_s: float, acceleration_m_s2: float
) -> list[MotionPiece]:
    """Pieces from a start (its acceleration is not used) to a standstill on the target."""
    distance_m = abs(target_m - start.position_m)
    towards = math.copysign(1.0, target_m - start.position_m)
    along_m_s = start.velocity_m_s * towards
    if along_m_s < 0.0 or along_m_s**2 > 2.0 * acceleration_m_s2 * distance_m:
        *braking, rest = _brake(start, acceleration_m_s2)
        return [*braking, *_trapezoid(rest, target_m, speed_m_s, acceleration_m_s2)]
    peak_m_s = min(speed_m_s, math.sqrt(acceleration_m_s2 * distance_m + 0.5 * along_m_s**2))
    change_m = abs(peak_m_s**2 - along_m_s**2) / (2.0 * acceleration_m_s2)
    cruise_m = distance_m - change_m - peak_m_s**2 / (2.0 * acceleration_m_s2)
    accelerating = math.copysign(acceleration_m_s2, peak_m_s - along_m_s)
    phases = [
        (abs(peak_m_s - along_m_s) / acceleration_m_s2, accelerating),
        (max(0.0, cruise_m) / peak_m_s if peak_m_s > 0.0 else 0.0, 0.0),
        (peak_m_s / acceleration_m_s2, -acceleration_m_s2),
    ]
    return _chain(start, [(s, towards * a) for s, a in phases], target_m)


def _brake(start: MotionPiece, acceleration_m_s2: float) -> list[MotionPiece]:
    """Pieces from a start to a standstill."""
    slowing = -math.copysign(acceleration_m_s2, start.velocity_m_s)
    end_m = start.position_m - 0.5 * start.velocity_m_s**2 / slowing
    return _chain(start, [(abs(start.velocity_m_s) / acceleration_m_s2, slowing)], end_m)


def _chain(start: MotionPiece, phases: list[tuple[float, float]], end_m: float) -> list[MotionPiece]:
    """Pieces of (duration, acceleration), one after the other, then a standstill exactly at the end."""
    pieces = []
    now = start
    for duration_s, acceleration in phases:
        later_s = now.t_start_s + duration_s
        if later_s > now.t_start_s:
            piece = now._replace(acceleration_m_s2=acceleration)
            pieces.append(piece)
            now = MotionPiece(later_s, piece.position(later_s), piece.velocity(later_s), 0.0)
    return [*pieces, MotionPiece(now.t_start_s, end_m, 0.0, 0.0)]


def sane(name: str, value: float) -> float:
    """A number that a bench can have.

    Raises:
        ValueError: it is not finite, or beyond `SANE`.
    """
    if not abs(value) <= SANE:
        raise ValueError(f"{name} = {value!r} is not finite, or beyond {SANE:g}, which no bench has")
    return value


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} = {value!r} is not a finite number above zero")
    return value
