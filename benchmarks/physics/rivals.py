"""The compiled rivals: fixed-step RK4 and semi-implicit Euler, which step over events, and methods that locate them.

All give the output on the scene's grid, which their steps divide, and the times of all events.
"""

from __future__ import annotations

import numpy as np

from benchmarks.physics.dynamics import constants, motion_table
from benchmarks.physics.fixed_step import fixed
from benchmarks.physics.located import located
from benchmarks.physics.model import Scene, Solver, Trajectory

EVENTS_PER_S = 4000
"""Room for events; what needs more has gone astray."""

LOCATED = {"RK4, events located": 4, "order 8, events located": 8}
"""Methods that locate events, and their orders."""

FIXED = {"RK4": False, "semi-implicit Euler": True}
"""Methods that step over them, and whether they are of first order."""

METHODS = (*LOCATED, *FIXED)


def prepared(scene: Scene, method: str, substeps: int) -> Solver:
    """A compiled rival with steps of 1 ms / `substeps`.

    Raises:
        ArithmeticError: when its result is asked for and it went astray: more events than can be.
    """
    c, motion, outputs = constants(scene.parameters), motion_table(scene.motion), scene.times_s.size
    room = int(EVENTS_PER_S * scene.duration_s) + 64
    theta, times, codes = np.empty(outputs), np.empty(room), np.empty(room, dtype=np.int64)

    counted = 0

    def run() -> None:
        nonlocal counted
        if method in LOCATED:
            counted = located(c, motion, outputs, substeps, LOCATED[method], theta, times, codes)
        else:
            counted = fixed(c, motion, outputs, substeps, FIXED[method], theta, times, codes)

    def result() -> Trajectory:
        if counted < 0:
            raise ArithmeticError(f"{method} at {1e-3 / substeps:g} s: more events than can be")
        return Trajectory.from_codes(theta.copy(), times[:counted], codes[:counted])

    return Solver(run, result)
