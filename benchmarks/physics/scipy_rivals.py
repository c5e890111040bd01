"""scipy's solvers, restarted at every event, with a compiled right-hand side: what a careful user would write."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from benchmarks.physics.dynamics import (
    CLIPPED,
    FREE,
    TOUCHING,
    Constants,
    Floats,
    State,
    constants,
    derivative,
    motion_table,
    probe,
)
from benchmarks.physics.model import (
    COMPARATOR_DOWN,
    COMPARATOR_UP,
    DRIVE_DOWN,
    DRIVE_UP,
    LOST,
    MADE,
    Scene,
    Solver,
    Trajectory,
)
from drivers.compiled import compiled

METHODS = ("RK45", "DOP853", "LSODA", "Radau")

MAX_STEP_S = 2e-3
"""Longest step: with longer ones the solvers step over more touches, for they look for events at the ends of steps."""

SIZES = np.array([1e-2, 1.0, 1e-1, 1.0, 5.0, 5.0, 5.0, 1.0, 0.5])
"""Typical size of each state in its unit: the absolute tolerance is the relative one times this."""

_CONSTANTS = len(Constants._fields)

_tuple: Any = to_fixed_tuple
"""What compiled code makes a tuple of an array with: its type says nothing of how it is called there."""

CONTACT, PRESSURE, COMPARATOR, PHASE = range(4)


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
    """A quantity that switches when it rises through zero."""
    state: State = _tuple(x, 9)
    c = Constants(*_tuple(values, _CONSTANTS))
    if which == PHASE:
        return state[8] - 0.5
    if which == COMPARATOR:
        y = state[4] - state[5] * c.per_quality - state[6]
        return (-y if switches[1] else y) - c.hysteresis
    s, s_rate, _ = probe(motion, switches[3], t)
    delta = s - c.gap - c.arm * state[0]
    push = c.contact * delta + c.contact_damping * (s_rate - c.arm * state[1])
    mode = switches[0]
    if which == PRESSURE:
        return push if mode == CLIPPED else -1.0
    return delta if mode == FREE else -push if mode == TOUCHING else -delta


def _event(function: Callable[[float, Floats], float]) -> Callable[[float, Floats], float]:
    function.terminal = True  # type: ignore[attr-defined]
    function.direction = 1.0  # type: ignore[attr-defined]
    return function


def prepared(scene: Scene, method: str, tolerance: float) -> Solver:
    """A solver of scipy's; arguments as of `solve`."""
    made: list[Trajectory] = []
    return Solver(lambda: made.append(solve(scene, method, tolerance)), lambda: made[-1])


def solve(scene: Scene, method: str, tolerance: float, max_step_s: float = MAX_STEP_S) -> Trajectory:
    """A scene by `solve_ivp`.

    Args:
        scene: The problem.
        method: One of `METHODS`.
        tolerance: Relative; the absolute one is this times `SIZES`.
        max_step_s: Longest step.
    """
    c = constants(scene.parameters)
    solver: Any = method
    values, motion = np.array(c), motion_table(scene.motion)
    switches = np.zeros(4, dtype=np.int64)
    events = [
        _event(lambda t, x, which=which: _guard(values, switches, motion, which, t, x))  # type: ignore[misc]
        for which in range(4)
    ]
    grid, theta = scene.times_s, np.full(scene.times_s.size, np.nan)
    x, t, filled = np.array([0.0] * 7 + [0.5, 0.0]), 0.0, 0
    times: list[float] = []
    codes: list[int] = []
    while t < grid[-1]:
        if t >= motion[switches[3] + 1, 0]:
            switches[3] += 1
            _corner(c, motion, switches, t, x, times, codes)
        until = min(float(motion[switches[3] + 1, 0]), float(grid[-1]))
        ahead = grid[filled : np.searchsorted(grid, until, side="right")]
        result: Any = solve_ivp(
            lambda t, x: _rates(values, switches, motion, t, x),
            (t, until),
            x,
            solver,
            t_eval=ahead if ahead.size and ahead[-1] == until else np.append(ahead, until),
            events=events,
            rtol=tolerance,
            atol=tolerance * SIZES,
            max_step=max_step_s,
        )
        reached = min(len(result.t), ahead.size)
        if reached:
            theta[filled : filled + reached] = result.y[0, :reached]
            filled += reached
        if result.status == 0:
            t, x = until, result.y[:, -1].copy()
            continue
        if result.status != 1:
            raise ArithmeticError(f"scipy {method} at {tolerance:g}: {result.message}")
        which = min(
            (i for i in range(4) if result.t_events[i].size), key=lambda i: float(result.t_events[i][0])
        )
        t, x = float(result.t_events[which][0]), result.y_events[which][0].copy()
        code = _switch(c, which, switches)
        if which == PHASE:
            x[8] = 0.0
        if code is not None:
            times.append(t)
            codes.append(code)
    return Trajectory.from_codes(theta, np.array(times), np.array(codes, dtype=np.int64))


def _switch(c: Constants, which: int, switches: NDArray[np.int64]) -> int | None:
    """Set the switches for what follows an event; the event's kind, where it is one to be counted."""
    if which == PHASE:
        switches[2] ^= 1
        return DRIVE_UP if switches[2] else DRIVE_DOWN
    if which == COMPARATOR:
        switches[1] ^= 1
        return COMPARATOR_UP if switches[1] else COMPARATOR_DOWN
    was = switches[0]
    if was == TOUCHING:
        switches[0] = CLIPPED if c.contact_damping > 0.0 else FREE
        return LOST
    switches[0] = TOUCHING if was == FREE or which == PRESSURE else FREE
    return MADE if switches[0] == TOUCHING else None


def _corner(
    c: Constants,
    motion: Floats,
    switches: NDArray[np.int64],
    t: float,
    x: Floats,
    times: list[float],
    codes: list[int],
) -> None:
    """The probe's velocity may jump, and with it P: equation (4) says which mode that is."""
    s, s_rate, _ = probe(motion, switches[3], t)
    delta = s - c.gap - c.arm * x[0]
    push = c.contact * delta + c.contact_damping * (s_rate - c.arm * x[1])
    if switches[0] == TOUCHING and push <= 0.0:
        switches[0] = CLIPPED if delta > 0.0 else FREE
    elif switches[0] == CLIPPED and push > 0.0:
        switches[0] = TOUCHING
    else:
        return
    times.append(t)
    codes.append(MADE if switches[0] == TOUCHING else LOST)
