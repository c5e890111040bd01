"""Steps that are cut at every event: RK4, and Dormand and Prince's of order 8. Compiled: the strong rivals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.physics.dynamics import (
    FREE,
    REORDERED,
    TOUCHING,
    Constants,
    Floats,
    State,
    derivative,
    probe,
    rk4,
)
from benchmarks.physics.guards import (
    PHASE,
    SETTLED_S,
    Probe,
    first,
    guard_of,
    mode_by_law,
    overtaken,
    quiet,
    switched,
)
from benchmarks.physics.high_order import rk8
from benchmarks.physics.model import LOST, MADE, OUTPUT_HZ
from drivers.compiled import compiled

Ints = NDArray[np.int64]

NEWTON = 60
"""Most steps of Newton for an event; three or four are the rule."""


@compiled(inline="always")
def _step(
    order: int,
    c: Constants,
    mode: int,
    comparator: int,
    oscillator: int,
    motion: Floats,
    row: int,
    t: float,
    h: float,
    x: State,
    d: State,
) -> tuple[State, Probe, State]:
    """One step of either order: state, probe and derivative at its end."""
    if order == 4:
        end = rk4(c, mode, comparator, oscillator, motion, row, t, h, x, d)
    else:
        end = rk8(c, mode, comparator, oscillator, motion, row, t, h, x, d)
    s = probe(motion, row, t + h)
    return end, s, derivative(c, mode, comparator, oscillator, s[0], s[1], end)


@compiled(fastmath=REORDERED)
def _trial(
    order: int,
    c: Constants,
    mode: int,
    comparator: int,
    oscillator: int,
    motion: Floats,
    row: int,
    t: float,
    h: float,
    x: State,
    d: State,
) -> tuple[State, Probe, State]:
    """`_step` as a call: inlined everywhere, it would double the time to compile."""
    return _step(order, c, mode, comparator, oscillator, motion, row, t, h, x, d)


@compiled(fastmath=REORDERED)
def _until(
    order: int,
    c: Constants,
    which: int,
    mode: int,
    comparator: int,
    oscillator: int,
    motion: Floats,
    row: int,
    t: float,
    h: float,
    tau: float,
    x: State,
    d: State,
) -> tuple[State, Probe, float, int]:
    """A step that ends where `which` switches, or what the cubics overlooked before it: Newton on the step's length.

    Returns:
        State and probe at its end, its length, and what switches there.
    """
    end, s, end_d = _trial(order, c, mode, comparator, oscillator, motion, row, t, tau, x, d)
    for _ in range(NEWTON):
        g, slope = guard_of(c, which, mode, comparator, s, end, end_d)
        change = -g / slope if slope > 0.0 else 0.0
        if abs(change) <= SETTLED_S:
            earlier = overtaken(c, which, mode, comparator, s, end, end_d)
            if earlier == which:
                break
            which = earlier
            continue
        tau = min(max(tau + change, 0.0), h)
        end, s, end_d = _trial(order, c, mode, comparator, oscillator, motion, row, t, tau, x, d)
    return end, s, tau, which


@compiled(fastmath=REORDERED)
def located(
    c: Constants,
    motion: Floats,
    outputs: int,
    substeps: int,
    order: int,
    theta: Floats,
    times: Floats,
    codes: Ints,
) -> int:
    """Steps of 1 / (1 kHz x substeps), cut at every event.

    A step's guards are looked at through their cubics (values and slopes at both ends), so that a touch that begins and
    ends within one step is seen. The instant is then polished by Newton, with steps of trial length up to it.

    Args:
        c: The scene's numbers.
        motion: The probe's plan, as of `motion_table`.
        outputs: Milliseconds of output.
        substeps: Steps to a millisecond.
        order: 4 or 8.
        theta: Written: angle of the distal link at each millisecond, rad, shape (outputs,).
        times: Written: instants of events, s; its length is the room for them.
        codes: Written: their kinds, places in `KINDS`.

    Returns:
        How many events there were; -1 where there was no room for them: the solver went astray.
    """
    x = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0)
    mode, comparator, oscillator, row, count = FREE, 0, 0, 0, 0
    t = 0.0
    s = probe(motion, 0, t)
    d = derivative(c, mode, comparator, oscillator, s[0], s[1], x)
    for step in range(outputs * substeps):
        goal = (step + 1) / (OUTPUT_HZ * substeps)
        if t >= motion[row + 1, 0] - 1e-12:
            row += 1
            s = probe(motion, row, t)
            was, mode = mode, mode_by_law(c, mode, s, x)
            if was != mode:
                times[count], codes[count] = t, MADE if mode == TOUCHING else LOST
                count += 1
            d = derivative(c, mode, comparator, oscillator, s[0], s[1], x)
        while t < goal:
            if count + 2 > times.size:
                return -1
            h = goal - t
            end, end_s, end_d = _step(order, c, mode, comparator, oscillator, motion, row, t, h, x, d)
            which, tau = -1, h
            if not quiet(c, mode, comparator, s, x, d, end_s, end, end_d):
                which, tau = first(c, mode, comparator, h, s, x, d, end_s, end, end_d)
            if which < 0:
                x, s, d, t = end, end_s, end_d, goal
                continue
            x, s, tau, which = _until(
                order, c, which, mode, comparator, oscillator, motion, row, t, h, tau, x, d
            )
            t += tau
            if which == PHASE:
                x = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], 0.0)
            mode, comparator, oscillator, code = switched(c, which, mode, comparator, oscillator)
            if code >= 0:
                times[count], codes[count] = t, code
                count += 1
            d = derivative(c, mode, comparator, oscillator, s[0], s[1], x)
        if (step + 1) % substeps == 0:
            theta[(step + 1) // substeps - 1] = x[0]
    return count
