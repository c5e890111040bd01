"""The locked free finger, and leaps over its motion while it is not observed."""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.physics import finger_kernel as kernel
from simulator.physics import finger_scene as scene
from simulator.physics.finger_course import FingerCourse
from simulator.physics.piecewise import DEGREE, SPAN

_TRIED_S = 60.0
"""A loop that has not settled by then is taken never to settle."""

_SETTLED = 1e-13
"""Change of the state from cycle to cycle, relative, at which the cycle is taken as found."""

_NEAR, _TAIL = 1e-2, 1e-11
"""Deviations, relative, between which their decay is measured: near the cycle, and above rounding."""

_MOST = 1_000_000
"""Pieces in all: what moves so fast that more are needed is tried for as much shorter."""

_EDGES = 20_000
"""Cycles that are looked at: a finger that swings at 300 Hz has as many in that time."""

_MARGIN = 2.0
"""The finger is out of reach beyond this many times the swing that it reaches while it locks."""


class Lock(NamedTuple):
    """The periodic motion of the free, excited finger without noise.

    Attributes:
        x: State at a rising edge of the oscillator, shape (STATES,).
        swing_rad: Largest theta while it locks, judged at the edges from angle and speed.
        forgets_per_s: Rate at which small deviations die away.
        locked_s: From rest until a hundredth of the deviation is left, after which it dies away at that rate.
    """

    x: tuple[float, ...]
    comparator: int
    period_s: float
    swing_rad: float
    forgets_per_s: float
    locked_s: float

    def forgotten_s(self, error_rad: float) -> float:
        """How long it takes until a deviation as large as the swing has shrunk to `error_rad`."""
        return math.log(max(1.0, self.swing_rad / error_rad)) / self.forgets_per_s

    def repeating_s(self, error_rad: float) -> float:
        """How long after locking cycles may be left out: what they would still have shifted theta by is `error_rad`.

        A relative deviation d changes the period by about d of it, this time and, shrinking, every time.
        """
        shifts = 2.0 * math.pi * _NEAR / (self.forgets_per_s * self.period_s)
        return math.log(max(1.0, self.swing_rad * shifts / error_rad)) / self.forgets_per_s


def leap(
    course: FingerCourse, from_s: float, until_s: float, error_rad: float
) -> tuple[str, float, float] | None:
    """Leave out what the locked loop does before `until_s`, as far as an error in theta allows it.

    Without noise the cycle repeats: whole cycles are left out (`cycles`). With noise the loop forgets: it is put on its
    cycle so long before the end that what is left of the difference is inside the error, and meets the noise of that
    time (`stationary`); its phase is then one of many that are equally likely. That the loop locks from where it is as
    it locks from rest is taken for granted.

    Args:
        course: Changed.
        from_s: Up to when it is computed.
        until_s: The end, with no change of the scene before.
        error_rad: The budget; 0 forbids every leap.

    Returns:
        Its tier, the seconds it computed first, the seconds it left out; None where nothing can be left out.
    """
    if error_rad == 0.0 or course.finger.restless or not course.moment.flags[scene.EXCITED]:
        return None
    lock = lock_of(course)
    if lock is None or may_touch(course, from_s, until_s):
        return None
    if course.finger.noise > 0.0 or course.finger.wander > 0.0:
        left_out_s = until_s - lock.forgotten_s(error_rad) - from_s
        if left_out_s < lock.locked_s:
            return None
        course.enter(lock.x, lock.comparator, from_s + left_out_s)
        return "stationary", 0.0, left_out_s
    computed_s = lock.locked_s + lock.repeating_s(error_rad)
    # the last cycle is computed: its edge begins the first period that is observed
    left_out_s = (math.floor((until_s - from_s - computed_s) / lock.period_s) - 1) * lock.period_s
    if left_out_s <= 0.0:
        return None
    course.run(from_s + computed_s)
    course.leave_out(left_out_s)
    return "cycles", computed_s, left_out_s


def may_touch(course: FingerCourse, from_s: float, until_s: float) -> bool:
    """Whether the probe moves between two times, or rests where the finger could touch it."""
    lock = lock_of(course)
    position_m = course.probe_rests(from_s, until_s)
    if lock is None or position_m is None:
        return True
    arm_m = max(course.finger.arm, course.finger.base_arm)
    return position_m + _MARGIN * arm_m * lock.swing_rad > course.finger.gap


def lock_of(course: FingerCourse) -> Lock | None:
    """The lock of a course's scene, or None where its loop does not settle on one cycle."""
    finger = course.finger
    if course.locked is None or course.locked[0] is not finger:
        # what the free motion without noise does not depend on is left out of the key
        unused = ("noise", "wander", "arm", "base_arm", "push_arm", "contact", "contact_damping", "vibration")
        alone: dict[str, Any] = dict.fromkeys((*unused, "drift_1_s"), 0.0)
        alone |= dict.fromkeys(("gap", "touching_radius", "touching_frequency"), 1.0)
        course.locked = finger, _lock(finger._replace(**alone, seed=0, trial=0))
    return course.locked[1]


@lru_cache(maxsize=64)
def _lock(finger: scene.FingerConstants) -> Lock | None:
    times, states, comparator = _edges(finger)
    if not times:
        return None
    period_s = times[-1] - times[-2]
    distances = np.array([_distance(state, states[-1]) for state in states])
    # deviations beat as they die away: the largest in each second is what falls steadily
    second = max(1, round(1.0 / period_s))
    largest = [float(np.max(distances[i : i + second])) for i in range(0, len(distances) - second, second)]
    falling = [distance for distance in largest if _TAIL < distance < _NEAR]
    if len(falling) < 2 or falling[-1] >= falling[0]:
        return None
    return Lock(
        x=tuple(states[-1].tolist()),
        comparator=comparator,
        period_s=period_s,
        swing_rad=max(
            float(np.hypot(x[scene.THETA], x[scene.OMEGA] * period_s / (2.0 * math.pi))) for x in states
        ),
        forgets_per_s=math.log(falling[0] / falling[-1]) / ((len(falling) - 1) * second * period_s),
        locked_s=times[int(np.flatnonzero(distances >= _NEAR)[-1])],
    )


def _edges(finger: scene.FingerConstants) -> tuple[list[float], list[NDArray[np.float64]], int]:
    """Times and states at the oscillator's rising edges from rest until they repeat, and the comparator; or nothing."""
    moment = scene.at_rest()
    moment.flags[scene.EXCITED] = 1
    motion = scene.motion_of(np.zeros((1, 4)))
    # one place for a switch: the run comes back at each rising edge
    books = scene.books_of(1, 1, DEGREE)
    times: list[float] = []
    states: list[NDArray[np.float64]] = []
    tried_s = min(_TRIED_S, _MOST * SPAN / finger.free_radius)
    whole = math.floor(tried_s)
    while len(times) < _EDGES:
        books.filled[:] = 0
        if (
            kernel.run(finger, motion, moment, whole, tried_s - whole, False, 0, _MOST, books)
            != kernel.SWITCHES_FULL
        ):
            break
        times.append(moment.t_s)
        states.append(moment.x.copy())
        if len(states) > 1 and _distance(states[-1], states[-2]) < _SETTLED:
            return times, states, int(moment.flags[scene.COMPARATOR])
    return [], [], 0


def _distance(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Largest difference of two states, each place against its own size."""
    x, y = x[: scene.LOOP_STATES], y[: scene.LOOP_STATES]
    return float(np.max(np.abs(x - y) / np.maximum(np.abs(y), 1e-3 * np.max(np.abs(y)))))
