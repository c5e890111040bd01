"""Fixed steps that step over events: semi-implicit Euler and classical RK4, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.physics.dynamics import BY_LAW, REORDERED, Constants, Floats, State, derivative, probe, rk4
from benchmarks.physics.model import (
    COMPARATOR_DOWN,
    COMPARATOR_UP,
    DRIVE_DOWN,
    DRIVE_UP,
    LOST,
    MADE,
    OUTPUT_HZ,
)
from drivers.compiled import compiled

Ints = NDArray[np.int64]


@compiled(inline="always")
def euler(
    c: Constants, comparator: int, oscillator: int, s: float, s_rate: float, h: float, x: State
) -> State:
    """One semi-implicit Euler step: rates first, then what they move, each with the newest of the others."""
    theta, omega, b, beta, a, g1, g2, v, phi = x
    d = derivative(c, BY_LAW, comparator, oscillator, s, s_rate, x)
    omega += h * d[1]
    beta += h * d[3]
    a += h * d[4]
    g1 += h * c.high_pass_rad_s * (a - g1 * c.per_quality - g2)
    v += h * d[7]
    return (
        theta + h * omega,
        omega,
        b + h * beta,
        beta,
        a,
        g1,
        g2 + h * c.high_pass_rad_s * g1,
        v,
        phi + h * (c.lowest_hz + c.range_hz * v),
    )


@compiled(inline="always")
def _share(before: float, after: float) -> float:
    """Where in a step a straight line crosses zero, 0 to 1."""
    return before / (before - after) if before != after else 1.0


@compiled(inline="always")
def watched(c: Constants, s: float, s_rate: float, x: State) -> tuple[float, float, float]:
    """delta, P and y: what switches contact and comparator."""
    delta = s - c.gap - c.arm * x[0]
    push = c.contact * delta + c.contact_damping * (s_rate - c.arm * x[1])
    return delta, push, x[4] - x[5] * c.per_quality - x[6]


@compiled(inline="always")
def stepped_over(
    c: Constants,
    before: tuple[float, float, float],
    after: tuple[float, float, float],
    phase: float,
    comparator: int,
) -> bool:
    """Whether anything has switched within a step; arguments as in `switched`."""
    y = -after[2] if comparator else after[2]
    touched, touches = before[0] > 0.0 and before[1] > 0.0, after[0] > 0.0 and after[1] > 0.0
    return phase >= 0.5 or y > c.hysteresis or touched != touches


@compiled()
def switched(
    c: Constants,
    t: float,
    h: float,
    before: tuple[float, float, float],
    after: tuple[float, float, float],
    x: State,
    switches: tuple[int, int, int],
    times: Floats,
    codes: Ints,
) -> tuple[tuple[int, int, int], float]:
    """What a fixed step from `t` on has stepped over; a straight line within the step gives each event its time.

    Args:
        c, t, h: The scene and the step.
        before, after: As `watched` gives it for both ends.
        x: State at the end.
        switches: Comparator, oscillator, and number of events.
        times, codes: Of the events; written.

    Returns:
        The switches, and the phase to go on with.
    """
    delta, push, y = before
    next_delta, next_push, next_y = after
    comparator, oscillator, count = switches
    touched, touches = delta > 0.0 and push > 0.0, next_delta > 0.0 and next_push > 0.0
    if touches != touched:
        by_depth = delta <= 0.0 if touches else next_push > 0.0
        share = _share(delta, next_delta) if by_depth else _share(push, next_push)
        times[count], codes[count] = t + h * share, MADE if touches else LOST
        count += 1
    level = -c.hysteresis if comparator else c.hysteresis
    if (next_y < level) if comparator else (next_y > level):
        comparator ^= 1
        times[count] = t + h * _share(y - level, next_y - level)
        codes[count] = COMPARATOR_UP if comparator else COMPARATOR_DOWN
        count += 1
    phase = x[8]
    if phase >= 0.5:
        # what is beyond the half cycle belongs to the next: no frequency is lost to the step
        phase -= 0.5
        oscillator ^= 1
        times[count] = t + h - phase / (c.lowest_hz + c.range_hz * x[7])
        codes[count] = DRIVE_UP if oscillator else DRIVE_DOWN
        count += 1
    return (comparator, oscillator, count), phase


@compiled(fastmath=REORDERED)
def fixed(
    c: Constants,
    motion: Floats,
    outputs: int,
    substeps: int,
    first_order: bool,
    theta: Floats,
    times: Floats,
    codes: Ints,
) -> int:
    """Fixed steps, 1 / (1 kHz x substeps) long; switches act from the end of their step on.

    Args:
        c, motion: The scene.
        outputs: Number of milliseconds.
        substeps: Steps in each of them.
        first_order: Semi-implicit Euler; otherwise RK4.
        theta, times, codes: Written: the output, and the events' times and kinds.

    Returns:
        Number of events, or -1 where they do not fit.
    """
    x = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0)
    switches = (0, 0, 0)
    row = 0
    h = 1.0 / (OUTPUT_HZ * substeps)
    s, s_rate, _ = probe(motion, 0, 0.0)
    before = watched(c, s, s_rate, x)
    for step in range(outputs * substeps):
        t = step * h
        if t >= motion[row + 1, 0] - 0.5 * h:
            row += 1
            s, s_rate, _ = probe(motion, row, t)
        if switches[2] + 3 > times.size:
            return -1
        if first_order:
            x = euler(c, switches[0], switches[1], s, s_rate, h, x)
        else:
            d = derivative(c, BY_LAW, switches[0], switches[1], s, s_rate, x)
            x = rk4(c, BY_LAW, switches[0], switches[1], motion, row, t, h, x, d)
        s, s_rate, _ = probe(motion, row, t + h)
        after = watched(c, s, s_rate, x)
        if stepped_over(c, before, after, x[8], switches[0]):
            switches, phase = switched(c, t, h, before, after, x, switches, times, codes)
            x = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], phase)
        before = after
        if (step + 1) % substeps == 0:
            theta[(step + 1) // substeps - 1] = x[0]
    return switches[2]
