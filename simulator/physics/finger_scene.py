"""What the finger's kernel works on: the scene's constants, the probe's plan, the present moment, the books.

Symbols and units are those of docs/explanation/finger_physics.md. Time is kept as whole seconds and a fraction, so
that a trial at 1e6 s is as exact as one at 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drivers.core.messages import Floats, Ints
from simulator.physics.finger_settings import LOCATIONS, FingerSettings
from simulator.physics.piecewise import SPAN

LOOP_STATES, STATES = 9, 11
THETA, OMEGA, BASE, BASE_RATE, FILTERED, HIGH_1, HIGH_2, CONTROL, PHASE, SLEEVE, DISTAL = range(STATES)
"""Places in the state: theta, omega, b, beta, a, g1, g2, v, phi; the tendon's stretch z in its sheath and the second
accelerometer's output a2, which is no part of the loop."""

FREE, TOUCHING, CLIPPED = range(3)
"""Modes: apart; pressed; overlapping, but the damper would pull, so that the force is zero."""

FLAGS = 6
MODE, COMPARATOR, OSCILLATOR, EXCITED, PIECE, SLIDING = range(FLAGS)
"""Places in the flags: mode; comparator, oscillator and excitation (0 or 1); number of the probe's present piece; which
way the tendon slides in its sheath (-1, 0, 1)."""

MADE, LOST, COMPARATOR_UP, COMPARATOR_DOWN, DRIVE_UP, DRIVE_DOWN = range(6)
"""Switches: contact made and lost, edges of the comparator and of the oscillator."""

NOISE_HZ = 128
"""Noise in the loop is held for 1/128 s: exact in binary, 4.6 values in a period of 28 Hz."""

WANDER_EVERY = 16
"""Wander is held for 16 of these, 1/8 s."""

_FREE_HZ = 28.0
"""Where the held noise has the density of the data sheet: the free resonance, paper IV.A."""


class FingerConstants(NamedTuple):
    """The scene's constants."""

    inertia: float
    joint: float
    joint_damping: float
    base_inertia: float
    base: float
    base_damping: float
    drive: float
    arm: float
    gap: float
    contact: float
    contact_damping: float
    filter_rad_s: float
    lever: float
    high_rad_s: float
    quality: float
    hysteresis: float
    control_rad_s: float
    lowest_hz: float
    range_hz: float
    noise: float
    wander: float
    wander_keep: float
    free_radius: float
    free_frequency: float
    touching_radius: float
    touching_frequency: float
    seed: int
    trial: int
    base_arm: float
    push_arm: float
    distal_lever: float
    friction_rad: float
    sleeve: float
    ripple: float
    ripple_rad_s: float
    drift_1_s: float
    vibration: float
    vibration_rad_s: float
    shaken_1_m: float
    restless: bool


class ProbePlan(NamedTuple):
    """The probe's plan: start of each piece (whole seconds and fraction), position, velocity, acceleration."""

    whole: Ints
    fraction: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats


class Moment(NamedTuple):
    """Where the plant stands: state, switches and time at the start of the piece under way. Changed in place.

    The time is `whole` seconds and a `fraction` in double-double, shape (2,). `wander` holds the wander's present value
    and `wander_step` its step, -1 before the first. `depth` is the overlap, carried along while there is one, because
    the state has it as a difference of what is far larger; NaN where the state alone defines it.
    """

    x: Floats
    depth: Floats
    flags: Ints
    whole: Ints
    fraction: Floats
    wander: Floats
    wander_step: Ints

    @property
    def t_s(self) -> float:
        """Start of the piece under way."""
        return float(self.whole[0] + self.fraction[0])

    def copy(self) -> Moment:
        """The same moment in arrays of its own."""
        return Moment._make(array.copy() for array in self)

    def put(self, t_s: float) -> None:
        """Change the time alone; the wander's value is no longer known."""
        self.whole[0] = math.floor(t_s)
        self.fraction[:] = t_s - math.floor(t_s), 0.0
        self.wander_step[0] = -1


class Books(NamedTuple):
    """What a run writes down; `filled` counts switches and records.

    A record is a piece: its start, its length, and the terms of acceleration and force in the fraction of its length.
    """

    switch_whole: Ints
    switch_fraction: Floats
    switch: Ints
    record_whole: Ints
    record_fraction: Floats
    record_length: Floats
    record_degree: Ints
    record_terms: Floats
    filled: Ints

    def enlarged(self) -> Books:
        """The same books with twice the places for records."""
        return self._copied(2 * self.record_whole.size)

    def copy_kept(self) -> Books:
        """The same books; what was not written in them is not copied."""
        return self._copied(self.record_whole.size)

    def _copied(self, places: int) -> Books:
        made = books_of(self.switch.size, places, self.record_terms.shape[2] - 1)
        switches, records = self.filled
        for written, (array, new) in zip(
            (*[switches] * 3, *[records] * 5, 2), zip(self, made, strict=True), strict=True
        ):
            new[:written] = array[:written]
        return made


def scene(
    s: FingerSettings, location: str, gap_m: float, tendon_m: float, key: tuple[int, int]
) -> FingerConstants:
    """The constants of a finger that is touched at a place, with its tendon at a position.

    Args:
        location: A key of `LOCATIONS`.
        gap_m: Where the probe would touch the finger at rest.
        key: Seed of the run and number of the trial.
    """
    side, arm_m, base_arm_m, contact_n_m = _touched(s, location)
    tip_m = _tip_m(s)
    joint = s.joint_n_m_rad * (1.0 + s.flexion_1_m * tendon_m)
    free_radius, free_frequency = _pace(matrix(s, joint, 0.0, 0.0))
    touching_radius, touching_frequency = _pace(_touching(s, location, joint))
    # what swings faster than the finger needs pieces as short as it
    waves = [2.0 * math.pi * s.drive_ripple_hz] if s.drive_ripple else []
    waves += [2.0 * math.pi * s.vibration_hz] if s.vibration_m_s2 else []
    free_radius, free_frequency = (max([own, *waves]) for own in (free_radius, free_frequency))
    touching_radius, touching_frequency = (
        max([own, *waves]) for own in (touching_radius, touching_frequency)
    )
    # density to the deviation of a held value, corrected for what holding it takes from the density at 28 Hz
    held = math.sqrt(NOISE_HZ / 2.0) / float(np.sinc(_FREE_HZ / NOISE_HZ))
    return FingerConstants(
        inertia=s.inertia_kg_m2,
        joint=joint,
        joint_damping=s.joint_n_m_s_rad,
        base_inertia=s.base_inertia_kg_m2,
        base=s.base_n_m_rad,
        base_damping=s.base_n_m_s_rad,
        drive=s.drive_n_m,
        arm=arm_m,
        gap=gap_m,
        contact=contact_n_m,
        contact_damping=s.contact_n_s_m,
        filter_rad_s=2.0 * math.pi * s.accelerometer_hz,
        lever=s.accelerometer_arm_m,
        high_rad_s=2.0 * math.pi * s.high_pass_hz,
        quality=s.high_pass_quality,
        hysteresis=s.hysteresis_m_s2,
        control_rad_s=2.0 * math.pi * s.loop_hz,
        lowest_hz=s.oscillator_lowest_hz,
        range_hz=s.oscillator_range_hz,
        noise=s.noise_scale * s.accelerometer_m_s2_rt_hz * held,
        wander=s.noise_scale * s.wander,
        wander_keep=math.exp(-WANDER_EVERY / NOISE_HZ / s.wander_s),
        free_radius=free_radius,
        free_frequency=free_frequency,
        touching_radius=touching_radius,
        touching_frequency=touching_frequency,
        seed=key[0],
        trial=key[1],
        base_arm=base_arm_m,
        push_arm=arm_m + s.slide_m if side != "base" else 0.0,
        distal_lever=s.distal_accelerometer_arm_m,
        friction_rad=s.tendon_friction_n_m / s.tendon_sleeve_n_m_rad,
        sleeve=s.tendon_sleeve_n_m_rad if s.tendon_friction_n_m else 0.0,
        ripple=s.drive_ripple,
        ripple_rad_s=2.0 * math.pi * s.drive_ripple_hz,
        drift_1_s=s.drift_1_s,
        vibration=s.vibration_m_s2,
        vibration_rad_s=2.0 * math.pi * s.vibration_hz,
        # a uniform rod as long as the distal link: m c / I = 1.5 / length. Assumption, for both links.
        shaken_1_m=1.5 / tip_m,
        restless=s.restless,
    )


def pieces_hz(s: FingerSettings) -> tuple[float, float]:
    """How many pieces a second of a finger takes: free, and touched where that takes most; infinite beyond floats."""
    with np.errstate(all="ignore"):
        free = matrix(s, s.joint_n_m_rad, 0.0, 0.0)
        try:
            found = np.linalg.eigvals([free, *(_touching(s, where, s.joint_n_m_rad) for where in LOCATIONS)])
        except np.linalg.LinAlgError:
            return math.inf, math.inf
    radius = np.max(np.abs(found), axis=1)
    return float(radius[0]) / SPAN, float(np.max(radius)) / SPAN


def _tip_m(s: FingerSettings) -> float:
    """From the distal joint to the distal end."""
    return s.arm_f_m + LOCATIONS["f"][1]


def _touched(s: FingerSettings, location: str) -> tuple[str, float, float, float]:
    """Side of a location, arm of a force there on the distal and on the base's axis, stiffness of the contact."""
    side, from_tip_m = LOCATIONS[location]
    contact_n_m = s.pad_n_m if side == "pad" else s.back_n_m
    return (
        (side, 0.0, s.proximal_arm_m, contact_n_m)
        if side == "base"
        else (side, _tip_m(s) - from_tip_m, 0.0, contact_n_m)
    )


def _touching(s: FingerSettings, location: str, joint: float) -> Floats:
    """`matrix` while the finger is touched at a location."""
    side, arm_m, base_arm_m, contact_n_m = _touched(s, location)
    lever_m2 = base_arm_m**2 if side == "base" else arm_m * (arm_m + abs(s.slide_m))
    return matrix(s, joint, contact_n_m * lever_m2, s.contact_n_s_m * lever_m2, side == "base")


def matrix(
    s: FingerSettings, joint: float, contact_n_m_rad: float, contact_n_m_s_rad: float, on_base: bool = False
) -> Floats:
    """A of one mode in x' = A x + f, equations (1) to (9), shape (LOOP_STATES, LOOP_STATES).

    Args:
        joint: K, N m/rad.
        contact_n_m_rad: k2 l^2 while touching, else 0.
        contact_n_m_s_rad: c2 l^2 while touching, else 0.
        on_base: The proximal link is touched.
    """
    a = np.zeros((LOOP_STATES, LOOP_STATES))
    a[THETA, OMEGA] = a[BASE, BASE_RATE] = 1.0
    for row, inertia in ((OMEGA, -s.inertia_kg_m2), (BASE_RATE, s.base_inertia_kg_m2)):
        a[row, THETA], a[row, BASE] = joint / inertia, -joint / inertia
        a[row, OMEGA], a[row, BASE_RATE] = s.joint_n_m_s_rad / inertia, -s.joint_n_m_s_rad / inertia
    angle, rate, inertia = (
        (BASE, BASE_RATE, s.base_inertia_kg_m2) if on_base else (THETA, OMEGA, s.inertia_kg_m2)
    )
    a[rate, angle] -= contact_n_m_rad / inertia
    a[rate, rate] -= contact_n_m_s_rad / inertia
    sleeve = s.tendon_sleeve_n_m_rad if s.tendon_friction_n_m else 0.0
    a[BASE_RATE, BASE] -= (s.base_n_m_rad + sleeve) / s.base_inertia_kg_m2
    a[BASE_RATE, BASE_RATE] -= s.base_n_m_s_rad / s.base_inertia_kg_m2
    filter_rad_s, high_rad_s = 2.0 * math.pi * s.accelerometer_hz, 2.0 * math.pi * s.high_pass_hz
    a[FILTERED] = -filter_rad_s * s.accelerometer_arm_m * a[BASE_RATE]
    a[FILTERED, FILTERED] -= filter_rad_s
    a[HIGH_1, FILTERED], a[HIGH_1, HIGH_2] = high_rad_s, -high_rad_s
    a[HIGH_1, HIGH_1] = -high_rad_s / s.high_pass_quality
    a[HIGH_2, HIGH_1] = high_rad_s
    a[CONTROL, CONTROL] = -2.0 * math.pi * s.loop_hz
    a[PHASE, CONTROL] = s.oscillator_range_hz
    return a


def _pace(a: Floats) -> tuple[float, float]:
    """Spectral radius and largest angular frequency of a matrix, rad/s."""
    eigenvalues = np.linalg.eigvals(a)
    return float(np.max(np.abs(eigenvalues))), float(np.max(np.abs(eigenvalues.imag)))


def at_rest() -> Moment:
    """Time 0: all at rest, the excitation off, the loop's control voltage in its middle."""
    whole, step = np.zeros(1, dtype=np.int64), np.full(1, -1, dtype=np.int64)
    depth, flags = np.full(1, math.nan), np.zeros(FLAGS, dtype=np.int64)
    moment = Moment(np.zeros(STATES), depth, flags, whole, np.zeros(2), np.zeros(1), step)
    moment.x[CONTROL] = 0.5
    return moment


def motion_of(table: Floats) -> ProbePlan:
    """The plan of a probe from rows of (start, position, velocity, acceleration), shape (n, 4)."""
    whole = np.floor(table[:, 0])
    columns = (np.ascontiguousarray(table[:, column]) for column in (1, 2, 3))
    return ProbePlan(whole.astype(np.int64), table[:, 0] - whole, *columns)


def books_of(switches: int, records: int, degree: int) -> Books:
    """Empty books with places for so many switches, and so many records of a degree."""
    return Books(
        np.empty(switches, dtype=np.int64),
        np.empty(switches),
        np.empty(switches, dtype=np.int64),
        np.empty(records, dtype=np.int64),
        np.empty(records),
        np.empty(records),
        np.empty(records, dtype=np.int64),
        np.empty((records, 3, degree + 1)),
        np.zeros(2, dtype=np.int64),
    )
