"""What switches the finger within a step: looked at through cubics between the step's ends. Compiled."""

from __future__ import annotations

import numpy as np

from benchmarks.physics.dynamics import CLIPPED, FREE, TOUCHING, Constants, State
from benchmarks.physics.model import COMPARATOR_DOWN, COMPARATOR_UP, DRIVE_DOWN, DRIVE_UP, LOST, MADE
from drivers.compiled import compiled

Probe = tuple[float, float, float]
"""Position, velocity and acceleration of the probe."""

CONTACT, PRESSURE, COMPARATOR, PHASE, GUARDS = range(5)
"""What can switch: the end of the mode, renewed pressure in the clipped mode, the comparator, the half cycle."""

SETTLED_S = 1e-16
"""A located event has converged when Newton moves it by no more: half the spacing of doubles at 1 s."""


@compiled(inline="always")
def guard_of(
    c: Constants, which: int, mode: int, comparator: int, s: Probe, x: State, d: State
) -> tuple[float, float]:
    """A quantity that switches when it rises through zero, and its slope."""
    if which == PHASE:
        return x[8] - 0.5, d[8]
    if which == COMPARATOR:
        sign = -1.0 if comparator else 1.0
        return (
            sign * (x[4] - x[5] * c.per_quality - x[6]) - c.hysteresis,
            sign * (d[4] - d[5] * c.per_quality - d[6]),
        )
    delta, rate = s[0] - c.gap - c.arm * x[0], s[1] - c.arm * x[1]
    if which == CONTACT and mode == FREE:
        return delta, rate
    if which == CONTACT and mode == CLIPPED:
        return -delta, -rate
    if which == PRESSURE and mode != CLIPPED:
        return -1.0, 0.0
    sign = -1.0 if mode == TOUCHING else 1.0
    push = c.contact * delta + c.contact_damping * rate
    return sign * push, sign * (c.contact * rate + c.contact_damping * (s[2] - c.arm * d[1]))


@compiled(inline="always")
def _flat(g0: float, slope0: float, g1: float, slope1: float) -> bool:
    """Whether a guard stays below zero in a step: it is at both ends, and has no maximum inside."""
    return g0 <= 0.0 and g1 <= 0.0 and not (slope0 > 0.0 and slope1 < 0.0)


@compiled(inline="always")
def quiet(
    c: Constants,
    mode: int,
    comparator: int,
    s0: Probe,
    x0: State,
    d0: State,
    s1: Probe,
    x1: State,
    d1: State,
) -> bool:
    """Whether nothing can have switched in a step: the cheap question before the exact one."""
    if mode == CLIPPED or x1[8] >= 0.5:
        return False
    g0, slope0 = guard_of(c, COMPARATOR, mode, comparator, s0, x0, d0)
    g1, slope1 = guard_of(c, COMPARATOR, mode, comparator, s1, x1, d1)
    if not _flat(g0, slope0, g1, slope1):
        return False
    g0, slope0 = guard_of(c, CONTACT, mode, comparator, s0, x0, d0)
    g1, slope1 = guard_of(c, CONTACT, mode, comparator, s1, x1, d1)
    return _flat(g0, slope0, g1, slope1)


@compiled()
def _hermite(
    g0: float, slope0: float, g1: float, slope1: float, h: float, tau: float
) -> tuple[float, float, float]:
    """The cubic through values and slopes at 0 and `h`: value, slope and curvature at `tau`."""
    rise = (g1 - g0) / h
    quadratic = (3.0 * rise - 2.0 * slope0 - slope1) / h
    cubic = (slope0 + slope1 - 2.0 * rise) / (h * h)
    return (
        g0 + tau * (slope0 + tau * (quadratic + tau * cubic)),
        slope0 + tau * (2.0 * quadratic + 3.0 * tau * cubic),
        2.0 * quadratic + 6.0 * tau * cubic,
    )


@compiled()
def _cubic_root(
    g0: float,
    slope0: float,
    g1: float,
    slope1: float,
    h: float,
    low: float,
    high: float,
    sign: float,
    extremum: bool,
) -> float:
    """Where `sign` times the cubic (or its slope) rises through zero in a bracket: Newton, kept inside."""
    tau = 0.5 * (low + high)
    for _ in range(60):
        value, slope, bend = _hermite(g0, slope0, g1, slope1, h, tau)
        g, steepness = (sign * slope, sign * bend) if extremum else (sign * value, sign * slope)
        if g > 0.0:
            high = tau
        else:
            low = tau
        following = tau - g / steepness if steepness != 0.0 else low
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - tau) <= 1e-3 * SETTLED_S + 1e-6 * abs(tau):
            return following
        tau = following
    return tau


@compiled()
def _crossing(g0: float, slope0: float, g1: float, slope1: float, h: float) -> float:
    """Where a guard rises through zero within a step, by its cubic; infinity where it does not."""
    if g0 > 0.0 and slope0 >= 0.0:
        return 0.0
    low, high = 0.0, h
    if g1 > 0.0:
        if slope0 < 0.0 and slope1 > 0.0:
            low = _cubic_root(g0, slope0, g1, slope1, h, 0.0, h, 1.0, True)
    elif slope0 > 0.0 and slope1 < 0.0:
        high = _cubic_root(g0, slope0, g1, slope1, h, 0.0, h, -1.0, True)
        if _hermite(g0, slope0, g1, slope1, h, high)[0] <= 0.0:
            return np.inf
    else:
        return np.inf
    return _cubic_root(g0, slope0, g1, slope1, h, low, high, 1.0, False)


@compiled()
def mode_by_law(c: Constants, mode: int, s: Probe, x: State) -> int:
    """(4) at a corner of the probe's plan, where P jumps with the probe's velocity."""
    delta = s[0] - c.gap - c.arm * x[0]
    push = c.contact * delta + c.contact_damping * (s[1] - c.arm * x[1])
    if mode == TOUCHING and push <= 0.0:
        return CLIPPED if delta > 0.0 else FREE
    return TOUCHING if mode == CLIPPED and push > 0.0 else mode


@compiled()
def switched(
    c: Constants, which: int, mode: int, comparator: int, oscillator: int
) -> tuple[int, int, int, int]:
    """The switches after an event, and the event's kind, or -1 where it is none that is counted."""
    if which == PHASE:
        return mode, comparator, 1 - oscillator, DRIVE_DOWN if oscillator else DRIVE_UP
    if which == COMPARATOR:
        return mode, 1 - comparator, oscillator, COMPARATOR_DOWN if comparator else COMPARATOR_UP
    if mode == FREE or which == PRESSURE:
        return TOUCHING, comparator, oscillator, MADE
    if mode == TOUCHING:
        return CLIPPED if c.contact_damping > 0.0 else FREE, comparator, oscillator, LOST
    return FREE, comparator, oscillator, -1


@compiled()
def overtaken(c: Constants, which: int, mode: int, comparator: int, s: Probe, x: State, d: State) -> int:
    """Another guard that is already above zero and rising where `which` has just reached it, or `which`."""
    for guard in range(GUARDS):
        g, slope = guard_of(c, guard, mode, comparator, s, x, d)
        if guard != which and g > 0.0 and slope > 0.0 and g > SETTLED_S * slope:
            return guard
    return which


@compiled()
def first(
    c: Constants,
    mode: int,
    comparator: int,
    h: float,
    s0: Probe,
    x0: State,
    d0: State,
    s1: Probe,
    x1: State,
    d1: State,
) -> tuple[int, float]:
    """What switches first within a step, by the cubics, and when; -1 where nothing does."""
    which, tau = -1, np.inf
    for guard in range(GUARDS):
        g0, slope0 = guard_of(c, guard, mode, comparator, s0, x0, d0)
        g1, slope1 = guard_of(c, guard, mode, comparator, s1, x1, d1)
        estimate = _crossing(g0, slope0, g1, slope1, h)
        if estimate < tau:
            which, tau = guard, estimate
    return which, tau
