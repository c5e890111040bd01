"""Motion of a tool in all six directions, in closed form: along an approach axis, beside it, and turning.

A motion is a chain of legs of constant acceleration in seven coordinates: the position on the approach axis, what is
beside the axis (three, base axes) and the integrated angular velocity (three, base axes). The first is kept apart, so
that a bench whose probe knows the axis alone gets it as exactly as from a stage.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled
from simulator.physics.rigid import Array, rotation, rotation_vector, rotation_vectors, rotations
from simulator.physics.stage_axis import MotionPiece, StageAxis, sane

LEGS = 64
"""Legs remembered, present plan included: the last dozen commands (at most 5 legs each)."""

ALONG, LINEAR, ANGULAR = 0, slice(0, 4), slice(4, 7)
"""Where the coordinates are; beside the axis there are no more than two independent ones of the three."""

STRAIGHT: Array = np.eye(3)
"""The start pose's orientation, relative to itself."""


class Leg(NamedTuple):
    """Motion of constant acceleration, from its start until the next leg begins.

    Attributes:
        place: Shape (7,), m and rad.
        velocity: Shape (7,).
        acceleration: Shape (7,).
        turned: Orientation at its start relative to the start pose's, base frame, shape (3, 3).
    """

    t_start_s: float
    place: Array
    velocity: Array
    acceleration: Array
    turned: Array

    def at(self, t_s: float) -> Leg:
        """What is left of it at `t_s`."""
        elapsed_s = t_s - self.t_start_s
        place = self.place + elapsed_s * (self.velocity + 0.5 * self.acceleration * elapsed_s)
        velocity = self.velocity + self.acceleration * elapsed_s
        return Leg(t_s, place, velocity, self.acceleration, _turned(self, place))

    def piece(self) -> MotionPiece:
        """The same on the approach axis alone."""
        x, v, a = self.place[ALONG], self.velocity[ALONG], self.acceleration[ALONG]
        return MotionPiece(self.t_start_s, float(x), float(v), float(a))


class ToolTrack:
    """Where a tool has been, is and will be under its present plan; on the approach axis it is a bench's carrier.

    Args:
        direction: Of the approach axis, unit vector in the base frame.
        legs: How many legs are remembered, the present plan's included.
    """

    def __init__(self, direction: Sequence[float], legs: int = LEGS) -> None:
        self.direction: Array = np.array(direction, dtype=np.float64)
        self._legs: deque[Leg] = deque(maxlen=legs)
        self.place(0.0, 0.0)

    @property
    def arrival_s(self) -> float:
        """Time from which the last leg holds."""
        return self._legs[-1].t_start_s

    @property
    def target_m(self) -> float:
        """Where on the axis the last leg begins."""
        return float(self._legs[-1].place[ALONG])

    def place(self, t_s: float, position_m: float) -> None:
        """Stand still on the axis from `t_s` on, not turned, and forget what was before."""
        place = np.zeros(7)
        place[ALONG] = sane("position_m", position_m)
        self._legs.clear()
        self._straight = True
        self.replace(t_s, [Leg(t_s, place, np.zeros(7), np.zeros(7), STRAIGHT)])

    def replace(self, t_s: float, plan: Sequence[Leg]) -> None:
        """Move by these legs from `t_s` on, where the first of them begins."""
        while self._legs and self._legs[-1].t_start_s >= t_s:
            self._legs.pop()
        for leg in plan:
            for part in leg[1:]:
                part.setflags(write=False)
        self._legs.extend(plan)
        self._known: Array | None = None
        self._straight = all(leg.turned is STRAIGHT for leg in plan) and self._straight

    def leg(self, t_s: float) -> Leg:
        """The motion at `t_s`, from there on.

        Raises:
            ValueError: this is longer ago than the track remembers.
        """
        return self._leg(t_s).at(t_s)

    def _leg(self, t_s: float) -> Leg:
        for leg in reversed(self._legs):
            if leg.t_start_s <= t_s:
                return leg
        raise ValueError(f"t_s = {t_s!r} is before the motion that is remembered")

    # on the approach axis: what the finger needs of a carrier

    def position(self, t_s: float) -> float:
        """Position on the axis in metres."""
        return self._leg(t_s).piece().position(t_s)

    def velocity(self, t_s: float) -> float:
        """Velocity along the axis in m/s."""
        return self._leg(t_s).piece().velocity(t_s)

    def pieces(self, t_s: float) -> list[MotionPiece]:
        """The motion along the axis from `t_s` on: the first piece starts at `t_s`, the last holds for ever."""
        present = self._leg(t_s).piece()
        first = MotionPiece(t_s, present.position(t_s), present.velocity(t_s), present.acceleration_m_s2)
        return [first, *(leg.piece() for leg in self._legs if leg.t_start_s > t_s)]

    # in all directions

    def coordinates(self, times_s: NDArray[np.float64]) -> Array:
        """The seven coordinates at some instants, shape (n, 7).

        Raises:
            ValueError: one of them is longer ago than the track remembers.
        """
        found = np.empty((len(times_s), 7))
        _coordinates(self._table(times_s), np.ascontiguousarray(times_s), found)
        return found

    def offsets(self, times_s: NDArray[np.float64]) -> Array:
        """Displacement from the start pose along base axes, m, and integrated angular velocity, rad, (n, 6)."""
        found = np.empty((len(times_s), 6))
        _offsets(self._table(times_s), self.direction, np.ascontiguousarray(times_s), found)
        return found

    def turns(self, times_s: NDArray[np.float64]) -> Array:
        """Orientation relative to the start pose's as a rotation vector, base frame, rad, shape (n, 3).

        It is exact while the axis of the turn does not change within a leg; where one twist passes into another about
        another axis, the leg between them is taken for a turn about its mean axis.
        """
        angles = self.coordinates(times_s)[:, ANGULAR]
        found = np.zeros((len(times_s), 3))
        if self._straight and not angles.any():
            return found
        legs, which = self._spans(times_s)
        straight = np.array([leg.turned is STRAIGHT for leg in legs])[which]
        firsts, run = repeats(np.column_stack((which, angles)))
        turning = np.array(
            [first for first in firsts if angles[first].any() or not straight[first]], np.int64
        )
        for number in set(which[turning].tolist()):
            leg, part = legs[number], turning[which[turning] == number]
            since = np.ascontiguousarray(angles[part] - leg.place[ANGULAR])
            found[np.searchsorted(firsts, part)] = rotation_vectors(rotations(since) @ leg.turned)
        return found[run]

    def split(self, six: Sequence[float] | Array) -> Array:
        """Seven coordinates of a displacement or twist (6,) along base axes."""
        linear = np.array(six[:3], dtype=np.float64)
        along = float(np.dot(linear, self.direction))
        return np.concatenate([[along], linear - along * self.direction, six[3:]])

    def _table(self, times_s: NDArray[np.float64]) -> Array:
        """The legs from the first of these instants on, a row each: start, place, velocity, acceleration."""
        if self._known is None or (len(times_s) and times_s.min() < self._known[0, 0]):
            legs, _ = self._spans(times_s)
            self._known = np.array([np.concatenate(([leg.t_start_s], *leg[1:4])) for leg in legs])
        return self._known

    def _spans(self, times_s: NDArray[np.float64]) -> tuple[list[Leg], NDArray[np.int64]]:
        """The legs that these instants are in, and which of them each is in."""
        first_s = float(times_s.min()) if len(times_s) else self.arrival_s
        legs: list[Leg] = []
        for leg in reversed(self._legs):
            legs.append(leg)
            if leg.t_start_s <= first_s:
                break
        else:
            raise ValueError(f"t_s = {first_s!r} is before the motion that is remembered")
        legs.reverse()
        starts_s = np.array([leg.t_start_s for leg in legs])
        return legs, np.searchsorted(starts_s, times_s, side="right") - 1


class ToolMotion(ToolTrack):
    """A tool that accelerates within a limit, and stands exactly where it was sent.

    A command replaces the plan from its time on; the tool keeps place and velocity through it. Translation and turn
    change together, in the time that the slower of them needs, so that a twist keeps its direction while it begins and
    ends.

    Args:
        direction: Of the approach axis, unit vector in the base frame.
        acceleration_m_s2: Greatest acceleration; rad/s^2 for the turn.
        max_speed_m_s: No motion along the axis is faster.
    """

    def __init__(self, direction: Sequence[float], *, acceleration_m_s2: float, max_speed_m_s: float) -> None:
        super().__init__(direction)
        self._acceleration = acceleration_m_s2
        self._max_speed_m_s = max_speed_m_s

    def moving(self, t_s: float) -> bool:
        """True until the present plan stands still."""
        return t_s < self.arrival_s

    def move_at(self, t_s: float, velocity_m_s: float, limit_m: float) -> None:
        """Go along the axis, wherever the tool is beside it, as far as the limit; one already beyond it stops."""
        sane("velocity_m_s", velocity_m_s), sane("limit_m", limit_m)
        start = self._start(t_s)
        beside = bool(start.velocity[1:].any())
        aligned = self._aligned(start, velocity_m_s, limit_m) if beside else [start]
        axis = self._stage(aligned[-1].piece())
        axis.move_at(aligned[-1].t_start_s, velocity_m_s, limit_m)
        self.replace(t_s, _joined(aligned, _along(aligned[-1], axis)))

    def _aligned(self, start: Leg, velocity_m_s: float, limit_m: float) -> list[Leg]:
        """Legs that end on the way along the axis alone; at rest where there is no room to take the speed along."""
        target = np.zeros(7)
        target[ALONG] = math.copysign(min(abs(velocity_m_s), self._max_speed_m_s), velocity_m_s)
        legs = _ramp(start, target, self._acceleration)
        ahead_m = (limit_m - legs[-1].place[ALONG]) * math.copysign(1.0, velocity_m_s)
        if ahead_m < 0.5 * target[ALONG] ** 2 / self._acceleration:
            legs = _ramp(start, np.zeros(7), self._acceleration)
        return legs

    def move_to(self, t_s: float, position_m: float, speed_m_s: float) -> None:
        """Go straight to a position on the axis, with the start pose's orientation."""
        sane("position_m", position_m), sane("speed_m_s", speed_m_s)
        start = self._start(t_s)
        if not start.velocity[1:].any() and not start.place[1:].any() and start.turned is STRAIGHT:
            axis = self._stage(start.piece())
            axis.move_to(t_s, position_m, speed_m_s)
            self.replace(t_s, _along(start, axis))
            return
        target = np.zeros(7)
        target[ALONG] = position_m
        self._go(start, target, STRAIGHT, speed_m_s)

    def move_pose(self, t_s: float, offset: Sequence[float], speed: float) -> None:
        """Go straight to a displacement from the start pose, turning along the way; what moves is stopped first.

        Args:
            offset: Metres along base axes, and a rotation vector in rad, base frame; shape (6,).
            speed: Of whichever is longer: the way in m/s, or the turn in rad/s (as the emulated controller's `movel`).
        """
        _sane_all("offset", (*offset, speed))
        turned = rotation(offset[3:]) if any(offset[3:]) else STRAIGHT
        self._go(self._start(t_s), self.split(offset), turned, speed)

    def _go(self, start: Leg, target: Array, turned: Array, speed: float) -> None:
        legs = _ramp(start, np.zeros(7), self._acceleration)
        rest = legs[-1]
        way = target - rest.place
        turn = rotation_vector(turned @ rest.turned.T) if turned is not rest.turned else np.zeros(3)
        way[ANGULAR] = turn
        end = rest.place + way
        end[:4] = target[:4]
        length = max(float(np.linalg.norm(way[LINEAR])), float(np.linalg.norm(turn)))
        share = way / length if length > 0.0 else way
        line = StageAxis(acceleration_m_s2=self._acceleration, max_speed_m_s=speed, t_s=rest.t_start_s)
        line.move_to(rest.t_start_s, length, speed)
        *moving, still = line.pieces(rest.t_start_s)
        plan = []
        for piece in moving:
            place = rest.place + share * piece.position_m
            leg = Leg(
                piece.t_start_s,
                place,
                share * piece.velocity_m_s,
                share * piece.acceleration_m_s2,
                rest.turned,
            )
            plan.append(leg._replace(turned=_turned(rest, place)))
        plan.append(Leg(still.t_start_s, end, np.zeros(7), np.zeros(7), turned))
        self.replace(start.t_start_s, _joined(legs, plan))

    def twist(self, t_s: float, twist: Sequence[float], duration_s: float) -> None:
        """Move with a twist (6,), m/s and rad/s along base axes, then come to rest.

        From rest it goes as far as twist times duration: the ramp up is part of the duration, the ramp down comes after
        it.
        """
        _sane_all("twist", (*twist, duration_s))
        start, target = self._start(t_s), self.split(twist)
        legs = _ramp(start, target, self._acceleration)
        if legs[-1].t_start_s >= t_s + duration_s:
            hold = _resting_on(legs, t_s + duration_s)
        else:
            hold = [*legs, legs[-1].at(t_s + duration_s)]
        down = _ramp(_coasting(hold[-1]), np.zeros(7), self._acceleration)
        self.replace(t_s, _joined(hold, down))

    def stop(self, t_s: float, deceleration_m_s2: float | None = None) -> None:
        """Come to rest, at the tool's own rate or at another."""
        slowing = self._acceleration if deceleration_m_s2 is None else deceleration_m_s2
        start = self._start(t_s)
        if start.velocity[1:].any():
            self.replace(t_s, _ramp(start, np.zeros(7), slowing))
            return
        axis = self._stage(start.piece())
        axis.stop(t_s, slowing)
        self.replace(t_s, _along(start, axis))

    def rests(self, times_s: NDArray[np.float64], deceleration_m_s2: float) -> Array:
        """Where the tool would come to rest if it were stopped at these instants: coordinates, shape (n, 7)."""
        legs, which = self._spans(times_s)
        velocity, acceleration = (np.array([leg[part] for leg in legs])[which] for part in (2, 3))
        elapsed_s = times_s - np.array([leg.t_start_s for leg in legs])[which]
        velocity = velocity + acceleration * elapsed_s[:, None]
        fastest = np.maximum(
            np.linalg.norm(velocity[:, LINEAR], axis=1), np.linalg.norm(velocity[:, ANGULAR], axis=1)
        )
        found: Array = self.coordinates(times_s) + velocity * (0.5 * fastest / deceleration_m_s2)[:, None]
        return found

    def _start(self, t_s: float) -> Leg:
        return _coasting(self.leg(t_s))

    def _stage(self, piece: MotionPiece) -> StageAxis:
        """An axis that plans the way along the approach axis, from here on."""
        axis = StageAxis(acceleration_m_s2=self._acceleration, max_speed_m_s=self._max_speed_m_s)
        axis.replace(piece.t_start_s, [piece])
        return axis


def _sane_all(name: str, values: Sequence[float]) -> None:
    for value in values:
        sane(name, value)


def repeats(rows: Array) -> tuple[list[int], NDArray[np.int64]]:
    """Where runs of equal rows begin, and which run each row, of shape (n, k), is in."""
    begins = np.concatenate(([True], (rows[1:] != rows[:-1]).any(axis=1)))[: len(rows)]
    return np.flatnonzero(begins).tolist(), np.cumsum(begins) - 1


@compiled("void(f8[:,::1], f8[::1], f8[:,::1])")
def _coordinates(legs: Array, times_s: Array, out: Array) -> None:
    """Place at each instant, shape (n, 7): in the last leg that has begun by then."""
    for number in range(times_s.size):
        row = legs.shape[0] - 1
        while row > 0 and legs[row, 0] > times_s[number]:
            row -= 1
        elapsed_s = times_s[number] - legs[row, 0]
        for k in range(7):
            change = legs[row, 8 + k] + 0.5 * legs[row, 15 + k] * elapsed_s
            out[number, k] = legs[row, 1 + k] + elapsed_s * change


@compiled("void(f8[:,::1], f8[::1], f8[::1], f8[:,::1])")
def _offsets(legs: Array, direction: Array, times_s: Array, out: Array) -> None:
    """Displacement along base axes and turn at each instant, shape (n, 6)."""
    found = np.empty((times_s.size, 7))
    _coordinates(legs, times_s, found)
    for number in range(times_s.size):
        for k in range(3):
            out[number, k] = found[number, 0] * direction[k] + found[number, 1 + k]
            out[number, 3 + k] = found[number, 4 + k]


def _coasting(leg: Leg) -> Leg:
    return leg._replace(acceleration=np.zeros(7))


def _turned(leg: Leg, place: Array) -> Array:
    """Orientation at a place of a leg."""
    turn = place[ANGULAR] - leg.place[ANGULAR]
    return rotation(turn) @ leg.turned if turn.any() else leg.turned


def _along(start: Leg, axis: StageAxis) -> list[Leg]:
    """Legs of a plan along the axis alone, from where the tool is beside it."""
    legs = []
    for piece in axis.pieces(start.t_start_s):
        place, velocity, acceleration = start.place.copy(), np.zeros(7), np.zeros(7)
        place[ALONG] = piece.position_m
        velocity[ALONG], acceleration[ALONG] = piece.velocity_m_s, piece.acceleration_m_s2
        legs.append(Leg(piece.t_start_s, place, velocity, acceleration, start.turned))
    return legs


def _ramp(start: Leg, target: Array, acceleration: float) -> list[Leg]:
    """Legs from a start to a velocity (7,), the last of which keeps it; translation and turn change together."""
    change = target - start.velocity
    largest = max(float(np.linalg.norm(change[part])) for part in (LINEAR, ANGULAR))
    end_s = start.t_start_s + largest / acceleration
    if not end_s > start.t_start_s:
        return [start._replace(velocity=target, acceleration=np.zeros(7))]
    ramp = start._replace(acceleration=change * (acceleration / largest))
    end = ramp.at(end_s)._replace(velocity=target.copy(), acceleration=np.zeros(7))
    return [ramp, end]


def _resting_on(legs: list[Leg], t_s: float) -> list[Leg]:
    """A chain of legs as far as `t_s`, where the last of them begins."""
    before = [leg for leg in legs if leg.t_start_s < t_s]
    return [*before, (before or legs)[-1].at(t_s)]


def _joined(first: list[Leg], then: list[Leg]) -> list[Leg]:
    """Two chains, the second of which begins where the last leg of the first does."""
    return [*first[:-1], *then]
