"""The reference: the finger's whole way through a scene, to 40 digits.

Seven states by eigenvectors (`modal`), control and phase (8), (9) as scalar closed forms. Written from
docs/explanation/finger_physics.md alone: it shares with the plant nothing but the numbers of the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from mpmath import mp

from benchmarks.physics.modal import (
    DIGITS,
    FILTERED,
    HIGH_1,
    HIGH_2,
    OMEGA,
    THETA,
    Number,
    Piece,
    Wave,
    basis,
    rising,
    root,
)
from benchmarks.physics.model import (
    COMPARATOR_DOWN,
    COMPARATOR_UP,
    DRIVE_DOWN,
    DRIVE_UP,
    LOST,
    MADE,
    Scene,
    Trajectory,
)

FREE, TOUCHING, CLIPPED = range(3)


def _control(control: Number, driven: int, rad_s: Number, t: Number) -> tuple[Number, Number]:
    """(8): the control after a time, and its integral over it."""
    fading = mp.exp(-rad_s * t)
    return driven + (control - driven) * fading, driven * t + (control - driven) * (1 - fading) / rad_s


class _Run:
    """The walk from switch to switch."""

    def __init__(self, scene: Scene) -> None:
        self.p = scene.parameters
        self.scene = scene
        self.bases = {touching: basis(scene, touching=touching) for touching in (False, True)}
        self.mode, self.comparator, self.oscillator = FREE, 0, 0
        self.state: list[Number] = [mp.mpf(0)] * 7
        self.control, self.phase = mp.mpf(0.5), mp.mpf(0)
        self.t = mp.mpf(0)
        self.corners = [mp.mpf(piece[0]) for piece in scene.motion] + [mp.inf]
        self.motion = 0
        self.times: list[Number] = []
        self.codes: list[int] = []
        self.grid = [mp.mpf(t) for t in scene.times_s]
        self.theta: list[float] = []

    def probe(self) -> list[Number]:
        """s in powers of the time from now on."""
        start, position, velocity, acceleration = (
            mp.mpf(number) for number in self.scene.motion[self.motion]
        )
        ago = self.t - start
        return [
            position + ago * (velocity + ago * acceleration / 2),
            velocity + ago * acceleration,
            acceleration / 2,
        ]

    def piece(self, s: Sequence[Number]) -> Piece:
        p = self.p
        u = mp.mpf(p.drive) * (2 * self.oscillator - 1)
        forcing = [u / p.inertia, mp.mpf(0), mp.mpf(0)]
        if self.mode == TOUCHING:
            lever, k, c = mp.mpf(p.arm) / p.inertia, mp.mpf(p.contact), mp.mpf(p.contact_damping)
            forcing[0] += lever * (k * (s[0] - p.gap) + c * s[1])
            forcing[1] += lever * (k * s[1] + 2 * c * s[2])
            forcing[2] += lever * k * s[2]
        return Piece(self.bases[self.mode == TOUCHING], self.state, forcing)

    def overlap(self, piece: Piece, s: Sequence[Number], sign: int) -> Wave:
        """(3): delta or minus delta."""
        extra = [sign * (s[0] - mp.mpf(self.p.gap)), sign * s[1], sign * s[2]]
        return piece.wave({THETA: -sign * mp.mpf(self.p.arm)}, extra)

    def push(self, piece: Piece, s: Sequence[Number], sign: int) -> Wave:
        """(3): P or minus P."""
        p = self.p
        k, c, arm = sign * mp.mpf(p.contact), sign * mp.mpf(p.contact_damping), mp.mpf(p.arm)
        extra = [k * (s[0] - mp.mpf(p.gap)) + c * s[1], k * s[1] + 2 * c * s[2], k * s[2]]
        return piece.wave({THETA: -k * arm, OMEGA: -c * arm}, extra)

    def ends(self, piece: Piece, s: Sequence[Number]) -> Iterator[tuple[Wave, int, int]]:
        """What can end the piece: a wave that would rise through zero, the mode and the comparator after it."""
        if self.mode == FREE:
            yield self.overlap(piece, s, 1), TOUCHING, self.comparator
        elif self.mode == TOUCHING:
            yield self.push(piece, s, -1), CLIPPED if self.p.contact_damping > 0.0 else FREE, self.comparator
        else:
            yield self.overlap(piece, s, -1), FREE, self.comparator
            yield self.push(piece, s, 1), TOUCHING, self.comparator
        sign = -1 if self.comparator else 1
        row = {FILTERED: mp.mpf(sign), HIGH_1: -sign / mp.mpf(self.p.quality), HIGH_2: -mp.mpf(sign)}
        yield piece.wave(row, (-mp.mpf(self.p.hysteresis), 0, 0)), self.mode, 1 - self.comparator

    def half_cycle(self) -> Number:
        """(9): how long until the phase reaches a half."""
        p, driven = self.p, self.comparator ^ self.oscillator
        lowest, span, rad_s = mp.mpf(p.lowest_hz), mp.mpf(p.range_hz), mp.mpf(p.control_rad_s)

        def phase(t: Number) -> tuple[Number, Number]:
            control, integral = _control(self.control, driven, rad_s, t)
            return self.phase + lowest * t + span * integral - mp.mpf(0.5), lowest + span * control

        return root(phase, mp.mpf(0), (mp.mpf(0.5) - self.phase) / lowest + mp.mpf(10) ** (6 - DIGITS))

    def book(self, code: int) -> None:
        self.times.append(self.t)
        self.codes.append(code)

    def enter(self, mode: int) -> None:
        """A new mode."""
        if mode == self.mode:
            return
        if TOUCHING in (mode, self.mode):
            self.book(MADE if mode == TOUCHING else LOST)
        self.mode = mode

    def corner(self) -> None:
        """The probe's velocity may jump, and with it P: (4) says at once which mode that is."""
        self.motion += 1
        s, arm = self.probe(), mp.mpf(self.p.arm)
        delta = s[0] - self.p.gap - arm * self.state[THETA]
        push = self.p.contact * delta + self.p.contact_damping * (s[1] - arm * self.state[OMEGA])
        if self.mode == TOUCHING and push <= 0:
            self.enter(CLIPPED if delta > 0 else FREE)
        elif self.mode == CLIPPED and push > 0:
            self.enter(TOUCHING)

    def step(self, until: Number) -> None:
        """One piece."""
        s = self.probe()
        piece = self.piece(s)
        half_s = self.half_cycle()
        end = min(half_s, self.corners[self.motion + 1] - self.t, until - self.t)
        mode, comparator = self.mode, self.comparator
        for wave, next_mode, next_comparator in self.ends(piece, s):
            instant = rising(wave, end)
            if instant is not None and instant < end:
                end, mode, comparator = instant, next_mode, next_comparator
        while len(self.theta) < len(self.grid) and self.grid[len(self.theta)] <= self.t + end:
            self.theta.append(
                float(piece.wave({THETA: mp.mpf(1)}).at(self.grid[len(self.theta)] - self.t)[0])
            )
        self.state = piece.state(end)
        driven = self.comparator ^ self.oscillator
        rad_s = mp.mpf(self.p.control_rad_s)
        self.control, integral = _control(self.control, driven, rad_s, end)
        self.phase += mp.mpf(self.p.lowest_hz) * end + mp.mpf(self.p.range_hz) * integral
        self.t += end
        if comparator != self.comparator:
            self.comparator = comparator
            self.book(COMPARATOR_UP if comparator else COMPARATOR_DOWN)
        elif mode != self.mode:
            self.enter(mode)
        elif end == half_s:
            self.phase, self.oscillator = mp.mpf(0), 1 - self.oscillator
            self.book(DRIVE_UP if self.oscillator else DRIVE_DOWN)
        elif self.t >= self.corners[self.motion + 1]:
            self.corner()


def solve(scene: Scene) -> Trajectory:
    """The scene to `DIGITS` digits, rounded to doubles at the end."""
    with mp.workdps(DIGITS):
        run, until = _Run(scene), mp.mpf(scene.times_s[-1])
        while run.t < until:
            run.step(until)
        times = np.array([float(t) for t in run.times])
    return Trajectory.from_codes(np.array(run.theta), times, np.array(run.codes, dtype=np.int64))
