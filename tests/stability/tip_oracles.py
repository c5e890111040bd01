"""The tip on its table solved without any code of the plant: for its stability tests and its benchmark."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from drivers.core.messages import Floats
from simulator.physics.slip import BridgeSettings, SlipPlantSettings

FT = BridgeSettings(name="Ft", tangential=1.0, gain=1.0, full_scale_n=1.0, noise=0.0)
PRESS_M = 1e-3


def bare(**changed: float) -> SlipPlantSettings:
    """A fingertip of 180 Hz without noise, roughness or read-out errors: 1 V is 1 N."""
    return SlipPlantSettings(**{"bridges": (FT,), "mode_hz": 180.0, "roughness": 0.0, **changed})


def reference(settings: SlipPlantSettings, speed_m_s: float, seconds: float) -> tuple[Floats, list[float]]:
    """Force in the spring at each sample, and when it broke away and stood: DOP853 at 1e-12 between events found by
    its dense output; the equations of docs/explanation/slip.md, no code of the plant."""
    s, times_s = settings, np.arange(1, round(seconds * settings.rate_hz) + 1) / settings.rate_hz
    k = s.mass_kg * (2.0 * math.pi * s.mode_hz) ** 2
    c, kc = 2.0 * s.damping_ratio * 2.0 * math.pi * s.mode_hz * s.mass_kg, s.contact_ratio * k
    kinetic_n = s.friction * s.normal_n_m * PRESS_M
    scale = np.array([kinetic_n / k, speed_m_s + kinetic_n / math.sqrt(k * s.mass_kg), kinetic_n / kc])
    state, t_s, sliding, sign = np.zeros(3), 0.0, False, 1.0
    force_n, events_s = np.empty(len(times_s)), list[float]()

    def rates(_: float, y: Floats) -> Floats:
        q, p, z = y * scale
        accel = (-k * q - c * (p - speed_m_s) - kc * z) / s.mass_kg
        return np.array([p - speed_m_s, accel, 0.0 if sliding else p]) / scale

    def breaks(_: float, y: Floats) -> float:
        return abs(y[2]) - (1.0 + s.static_excess)

    def stands(_: float, y: Floats) -> float:
        return sign * y[1]

    event: Any
    for event, direction in ((breaks, 1.0), (stands, -1.0)):
        event.terminal, event.direction = True, direction
    while t_s < times_s[-1]:
        found = solve_ivp(
            rates, (t_s, times_s[-1]), state, method="DOP853", rtol=1e-12, atol=1e-14, dense_output=True,
            max_step=0.05 / s.mode_hz,  # a longer one passes over a speed that dips below zero
            events=stands if sliding else breaks,
        )  # fmt: skip
        assert found.sol is not None
        inside = (times_s > t_s) & (times_s <= found.t[-1])
        if inside.any():
            force_n[inside] = -k * scale[0] * found.sol(times_s[inside])[0]
        t_s, state = found.t[-1], found.y[:, -1].copy()
        if t_s >= times_s[-1]:
            break
        events_s.append(t_s)
        if sliding:
            sliding, state[1] = False, 0.0
        else:
            sliding, sign = True, math.copysign(1.0, state[2])
            state[2] = sign
    return force_n, events_s
