"""The core of every plant that is piecewise linear: exact pieces, and the instants at which one piece ends.

Within a piece a plant obeys x' = A x + f0 + f1 t + f2 t^2 with constant A, t counted from the piece's own start. The
solution is an entire function of time: its power series, stopped where the rest is below rounding, is the closed form.
A plant writes the recursion for its series; every quantity that can end a piece is then a polynomial of the same kind.

Time inside a piece is a fraction u in [0, 1] of the piece's length, so that coefficient k is the k-th term itself: sums
of coefficients are values at the end, sums of their magnitudes are bounds.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled
from drivers.core.messages import Floats

SPAN = 3.2
"""Longest piece times the spectral radius of A: longer ones would lose digits to terms that cancel."""

DEGREE = 30
"""Highest of the series: the first term left out at `SPAN` is 3.2^31 / 31! = 6e-19 of the state."""

BRACKET = 0.8
"""A search begins with steps of this many radians of the fastest oscillation; it halves those that prove too long."""

ROUNDING = 4e-15
"""A quantity that starts this close to zero, against the sum of its terms, starts at zero."""

NEAR = 1e-11
"""A Newton step as small as this, relative, is the last: its own error is of the order of its square."""

_REST = 1e-17
"""What a series may leave out, relative to the state."""


def _degrees(resolution: int) -> NDArray[np.int64]:
    """Degree that leaves `_REST` out, by length times spectral radius in steps of 1 / `resolution`, shape (n,)."""
    degrees = np.empty(int(SPAN * resolution) + 2, dtype=np.int64)
    for i in range(degrees.size):
        reach = (i + 1) / resolution
        degree = 3  # forcing that is quadratic in time needs the cubic term
        while reach ** (degree + 1) / math.factorial(degree + 1) > _REST and degree < DEGREE:
            degree += 1
        degrees[i] = degree
    return degrees


_RESOLUTION = 32
_DEGREES = _degrees(_RESOLUTION)


@compiled()
def degree_for(reach: float) -> int:
    """Degree of the series for a piece whose length times the spectral radius is `reach`, at most `SPAN`."""
    return int(_DEGREES[int(reach * _RESOLUTION)])


@compiled()
def parts_for(reach: float) -> int:
    """Into how many steps a search divides a piece whose length times the largest angular frequency is `reach`."""
    return int(reach / BRACKET) + 1


@compiled()
def value_slope(terms: Floats, degree: int, u: float) -> tuple[float, float]:
    """A polynomial and its derivative at `u`."""
    total, rate = terms[degree], 0.0
    for k in range(degree - 1, -1, -1):
        rate = rate * u + total
        total = total * u + terms[k]
    return total, rate


@compiled()
def _look(terms: Floats, degree: int, v: float) -> tuple[float, float, float, float, float, float]:
    """A polynomial and two derivatives at `v`; bounds of its second, third and fourth in all of [0, v]."""
    last = terms[degree]
    total, rate, bend = last, 0.0, 0.0
    size, first, second, third, fourth = abs(last), 0.0, 0.0, 0.0, 0.0
    for k in range(degree - 1, -1, -1):
        term = terms[k]
        bend = bend * v + rate
        rate = rate * v + total
        total = total * v + term
        fourth = fourth * v + third
        third = third * v + second
        second = second * v + first
        first = first * v + size
        size = size * v + abs(term)
    return total, rate, 2.0 * bend, 2.0 * second, 6.0 * third, 24.0 * fourth


@compiled()
def _slope_bend(terms: Floats, degree: int, u: float) -> tuple[float, float]:
    """The first two derivatives of a polynomial at `u`."""
    rate, bend = degree * terms[degree], 0.0
    for k in range(degree - 1, 0, -1):
        bend = bend * u + rate
        rate = rate * u + k * terms[k]
    return rate, bend


@compiled()
def _root(
    terms: Floats, degree: int, sign: float, level: float, low: float, high: float, start: float
) -> float:
    """Where `sign` times a polynomial, below `level` at `low` and above it at `high`, is `level`: bracketed Newton."""
    u = start
    for _ in range(100):
        g, rate = value_slope(terms, degree, u)
        g, rate = sign * g - level, sign * rate
        if g == 0.0:
            return u
        if g > 0.0:
            high = u
        else:
            low = u
        following = u - g / rate if rate > 0.0 else -1.0
        if abs(following - u) <= NEAR * u:
            return min(max(following, low), high)
        u = following if low < following < high else 0.5 * (low + high)
        if not low < u < high:
            return u
    return u


@compiled()
def _extremum(terms: Floats, degree: int, sign: float, low: float, high: float) -> float:
    """Where `sign` times the derivative of a polynomial rises through zero: bracketed Newton."""
    u = 0.5 * (low + high)
    for _ in range(100):
        rate, bend = _slope_bend(terms, degree, u)
        rate, bend = sign * rate, sign * bend
        if rate == 0.0:
            return u
        if rate > 0.0:
            high = u
        else:
            low = u
        following = u - rate / bend if bend > 0.0 else -1.0
        if abs(following - u) <= 4e-16 * u:
            return min(max(following, low), high)
        u = following if low < following < high else 0.5 * (low + high)
        if not low < u < high:
            return u
    return u


@compiled()
def _search(
    terms: Floats, degree: int, parts: int, sign: float, level: float, armed: bool, nothing: float
) -> float:
    """What `rising` returns, found step by step; `armed`: begins below the level; `nothing`: what rounding may hide.

    No frequency bounds how far apart extrema are: a sum of exponentials and a parabola can turn twice in no time. So a
    step counts when it is proved to hold one at most, or nothing above the level, and is halved until it is. The proof:
    a function is no further from its chord than the step squared times an eighth of the bound of its second derivative.
    """
    g, rate, bend = sign * terms[0] - level, sign * terms[1], 2.0 * sign * terms[2]
    u, longest = 0.0, 1.0 / parts
    step = longest
    while u < 1.0:
        v = u + step if u + step < 1.0 - 0.5 * step else 1.0
        if not v > u:
            return math.inf  # what is not finite proves nothing
        g_v, rate_v, bend_v, second, third, fourth = _look(terms, degree, v)
        g_v, rate_v, bend_v = sign * g_v - level, sign * rate_v, sign * bend_v
        eighth = 0.125 * (v - u) * (v - u)
        if not (armed and max(g, g_v) + eighth * second < 0.0):
            if not (
                max(rate, rate_v) < -eighth * third
                or min(rate, rate_v) > eighth * third
                or max(bend, bend_v) < -eighth * fourth
                or min(bend, bend_v) > eighth * fourth
                or eighth * third * (v - u) <= nothing
            ):
                step = 0.5 * (v - u)
                continue
            if not armed:
                if rate >= 0.0 and g_v > 0.0:
                    return u
                if rate < 0.0 < rate_v:
                    # leaves downwards: what comes after the bottom of the dip can be a crossing
                    u = _extremum(terms, degree, sign, u, v)
                    g, rate = sign * value_slope(terms, degree, u)[0] - level, 0.0
                    if g >= 0.0:
                        return u
                armed = min(g, g_v) < 0.0
            top, g_top = v, g_v
            if armed and g_v <= 0.0 and rate > 0.0 > rate_v:
                top = _extremum(terms, degree, -sign, u, v)
                g_top = sign * value_slope(terms, degree, top)[0] - level
            if armed and g < 0.0 < g_top:
                return _root(terms, degree, sign, level, u, top, u + (top - u) * g / (g - g_top))
            if armed and g < 0.0 and g_v == 0.0 and rate_v > 0.0:
                return v  # the crossing is the step's end itself, and would be seen from neither side
        u, g, rate, bend, step = v, g_v, rate_v, bend_v, min(2.0 * step, longest)
    return math.inf


@compiled()
def rising(terms: Floats, degree: int, parts: int, sign: float, level: float) -> float:
    """First u in [0, 1] at which `sign` times a polynomial rises through `level`, or infinity.

    A start above the level that does not fall is a crossing at 0: the piece began with its end already due; one that
    falls is due when it stops falling, unless it comes below the level before. A start at the level, within rounding,
    that falls is none: this is how the piece before ended. Extrema are found to the last bit, so that a graze counts
    if and only if its top is above the level.

    Args:
        terms: Of the polynomial, shape (degree + 1,) or more.
        degree: Highest term that counts, 2 or more.
        parts: Steps with which the search begins, from `parts_for`.
        sign: 1 or -1.
    """
    g = sign * terms[0] - level
    # in [0, 1] a polynomial is a weighted mean of its partial sums
    size, turning, partial, highest = 0.0, 0.0, g, g
    for k in range(1, degree + 1):
        size += abs(terms[k])
        turning += k * abs(terms[k])
        partial += sign * terms[k]
        highest = max(highest, partial)
    if highest < -ROUNDING * size:
        return math.inf
    rate = sign * terms[1]
    nothing = ROUNDING * (size + abs(level))
    armed = g < -nothing
    if not armed and rate >= 0.0 and (g > 0.0 or rate > nothing):
        return 0.0
    if armed and 2.0 * rate > turning:
        # the slope outweighs all that could change it: one crossing at most
        return _root(terms, degree, sign, level, 0.0, 1.0, g / (g - partial)) if partial > 0.0 else math.inf
    return _search(terms, degree, parts, sign, level, armed, nothing)
