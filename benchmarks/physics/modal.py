"""Pieces of the finger by their eigenvectors, to 40 digits, and where a quantity of theirs rises through zero.

Another kind than the plant's solver in every respect: the seven states of (1) to (6) are a sum of complex exponentials
and a polynomial (mpmath, eigenvectors of each mode). A crossing is found by sampling twenty times per radian of the
fastest exponential that is still alive, and polishing signs, extrema and roots with all digits. A grazing touch is seen
because every maximum near zero is polished.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from mpmath import mp

from benchmarks.physics.model import Floats, Scene

DIGITS = 40
"""Of every number. The eigenvectors of the stiffest scene cost some ten of them."""

ZERO = mp.mpf(10) ** -28
"""A quantity smaller than this, relative to what it is the sum of, is zero: it began the piece."""

SAMPLES_PER_RADIAN = 20
"""Of the fastest exponential that is still alive."""

ALIVE = 60.0
"""An exponential is gone after this many of its time constants: e^-60 = 1e-26."""

THETA, OMEGA, BASE, BETA, FILTERED, HIGH_1, HIGH_2 = range(7)

Number = Any
"""mpf or mpc: mpmath has no types."""


class Basis(NamedTuple):
    """One mode's eigenvalues (those of a conjugate pair once), eigenvectors, and what forcing of omega does."""

    rates: list[Number]
    vectors: Number
    inverse: Number
    kept: list[int]
    weights: list[int]
    response: list[Number]
    """-A^-1 e, A^-2 e and A^-3 e for e = unit forcing of omega."""


class Wave(NamedTuple):
    """A quantity of a piece: the real part of sum of amplitude e^(rate t), and a polynomial of second degree."""

    rates: list[Number]
    amplitudes: list[Number]
    polynomial: list[Number]

    def at(self, t: Number) -> tuple[Number, Number, Number]:
        """Value, slope and curvature."""
        c0, c1, c2 = self.polynomial
        value, slope, bend = c0 + t * (c1 + t * c2), c1 + 2 * t * c2, 2 * c2
        for rate, amplitude in zip(self.rates, self.amplitudes, strict=True):
            term = amplitude * mp.exp(rate * t)
            value += mp.re(term)
            slope += mp.re(rate * term)
            bend += mp.re(rate * rate * term)
        return value, slope, bend

    @property
    def scale(self) -> Number:
        """What rounding is to be compared with."""
        return sum(abs(a) for a in self.amplitudes) + abs(self.polynomial[0])

    def sampled(self, t: Floats) -> tuple[Floats, Floats]:
        """Value and slope at many instants in double precision: good for signs that are not close."""
        rates = np.array([complex(rate) for rate in self.rates])
        amplitudes = np.array([complex(amplitude) for amplitude in self.amplitudes])
        c0, c1, c2 = (float(c) for c in self.polynomial)
        waves = np.exp(t[:, None] * rates) * amplitudes
        return waves.sum(axis=1).real + c0 + t * (c1 + t * c2), (waves * rates).sum(
            axis=1
        ).real + c1 + 2 * t * c2


def basis(scene: Scene, *, touching: bool) -> Basis:
    """Eigenvectors of (1) to (6) in one mode."""
    p = scene.parameters
    k, c = mp.mpf(p.joint), mp.mpf(p.joint_damping)
    inertia, base_inertia = mp.mpf(p.inertia), mp.mpf(p.base_inertia)
    pushed = int(touching) * mp.mpf(p.arm) ** 2
    a = mp.zeros(7)
    a[THETA, OMEGA] = a[BASE, BETA] = 1
    a[OMEGA, THETA] = -(k + pushed * p.contact) / inertia
    a[OMEGA, OMEGA] = -(c + pushed * p.contact_damping) / inertia
    a[OMEGA, BASE], a[OMEGA, BETA] = k / inertia, c / inertia
    a[BETA, THETA], a[BETA, OMEGA] = k / base_inertia, c / base_inertia
    a[BETA, BASE], a[BETA, BETA] = -(k + p.base) / base_inertia, -(c + p.base_damping) / base_inertia
    for column in range(FILTERED):
        a[FILTERED, column] = -mp.mpf(p.accelerometer_rad_s) * p.accelerometer_arm * a[BETA, column]
    a[FILTERED, FILTERED] = -mp.mpf(p.accelerometer_rad_s)
    high = mp.mpf(p.high_pass_rad_s)
    a[HIGH_1, FILTERED], a[HIGH_1, HIGH_1], a[HIGH_1, HIGH_2] = high, -high / p.quality, -high
    a[HIGH_2, HIGH_1] = high
    rates, vectors = mp.eig(a)
    inverse = vectors**-1
    residual = mp.mnorm(vectors * mp.diag(rates) * inverse - a) / mp.mnorm(a)
    if residual > mp.mpf(10) ** (8 - DIGITS):
        raise ArithmeticError(
            f"reference: the eigenvectors of {scene.name!r} are good to {mp.nstr(residual, 3)} only"
        )
    # the imaginary part of a real rate is what rounding leaves of the fastest
    small = mp.mpf(10) ** (DIGITS // -2)
    kept = [i for i, rate in enumerate(rates) if mp.im(rate) > -small * abs(rate)]
    weights = [2 if mp.im(rates[i]) > small * abs(rates[i]) else 1 for i in kept]
    whole = sum((w * vectors[:, i] * inverse[i, :] for i, w in zip(kept, weights, strict=True)), mp.zeros(7))
    if mp.mnorm(whole.apply(mp.re) - mp.eye(7)) > small:
        raise ArithmeticError(f"reference: the eigenvectors of {scene.name!r} are not all there")
    unit = mp.zeros(7, 1)
    unit[OMEGA] = 1
    first = mp.lu_solve(a, unit)
    second = mp.lu_solve(a, first)
    return Basis(
        [rates[i] for i in kept], vectors, inverse, kept, weights, [-first, second, -mp.lu_solve(a, second)]
    )


class Piece:
    """Between two switches.

    Args:
        basis: Of the mode.
        state: The seven states at its start.
        forcing: f0, f1, f2 of omega' in powers of the time since its start.
    """

    def __init__(self, basis: Basis, state: Sequence[Number], forcing: Sequence[Number]) -> None:
        f0, f1, f2 = forcing
        r0, r1, r2 = basis.response
        # z = c0 + c1 t + c2 t^2 solves it: A c2 = -f2, A c1 = 2 c2 - f1, A c0 = c1 - f0
        self.c2 = f2 * r0
        self.c1 = f1 * r0 - 2 * f2 * r1
        self.c0 = f0 * r0 - f1 * r1 + 2 * f2 * r2
        self.basis = basis
        self.modal = basis.inverse * (mp.matrix(state) - self.c0)

    def wave(self, row: dict[int, Number], extra: Sequence[Number] = (0, 0, 0)) -> Wave:
        """The quantity `row` . z + `extra`, a polynomial."""
        b = self.basis
        amplitudes = [
            weight * self.modal[i] * sum(factor * b.vectors[place, i] for place, factor in row.items())
            for i, weight in zip(b.kept, b.weights, strict=True)
        ]
        polynomial = [
            extra[power] + sum(factor * c[place] for place, factor in row.items())
            for power, c in enumerate((self.c0, self.c1, self.c2))
        ]
        return Wave(b.rates, amplitudes, polynomial)

    def state(self, t: Number) -> list[Number]:
        """The seven states."""
        b = self.basis
        terms = [
            w * self.modal[i] * mp.exp(r * t) for r, i, w in zip(b.rates, b.kept, b.weights, strict=True)
        ]
        return [
            mp.re(sum(term * b.vectors[place, i] for term, i in zip(terms, b.kept, strict=True)))
            + self.c0[place]
            + t * (self.c1[place] + t * self.c2[place])
            for place in range(7)
        ]


def _samples(rates: Sequence[Number], end: float) -> Iterator[Floats]:
    """Instants from 0 to `end` in pieces of ever more, dense while fast exponentials live."""
    t, count = 0.0, 64
    for size, decay in sorted(((abs(complex(r)), complex(r).real) for r in rates), reverse=True):
        gone = min(end, ALIVE / -decay) if decay < 0.0 else end
        step = 1.0 / (size * SAMPLES_PER_RADIAN)
        while t < gone:
            stop = min(gone, t + count * step)
            yield np.linspace(t, stop, max(2, math.ceil((stop - t) / step) + 1))
            t, count = stop, 2 * count
    if t < end:
        yield np.linspace(t, end, 64)


def root(function: Callable[[Number], tuple[Number, Number]], low: Number, high: Number) -> Number:
    """Where a function (value and slope) that is negative at `low` rises through zero: Newton, kept in its bracket."""
    t = (low + high) / 2
    for _ in range(500):
        value, slope = function(t)
        if value < 0:
            low = t
        else:
            high = t
        following = t - value / slope if slope != 0 else low
        if not low < following < high:
            following = (low + high) / 2
        if abs(following - t) <= abs(t) * mp.mpf(10) ** (4 - DIGITS):
            return following
        t = following
    raise ArithmeticError("reference: a root that does not converge")


def _rise(wave: Wave, low: Number, high: Number) -> Number | None:
    """First rise through zero between two samples, which have at most one extremum between them; all digits."""

    def down(t: Number) -> tuple[Number, Number]:
        _, slope, bend = wave.at(t)
        return -slope, -bend

    def up(t: Number) -> tuple[Number, Number]:
        _, slope, bend = wave.at(t)
        return slope, bend

    def level(t: Number) -> tuple[Number, Number]:
        return wave.at(t)[:2]

    (start, leaving, _), (end, arriving, _) = wave.at(low), wave.at(high)
    if low == 0 and abs(start) <= ZERO * wave.scale:
        # zero began the piece: gone up at once, or down, and then only what comes after the bottom counts
        if leaving > 0:
            return low
        if arriving <= 0:
            return None
        low = root(up, low, high)
        start, leaving = wave.at(low)[0], mp.mpf(0)
    if start > 0:
        return None
    if end > 0:
        return root(level, low, high)
    if leaving > 0 > arriving:
        top = root(down, low, high)
        if wave.at(top)[0] > 0:
            return root(level, low, top)
    return None


def rising(wave: Wave, end: Number) -> Number | None:
    """First instant in [0, end] at which a wave rises through zero. Doubles say where to look, all digits decide."""
    noise = 1e-12 * float(wave.scale)
    for t in _samples(wave.rates, float(end)):
        value, slope = wave.sampled(t)
        width = np.diff(t)
        close = (value[:-1] < noise) & (value[1:] > -noise)
        # between samples a maximum below zero may hide a rise: no higher than the tangents of both ends meet
        reach = np.minimum(value[:-1] + slope[:-1] * width, value[1:] - slope[1:] * width)
        hidden = (value[:-1] < noise) & (slope[:-1] > 0.0) & (slope[1:] < 0.0) & (reach > -noise)
        beginning = (t[:-1] == 0.0) & (abs(value[0]) <= noise)
        for i in np.nonzero(close | hidden | beginning)[0]:
            instant = _rise(wave, mp.mpf(t[i]), min(mp.mpf(t[i + 1]), end))
            if instant is not None:
                return instant
    return None
