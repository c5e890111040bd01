"""The equations of docs/explanation/finger_physics.md as written there, through scipy, against the plant."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.physics.finger import FingerPlant, FingerSettings

GAP_M, SPEED_M_S, END_S = 0.001, 0.03, 0.12


SWITCHED = {
    "the paper's finger": ("f", {}),
    "a tendon with friction": ("f", {"tendon_friction_n_m": 5e-5}),
    "a supply with ripple": ("f", {"drive_ripple": 0.2}),
    "an arm that vibrates": ("f", {"vibration_m_s2": 0.5, "vibration_hz": 17.0}),
    "a probe that slides": ("f", {"slide_m": 0.004}),
    "a contact on the proximal link": ("p", {"distal_accelerometer_arm_m": 0.03}),
}
"""What is not in the paper's finger, one by one: each against the same equations."""


def equations(s: FingerSettings, location: str, mode: str, comparator: int, oscillator: int, sliding: int):
    """Right-hand side and guards of one mode, (1) to (10) and what switches add."""
    arm, base_arm = (0.0, s.proximal_arm_m) if location == "p" else (s.arm_f_m, 0.0)
    stiffness = s.back_n_m if location == "p" else s.pad_n_m
    omega_h, rod_m = 2 * math.pi * s.high_pass_hz, s.arm_f_m + 0.0127
    sleeve = s.tendon_sleeve_n_m_rad if s.tendon_friction_n_m else 0.0

    def contact(t, x):
        delta = SPEED_M_S * t - GAP_M - arm * x[0] - base_arm * x[2]
        return delta, stiffness * delta + s.contact_n_s_m * (SPEED_M_S - arm * x[1] - base_arm * x[3])

    def output(x):
        return x[4] - x[5] / s.high_pass_quality - x[6]

    def rate(t, x):
        theta, omega, b, beta, a, g1, _, v, _, z, a2 = x
        bend = s.joint_n_m_rad * (theta - b) + s.joint_n_m_s_rad * (omega - beta)
        force = contact(t, x)[1] if mode == "touching" else 0.0
        drive = s.drive_n_m * (2 * oscillator - 1)
        drive *= 1 + s.drive_ripple * math.sin(2 * math.pi * s.drive_ripple_hz * t)
        shaken = s.vibration_m_s2 * math.sin(2 * math.pi * s.vibration_hz * t)
        held = base_arm * force - s.base_n_m_rad * b - s.base_n_m_s_rad * beta - sleeve * z
        beta_rate = (bend + held) / s.base_inertia_kg_m2 - 1.5 * shaken / rod_m
        push = (arm + s.slide_m) * force if location != "p" else 0.0
        omega_rate = (-bend + drive + push) / s.inertia_kg_m2 - 1.5 * shaken / rod_m
        coupling = 2 * math.pi * s.accelerometer_hz
        return [
            omega,
            omega_rate,
            beta,
            beta_rate,
            coupling * (-shaken - s.accelerometer_arm_m * beta_rate - a),
            omega_h * output(x),
            omega_h * g1,
            2 * math.pi * s.loop_hz * ((comparator ^ oscillator) - v),
            s.oscillator_lowest_hz + s.oscillator_range_hz * v,
            0.0 if sliding else beta,
            coupling * (-shaken - s.distal_accelerometer_arm_m * omega_rate - a2),
        ]

    guards: dict[str, Any] = {
        "comparator": lambda t, x: (-output(x) if comparator else output(x)) - s.hysteresis_m_s2,
        "drive": lambda t, x: x[8] - 0.5,
    }
    if sleeve and sliding:
        guards["grip"] = lambda t, x: -sliding * x[3]
    elif sleeve:
        guards["forward"] = lambda t, x: sleeve * x[9] - s.tendon_friction_n_m
        guards["back"] = lambda t, x: -sleeve * x[9] - s.tendon_friction_n_m
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


@pytest.mark.parametrize("scene", SWITCHED)
def test_the_equations_of_the_docs_are_what_the_plant_solves(scene):
    location, switched = SWITCHED[scene]
    s = FingerSettings(noise_scale=0.0, **switched)
    plant = FingerPlant(s)
    plant.begin(key=(0, 0), location=location, gap_m=GAP_M)
    plant.excite(True)
    plant.move_probe([(0.0, 0.0, SPEED_M_S, 0.0)])
    plant.advance(END_S, frozenset({"switches", "distal"}))
    ours = plant.switches()

    t, x = 0.0, np.array([0.0] * 7 + [0.5, 0.0, 0.0, 0.0])
    mode, comparator, oscillator, sliding, slid = "free", 0, 0, 0, 0
    theirs = []
    while t < END_S:
        rate, guards = equations(s, location, mode, comparator, oscillator, sliding)
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
        elif name is not None:
            sliding = {"grip": 0, "forward": 1, "back": -1}[name]
            x[9] *= 1 - 1e-12  # gripped, it does not slide on by rounding
            slid += 1
    assert (slid > 2) == ("tendon_friction_n_m" in switched)
    assert [kind for _, kind in ours] == [kind for _, kind in theirs]
    assert "made" in {kind for _, kind in ours}
    assert [t for t, _ in ours] == pytest.approx([t for t, _ in theirs], abs=1e-10)
    assert plant.theta_rad == pytest.approx(x[0], abs=1e-10)
    assert plant.sample("distal", np.array([END_S])) == pytest.approx(x[10], abs=1e-7)
