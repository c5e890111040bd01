"""The equations of docs/explanation/finger_physics.md as written there, through scipy, against the plant."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.mock.physics.finger import FingerPlant, FingerSettings

GAP_M, SPEED_M_S, END_S = 0.001, 0.03, 0.12


def equations(s: FingerSettings, mode: str, comparator: int, oscillator: int):
    """Right-hand side and guards of one mode, (1) to (10)."""
    arm, omega_h = s.arm_f_m, 2 * math.pi * s.high_pass_hz

    def contact(t, x):
        delta = SPEED_M_S * t - GAP_M - arm * x[0]
        return delta, s.pad_n_m * delta + s.contact_n_s_m * (SPEED_M_S - arm * x[1])

    def output(x):
        return x[4] - x[5] / s.high_pass_quality - x[6]

    def rate(t, x):
        theta, omega, b, beta, a, g1, _, v, _ = x
        bend = s.joint_n_m_rad * (theta - b) + s.joint_n_m_s_rad * (omega - beta)
        force = contact(t, x)[1] if mode == "touching" else 0.0
        drive = s.drive_n_m * (2 * oscillator - 1)
        beta_rate = (bend - s.base_n_m_rad * b - s.base_n_m_s_rad * beta) / s.base_inertia_kg_m2
        return [
            omega,
            (-bend + drive + arm * force) / s.inertia_kg_m2,
            beta,
            beta_rate,
            2 * math.pi * s.accelerometer_hz * (-s.accelerometer_arm_m * beta_rate - a),
            omega_h * output(x),
            omega_h * g1,
            2 * math.pi * s.loop_hz * ((comparator ^ oscillator) - v),
            s.oscillator_lowest_hz + s.oscillator_range_hz * v,
        ]

    guards: dict[str, Any] = {
        "comparator": lambda t, x: (-output(x) if comparator else output(x)) - s.hysteresis_m_s2,
        "drive": lambda t, x: x[8] - 0.5,
    }
    if mode == "free":
        guards["made"] = lambda t, x: contact(t, x)[0]
    elif mode == "touching":
        guards["lost"] = lambda t, x: -contact(t, x)[1]
    else:
        guards["apart"] = lambda t, x: -contact(t, x)[0]
        guards["made"] = lambda t, x: contact(t, x)[1]
    for guard in guards.values():
        guard.terminal, guard.direction = True, 1.0
    return rate, guards


def test_the_equations_of_the_docs_are_what_the_plant_solves():
    s = FingerSettings(noise_scale=0.0)
    plant = FingerPlant(s)
    plant.begin(key=(0, 0), gap_m=GAP_M)
    plant.excite(True)
    plant.move_probe([(0.0, 0.0, SPEED_M_S, 0.0)])
    plant.advance(END_S, frozenset({"switches"}))
    ours = plant.switches()

    t, x = 0.0, np.array([0.0] * 7 + [0.5, 0.0])
    mode, comparator, oscillator = "free", 0, 0
    theirs = []
    while t < END_S:
        rate, guards = equations(s, mode, comparator, oscillator)
        # a step shorter than a millisecond: an event that comes and goes within a step is not seen
        found = solve_ivp(
            rate, (t, END_S), x, "DOP853", events=list(guards.values()), rtol=1e-12, atol=1e-15, max_step=1e-3
        )
        t, x = found.t[-1], found.y[:, -1]
        name = next((name for name, times in zip(guards, found.t_events, strict=True) if times.size), None)
        if name == "comparator":
            comparator ^= 1
            theirs.append((t, "comparator_up" if comparator else "comparator_down"))
        elif name == "drive":
            oscillator, x[8] = oscillator ^ 1, 0.0
            theirs.append((t, "drive_up" if oscillator else "drive_down"))
        elif name in ("made", "lost"):
            mode = "touching" if name == "made" else "clipped"
            theirs.append((t, name))
        elif name == "apart":
            mode = "free"
    assert [kind for _, kind in ours] == [kind for _, kind in theirs]
    assert "made" in {kind for _, kind in ours}
    assert [t for t, _ in ours] == pytest.approx([t for t, _ in theirs], abs=1e-10)
    assert plant.theta_rad == pytest.approx(x[0], abs=1e-10)
