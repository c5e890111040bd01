"""One step of the eighth-order method of Dormand and Prince (DOP853's, tableau from scipy), compiled.

The strongest rival that we know: with steps of 1 ms it is as accurate as RK4 with 10 us. Written out stage by stage,
for a loop over the tableau takes twice as long.
"""

from __future__ import annotations

from scipy.integrate._ivp import dop853_coefficients as tableau

from benchmarks.physics.dynamics import REORDERED, Constants, Floats, State, derivative, moved, probe
from drivers.compiled import compiled

A = tuple(tuple(row) for row in tableau.A[: tableau.N_STAGES, : tableau.N_STAGES].tolist())
B = tuple(tableau.B.tolist())
C = tuple(tableau.C[: tableau.N_STAGES].tolist())
"""The tableau; what is zero in it is left out below."""


@compiled(fastmath=REORDERED)
def _rates(
    c: Constants, mode: int, comparator: int, oscillator: int, motion: Floats, row: int, t: float, x: State
) -> State:
    """The derivative at a stage, as a call: inlined twelve times it takes long to compile and is not faster."""
    s, s_rate, _ = probe(motion, row, t)
    return derivative(c, mode, comparator, oscillator, s, s_rate, x)


@compiled(fastmath=REORDERED)
def _plus(x: State, h: float, d: State) -> State:
    """x + h d, as a call too."""
    return moved(x, h, d)


@compiled(fastmath=REORDERED)
def rk8(  # noqa: PLR0915 - a line for every number of the tableau
    c: Constants,
    mode: int,
    comparator: int,
    oscillator: int,
    motion: Floats,
    row: int,
    t: float,
    h: float,
    x: State,
    d1: State,
) -> State:
    """One step of length `h`; `d1` is the derivative at its start."""
    y = _plus(x, h * A[1][0], d1)
    d2 = _rates(c, mode, comparator, oscillator, motion, row, t + C[1] * h, y)
    y = _plus(x, h * A[2][0], d1)
    y = _plus(y, h * A[2][1], d2)
    d3 = _rates(c, mode, comparator, oscillator, motion, row, t + C[2] * h, y)
    y = _plus(x, h * A[3][0], d1)
    y = _plus(y, h * A[3][2], d3)
    d4 = _rates(c, mode, comparator, oscillator, motion, row, t + C[3] * h, y)
    y = _plus(x, h * A[4][0], d1)
    y = _plus(y, h * A[4][2], d3)
    y = _plus(y, h * A[4][3], d4)
    d5 = _rates(c, mode, comparator, oscillator, motion, row, t + C[4] * h, y)
    y = _plus(x, h * A[5][0], d1)
    y = _plus(y, h * A[5][3], d4)
    y = _plus(y, h * A[5][4], d5)
    d6 = _rates(c, mode, comparator, oscillator, motion, row, t + C[5] * h, y)
    y = _plus(x, h * A[6][0], d1)
    y = _plus(y, h * A[6][3], d4)
    y = _plus(y, h * A[6][4], d5)
    y = _plus(y, h * A[6][5], d6)
    d7 = _rates(c, mode, comparator, oscillator, motion, row, t + C[6] * h, y)
    y = _plus(x, h * A[7][0], d1)
    y = _plus(y, h * A[7][3], d4)
    y = _plus(y, h * A[7][4], d5)
    y = _plus(y, h * A[7][5], d6)
    y = _plus(y, h * A[7][6], d7)
    d8 = _rates(c, mode, comparator, oscillator, motion, row, t + C[7] * h, y)
    y = _plus(x, h * A[8][0], d1)
    y = _plus(y, h * A[8][3], d4)
    y = _plus(y, h * A[8][4], d5)
    y = _plus(y, h * A[8][5], d6)
    y = _plus(y, h * A[8][6], d7)
    y = _plus(y, h * A[8][7], d8)
    d9 = _rates(c, mode, comparator, oscillator, motion, row, t + C[8] * h, y)
    y = _plus(x, h * A[9][0], d1)
    y = _plus(y, h * A[9][3], d4)
    y = _plus(y, h * A[9][4], d5)
    y = _plus(y, h * A[9][5], d6)
    y = _plus(y, h * A[9][6], d7)
    y = _plus(y, h * A[9][7], d8)
    y = _plus(y, h * A[9][8], d9)
    d10 = _rates(c, mode, comparator, oscillator, motion, row, t + C[9] * h, y)
    y = _plus(x, h * A[10][0], d1)
    y = _plus(y, h * A[10][3], d4)
    y = _plus(y, h * A[10][4], d5)
    y = _plus(y, h * A[10][5], d6)
    y = _plus(y, h * A[10][6], d7)
    y = _plus(y, h * A[10][7], d8)
    y = _plus(y, h * A[10][8], d9)
    y = _plus(y, h * A[10][9], d10)
    d11 = _rates(c, mode, comparator, oscillator, motion, row, t + C[10] * h, y)
    y = _plus(x, h * A[11][0], d1)
    y = _plus(y, h * A[11][3], d4)
    y = _plus(y, h * A[11][4], d5)
    y = _plus(y, h * A[11][5], d6)
    y = _plus(y, h * A[11][6], d7)
    y = _plus(y, h * A[11][7], d8)
    y = _plus(y, h * A[11][8], d9)
    y = _plus(y, h * A[11][9], d10)
    y = _plus(y, h * A[11][10], d11)
    d12 = _rates(c, mode, comparator, oscillator, motion, row, t + C[11] * h, y)
    y = _plus(x, h * B[0], d1)
    y = _plus(y, h * B[5], d6)
    y = _plus(y, h * B[6], d7)
    y = _plus(y, h * B[7], d8)
    y = _plus(y, h * B[8], d9)
    y = _plus(y, h * B[9], d10)
    y = _plus(y, h * B[10], d11)
    return _plus(y, h * B[11], d12)
