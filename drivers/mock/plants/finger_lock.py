"""The locked free finger: its cycle, and how soon it forgets."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from drivers.mock.plants import finger_kernel as kernel
from drivers.mock.plants import finger_scene as scene
from drivers.mock.plants.piecewise import DEGREE

_TRIED_S = 60.0
"""A loop that has not locked by then is taken never to lock."""

_SETTLED = 1e-13
"""Change of the state from cycle to cycle, relative, at which the cycle is taken as found."""

NEAR, _TAIL = 1e-2, 1e-11
"""Deviations, relative, between which their decay is measured: near the cycle, and above rounding."""


class Lock(NamedTuple):
    """The periodic motion of the free, excited finger without noise.

    Attributes:
        x: State at a rising edge of the oscillator, shape (STATES,).
        comparator: The comparator at that edge.
        period_s: Length of a cycle.
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
        """How long after locking a deviation in theta has shrunk to `error_rad`."""
        return math.log(max(1.0, self.swing_rad / error_rad)) / self.forgets_per_s

    def repeating_s(self, error_rad: float) -> float:
        """How long after locking cycles may be left out: what they would still have shifted theta by is `error_rad`.

        A relative deviation d changes the period by about d of it, this time and, shrinking, every time.
        """
        shifts = 2.0 * math.pi * NEAR / (self.forgets_per_s * self.period_s)
        return math.log(max(1.0, self.swing_rad * shifts / error_rad)) / self.forgets_per_s


def lock_of(finger: scene.Finger) -> Lock | None:
    """The lock of a scene, or None where its loop does not settle on one cycle."""
    # what the free motion without noise does not depend on is left out of the key
    alone = {"noise": 0.0, "wander": 0.0, "arm": 0.0, "gap": 1.0, "contact": 0.0, "contact_damping": 0.0}
    return _lock(finger._replace(**alone, seed=0, trial=0))


@lru_cache(maxsize=64)
def _lock(finger: scene.Finger) -> Lock | None:
    moment = scene.at_rest()
    moment.flags[scene.EXCITED] = 1
    motion = scene.motion_of(np.zeros((1, 4)))
    books = scene.books_of(1, 1, DEGREE)
    states: list[np.ndarray] = []
    times: list[float] = []
    while not times or times[-1] < _TRIED_S:
        books.filled[:] = 0
        # one place for a switch: the run comes back at each
        status = kernel.run(finger, motion, moment, int(_TRIED_S) + 1, 0.0, False, 0, books)
        if status != kernel.SWITCHES_FULL:
            return None
        if books.switch[0] != scene.DRIVE_UP:
            continue
        states.append(moment.x.copy())
        times.append(moment.t_s)
        if len(states) > 1 and _distance(states[-1], states[-2]) < _SETTLED and abs(states[-1][scene.THETA]) > 0.0:
            break
    else:
        return None
    period_s = times[-1] - times[-2]
    distances = [_distance(state, states[-1]) for state in states]
    # deviations beat as they die away: the largest in each second is what falls steadily
    second = max(1, round(1.0 / period_s))
    largest = [max(distances[i : i + second]) for i in range(0, len(distances) - second, second)]
    falling = [distance for distance in largest if _TAIL < distance < NEAR]
    if len(falling) < 2 or falling[-1] >= falling[0]:
        return None
    rate = math.log(falling[0] / falling[-1]) / ((len(falling) - 1) * second * period_s)
    swing = max(abs(state[scene.THETA]) + abs(state[scene.OMEGA]) * period_s / (2.0 * math.pi) for state in states)
    return Lock(
        x=tuple(states[-1].tolist()),
        comparator=int(moment.flags[scene.COMPARATOR]),
        period_s=period_s,
        swing_rad=float(swing),
        forgets_per_s=rate,
        locked_s=max(t for t, distance in zip(times, distances, strict=True) if distance >= NEAR),
    )


def _distance(x: np.ndarray, y: np.ndarray) -> float:
    """Largest difference of two states, each place against its own size."""
    return float(np.max(np.abs(x - y) / np.maximum(np.abs(y), 1e-3 * np.max(np.abs(y)))))
