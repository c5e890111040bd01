"""scipy's LSODA, restarted at every event, with a compiled right-hand side: what a careful user would write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from benchmarks.physics.dynamics import (
    FREE,
    TOUCHING,
    Constants,
    Floats,
    constants,
    derivative,
    motion_table,
    probe,
)
from benchmarks.physics.guards import GUARDS, PHASE, guard_of, mode_by_law, switched
from benchmarks.physics.model import LOST, MADE, Scene, Trajectory
from drivers.compiled import compiled

MAX_STEP_S = 2e-3
"""Longest step: with longer ones the solver steps over more touches, for it looks for events at the ends of steps."""

SIZES = np.array([1e-2, 1.0, 1e-1, 1.0, 5.0, 5.0, 5.0, 1.0, 0.5])
"""Typical size of each state in its unit: the absolute tolerance is the relative one times this."""

_CONSTANTS = len(Constants._fields)

_tuple: Any = to_fixed_tuple
"""What compiled code makes a tuple of an array with: its type says nothing of how it is called there."""


@compiled()
def _rates(values: Floats, switches: NDArray[np.int64], motion: Floats, t: float, x: Floats) -> Floats:
    """The right-hand side; `switches`: mode, comparator, oscillator, row of the probe's plan."""
    c = Constants(*_tuple(values, _CONSTANTS))
    s, s_rate, _ = probe(motion, switches[3], t)
    d = derivative(c, switches[0], switches[1], switches[2], s, s_rate, _tuple(x, 9))
    return np.array(d)


@compiled()
def _guard(
    values: Floats, switches: NDArray[np.int64], motion: Floats, which: int, t: float, x: Floats
) -> float:
    """A quantity that switches when it rises through zero; its slope, which wants rates, is not asked for."""
    c, state = Constants(*_tuple(values, _CONSTANTS)), _tuple(x, 9)
    return guard_of(c, which, switches[0], switches[1], probe(motion, switches[3], t), state, state)[0]


def _event(function: Callable[[float, Floats], float]) -> Callable[[float, Floats], float]:
    function.terminal = True  # type: ignore[attr-defined]
    function.direction = 1.0  # type: ignore[attr-defined]
    return function


def solve(scene: Scene, tolerance: float) -> Trajectory:
    """A scene by `solve_ivp`.

    Args:
        scene: The problem.
        tolerance: Relative; the absolute one is this times `SIZES`.

    Raises:
        ArithmeticError: when it gives up.
    """
    c = constants(scene)
    values, motion = np.array(c), motion_table(scene.motion)
    switches = np.array([FREE, 0, 0, 0])
    events = [
        _event(lambda t, x, which=which: _guard(values, switches, motion, which, t, x))  # type: ignore[misc]
        for which in range(GUARDS)
    ]
    grid, theta = scene.times_s, np.full(scene.times_s.size, np.nan)
    x, t, filled = np.array([0.0] * 7 + [0.5, 0.0]), 0.0, 0
    found: list[tuple[float, int]] = []
    while t < grid[-1]:
        if t >= motion[switches[3] + 1, 0]:
            switches[3] += 1
            was, switches[0] = (
                switches[0],
                mode_by_law(c, switches[0], probe(motion, switches[3], t), tuple(x)),
            )
            if was != switches[0]:
                found.append((t, MADE if switches[0] == TOUCHING else LOST))
        until = min(float(motion[switches[3] + 1, 0]), float(grid[-1]))
        ahead = grid[filled : np.searchsorted(grid, until, side="right")]
        result: Any = solve_ivp(
            lambda t, x: _rates(values, switches, motion, t, x),
            (t, until),
            x,
            "LSODA",
            t_eval=ahead if ahead.size and ahead[-1] == until else np.append(ahead, until),
            events=events,
            rtol=tolerance,
            atol=tolerance * SIZES,
            max_step=MAX_STEP_S,
        )
        reached = min(len(result.t), ahead.size)
        if reached:
            theta[filled : filled + reached] = result.y[0, :reached]
            filled += reached
        if result.status == 0:
            t, x = until, result.y[:, -1].copy()
            continue
        if result.status != 1:
            raise ArithmeticError(f"scipy LSODA at {tolerance:g}: {result.message}")
        first = {which: float(at[0]) for which, at in enumerate(result.t_events) if at.size}
        which = min(first, key=lambda which: first[which])
        t, x = first[which], result.y_events[which][0].copy()
        *switches[:3], code = switched(c, which, *switches[:3])
        if which == PHASE:
            x[8] = 0.0
        if code >= 0:
            found.append((t, code))
    times, codes = zip(*found, strict=True) if found else ((), ())
    return Trajectory.from_codes(theta, np.array(times), np.array(codes, dtype=np.int64))
