"""The right-hand side that every rival integrates, and the quantities that switch it. Compiled, in registers.

Equations (1) to (10) of docs/explanation/finger_physics.md, as one writes them without knowing that they are linear.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.physics.model import Motion, Scene
from drivers.compiled import compiled

Floats = NDArray[np.float64]

State = tuple[float, float, float, float, float, float, float, float, float]
"""theta, omega, b, beta, a, g1, g2, v, phi."""

FREE, TOUCHING, CLIPPED = range(3)
"""Modes."""


REORDERED = {"contract", "reassoc", "nsz", "arcp"}
"""Freedom that the compiler gets with the rivals' arithmetic: a third faster, and rounding is not what limits them."""


class Constants(NamedTuple):
    """Every number of equations (1) to (10), SI units, with reciprocals: no compiled rival divides."""

    per_inertia: float
    joint: float
    joint_damping: float
    per_base_inertia: float
    base: float
    base_damping: float
    drive: float
    arm: float
    gap: float
    contact: float
    contact_damping: float
    accelerometer_arm: float
    accelerometer_rad_s: float
    high_pass_rad_s: float
    per_quality: float
    hysteresis: float
    control_rad_s: float
    lowest_hz: float
    range_hz: float


def constants(scene: Scene) -> Constants:
    """What the compiled code wants."""
    s = scene.settings
    return Constants(
        per_inertia=1.0 / s.inertia_kg_m2,
        joint=s.joint_n_m_rad,
        joint_damping=s.joint_n_m_s_rad,
        per_base_inertia=1.0 / s.base_inertia_kg_m2,
        base=s.base_n_m_rad,
        base_damping=s.base_n_m_s_rad,
        drive=s.drive_n_m,
        arm=s.arm_f_m,
        gap=scene.gap_m,
        contact=s.pad_n_m,
        contact_damping=s.contact_n_s_m,
        accelerometer_arm=s.accelerometer_arm_m,
        accelerometer_rad_s=2.0 * math.pi * s.accelerometer_hz,
        high_pass_rad_s=2.0 * math.pi * s.high_pass_hz,
        per_quality=1.0 / s.high_pass_quality,
        hysteresis=s.hysteresis_m_s2,
        control_rad_s=2.0 * math.pi * s.loop_hz,
        lowest_hz=s.oscillator_lowest_hz,
        range_hz=s.oscillator_range_hz,
    )


def motion_table(motion: Motion) -> Floats:
    """The probe's plan for compiled code, shape (pieces + 1, 4): the last row starts at infinity."""
    return np.array([*motion, (np.inf, 0.0, 0.0, 0.0)])


@compiled(inline="always")
def probe(motion: Floats, row: int, t: float) -> tuple[float, float, float]:
    """Position, velocity and acceleration of the probe in the piece `row` of its plan."""
    ago = t - motion[row, 0]
    velocity, acceleration = motion[row, 2], motion[row, 3]
    return (
        motion[row, 1] + ago * (velocity + 0.5 * acceleration * ago),
        velocity + acceleration * ago,
        acceleration,
    )


@compiled(inline="always")
def derivative(
    c: Constants, mode: int, comparator: int, oscillator: int, s: float, s_rate: float, x: State
) -> State:
    """d x / d t."""
    theta, omega, b, beta, a, g1, g2, v, _ = x
    delta, rate = s - c.gap - c.arm * theta, s_rate - c.arm * omega
    force = c.contact * delta + c.contact_damping * rate if mode == TOUCHING else 0.0
    joint = c.joint * (theta - b) + c.joint_damping * (omega - beta)
    u = c.drive if oscillator else -c.drive
    beta_rate = (joint - c.base * b - c.base_damping * beta) * c.per_base_inertia
    y = a - g1 * c.per_quality - g2
    return (
        omega,
        (u + c.arm * force - joint) * c.per_inertia,
        beta,
        beta_rate,
        -c.accelerometer_rad_s * (c.accelerometer_arm * beta_rate + a),
        c.high_pass_rad_s * y,
        c.high_pass_rad_s * g1,
        c.control_rad_s * ((comparator ^ oscillator) - v),
        c.lowest_hz + c.range_hz * v,
    )


@compiled(inline="always")
def moved(x: State, h: float, d: State) -> State:
    """x + h d."""
    return (
        x[0] + h * d[0],
        x[1] + h * d[1],
        x[2] + h * d[2],
        x[3] + h * d[3],
        x[4] + h * d[4],
        x[5] + h * d[5],
        x[6] + h * d[6],
        x[7] + h * d[7],
        x[8] + h * d[8],
    )


@compiled(inline="always")
def rk4(
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
    """One classical Runge-Kutta step of length `h`; `d1` is the derivative at its start."""
    middle, middle_rate, _ = probe(motion, row, t + 0.5 * h)
    end, end_rate, _ = probe(motion, row, t + h)
    d2 = derivative(c, mode, comparator, oscillator, middle, middle_rate, moved(x, 0.5 * h, d1))
    d3 = derivative(c, mode, comparator, oscillator, middle, middle_rate, moved(x, 0.5 * h, d2))
    d4 = derivative(c, mode, comparator, oscillator, end, end_rate, moved(x, h, d3))
    w = h / 6.0
    return (
        x[0] + w * (d1[0] + 2.0 * (d2[0] + d3[0]) + d4[0]),
        x[1] + w * (d1[1] + 2.0 * (d2[1] + d3[1]) + d4[1]),
        x[2] + w * (d1[2] + 2.0 * (d2[2] + d3[2]) + d4[2]),
        x[3] + w * (d1[3] + 2.0 * (d2[3] + d3[3]) + d4[3]),
        x[4] + w * (d1[4] + 2.0 * (d2[4] + d3[4]) + d4[4]),
        x[5] + w * (d1[5] + 2.0 * (d2[5] + d3[5]) + d4[5]),
        x[6] + w * (d1[6] + 2.0 * (d2[6] + d3[6]) + d4[6]),
        x[7] + w * (d1[7] + 2.0 * (d2[7] + d3[7]) + d4[7]),
        x[8] + w * (d1[8] + 2.0 * (d2[8] + d3[8]) + d4[8]),
    )
