"""Cost and error of the tip on its table beside textbook integrators: python -m benchmarks tip [--quick].

Simulated: a tip dragged at constant speed sticks and slips. Error: largest difference of the force from an independent
solution (`tests/stability/tip_oracles.py`: DOP853 at 1e-12 between located events), as a share of the friction.
Times are processor time, side by side in one process.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.results import save
from drivers.core.compiled import compiled
from simulator.physics.slip import SlipPlant, SlipPlantSettings
from tests.stability.tip_oracles import PRESS_M, bare, reference

Floats = NDArray[np.float64]

SCENES: Mapping[str, tuple[dict[str, float], float, float]] = {
    "fingertip": ({"static_excess": 0.2}, 0.003, 0.6),
    "chatter": ({"static_excess": 0.2, "contact_ratio": 10.0}, 0.003, 0.5),
}
"""Settings, speed (m/s) and length (s). `chatter`: a contact ten times as stiff as the mode."""

EULER = (10, 100, 1000)
RK4 = (1, 3, 10, 30, 100)
"""Steps in a sample of 1 ms."""

HALVINGS = 50
"""Of a step, to locate an event: 1e-15 of it."""


@compiled()
def euler(tip: Floats, per_sample: int, force_n: Floats) -> None:
    """Semi-implicit, events at the step after them; `tip` as `constants` gives it."""
    spring, damper, contact, mass, kinetic_n, static_n, speed, sample_s = tip
    step_s = sample_s / per_sample
    q = p = z = 0.0
    sliding, sign = False, 1.0
    for i in range(1, force_n.size * per_sample + 1):
        p += step_s * (-spring * q - damper * (p - speed) - contact * z) / mass
        q += step_s * (p - speed)
        if sliding:
            sliding = sign * p >= 0.0
        else:
            z += step_s * p
            if abs(contact * z) > static_n:
                sliding, sign = True, math.copysign(1.0, z)
                z = sign * kinetic_n / contact
        if i % per_sample == 0:
            force_n[i // per_sample - 1] = -spring * q


@compiled()
def rates(tip: Floats, q: float, p: float, z: float, sliding: bool) -> tuple[float, float, float]:
    """Of deflection, speed and the contact's deflection."""
    return p - tip[6], (-tip[0] * q - tip[1] * (p - tip[6]) - tip[2] * z) / tip[3], 0.0 if sliding else p


@compiled()
def rk4_step(
    tip: Floats, q: float, p: float, z: float, h: float, sliding: bool
) -> tuple[float, float, float]:
    """One classical step."""
    a1, b1, c1 = rates(tip, q, p, z, sliding)
    a2, b2, c2 = rates(tip, q + 0.5 * h * a1, p + 0.5 * h * b1, z + 0.5 * h * c1, sliding)
    a3, b3, c3 = rates(tip, q + 0.5 * h * a2, p + 0.5 * h * b2, z + 0.5 * h * c2, sliding)
    a4, b4, c4 = rates(tip, q + h * a3, p + h * b3, z + h * c3, sliding)
    sixth = h / 6.0
    return (
        q + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        p + sixth * (b1 + 2.0 * (b2 + b3) + b4),
        z + sixth * (c1 + 2.0 * (c2 + c3) + c4),
    )


@compiled()
def over(tip: Floats, p: float, z: float, sliding: bool, sign: float) -> bool:
    """Whether the tip stands, or its contact breaks away, before such a state."""
    return sign * p < 0.0 if sliding else abs(tip[2] * z) > tip[5]


@compiled()
def rk4(tip: Floats, per_sample: int, force_n: Floats) -> None:
    """Classical Runge-Kutta; an event within a step is located by halving it."""
    q = p = z = 0.0
    sliding, sign = False, 1.0
    for i in range(1, force_n.size * per_sample + 1):
        left_s = tip[7] / per_sample
        while left_s > 0.0:
            after = rk4_step(tip, q, p, z, left_s, sliding)
            if not over(tip, after[1], after[2], sliding, sign):
                q, p, z = after
                break
            low_s, high_s = 0.0, left_s
            for _ in range(HALVINGS):
                middle_s = 0.5 * (low_s + high_s)
                after = rk4_step(tip, q, p, z, middle_s, sliding)
                if over(tip, after[1], after[2], sliding, sign):
                    high_s = middle_s
                else:
                    low_s = middle_s
            q, p, z = rk4_step(tip, q, p, z, high_s, sliding)
            left_s -= high_s
            if sliding:
                sliding, p = False, 0.0
            else:
                sliding, sign = True, math.copysign(1.0, z)
                z = sign * tip[4] / tip[2]
        if i % per_sample == 0:
            force_n[i // per_sample - 1] = -tip[0] * q


def constants(settings: SlipPlantSettings, speed_m_s: float) -> Floats:
    """What the rivals need of the scene, SI units."""
    s = settings
    omega = 2.0 * math.pi * s.mode_hz
    spring, kinetic_n = s.mass_kg * omega**2, s.friction * s.normal_n_m * PRESS_M
    damper, static_n = 2.0 * s.damping_ratio * omega * s.mass_kg, kinetic_n * (1.0 + s.static_excess)
    contact = s.contact_ratio * spring
    return np.array([spring, damper, contact, s.mass_kg, kinetic_n, static_n, speed_m_s, 1.0 / s.rate_hz])


def timed(run: Callable[[], Floats], seconds: float, least_s: float) -> tuple[Floats, float]:
    """What it gives, and its processor time for a simulated second, once it is compiled."""
    found = run()
    begun_s, runs = time.process_time(), 0
    while time.process_time() - begun_s < least_s:
        run()
        runs += 1
    return found, (time.process_time() - begun_s) / runs / seconds


def scene(name: str, least_s: float) -> dict[str, Any]:
    """Every method on one scene."""
    changed, speed_m_s, seconds = SCENES[name]
    settings = bare(**changed)
    expected_n, events_s = reference(settings, speed_m_s, seconds)
    tip, n = constants(settings, speed_m_s), len(expected_n)
    arm_m: Floats = speed_m_s / settings.rate_hz * np.arange(1, n + 1, dtype=np.float64)
    pressed_m, level_rad, force_n = np.full(n, PRESS_M), np.zeros(n), np.empty(n)
    plant, passed = SlipPlant(settings), 0
    plant.begin(key=(1, 1), press_m=PRESS_M)

    def exact() -> Floats:
        """The trial goes on from run to run: beginning one is not what is timed."""
        nonlocal passed
        passed += 1
        return plant.feel(arm_m + (passed - 1) * arm_m[-1], pressed_m, level_rad)[:, 0]

    def rival(method: Callable[[Floats, int, Floats], None], per_sample: int) -> Callable[[], Floats]:
        def run() -> Floats:
            method(tip, per_sample, force_n)
            return force_n

        return run

    methods = {("exact pieces", 0): exact}
    methods |= {("semi-implicit Euler", steps): rival(euler, steps) for steps in EULER}
    methods |= {("RK4, events located", steps): rival(rk4, steps) for steps in RK4}
    rows: list[dict[str, Any]] = []
    for (method, steps), run in methods.items():
        found, cost = timed(run, seconds, least_s)
        error = float(np.abs(found - expected_n).max() / tip[4])
        row = {"method": method, "step_us": 1e6 / settings.rate_hz / steps if steps else None, "error": error}
        rows.append(
            row
            | {"us_per_s": 1e6 * cost, "ratio": cost * 1e6 / (rows[0]["us_per_s"] if rows else cost * 1e6)}
        )
    return {"scene": name, "events": len(events_s), "methods": rows}


def main(quick: bool = False) -> None:
    """Measure all; writes results/tip.json."""
    save(
        "tip",
        {"simulated": True, "scenes": [scene(name, 0.05 if quick else 0.5) for name in SCENES]},
        quick=quick,
    )
