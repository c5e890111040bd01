"""A bound: our sum of knocks where each structure's ringing is not learned but known.

A Kalman filter has the plant's own numbers: mass, spring, damping and contact of a tip that holds, rolling, noise. A
blow (an innovation beyond three standard deviations) reopens its speed and its force, so that what follows is
predicted. Its innovations go into the sum of knocks of `slip`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_lyapunov

from benchmarks.slip.rivals import LEARN_S, Rival
from benchmarks.slip.scenes import SPEED_M_S, START_S
from controller.detectors.slip import SlipSettings, _odds
from controller.signals.evidence import Odds, log_odds
from drivers.compiled import compiled
from drivers.mock.physics.slip import SlipPlantSettings

Floats = NDArray[np.float64]

BLOW = 9.0
"""A squared innovation beyond this, in variances, is a blow."""

DRIFT = 0.02
"""The force drifts by so many standard deviations of the noise a sample: hysteresis, converter (assumption)."""

LOAD_V = 0.5
"""Size of a load step, as the plant's are (0.3 to 1 V)."""


class Known(NamedTuple):
    """A tip that holds, sample by sample. States: deflection, its speed, two of the rolling force, a force, its slope.

    Attributes:
        step: What a sample does to them, shape (6, 6).
        drift: Covariance that it adds, shape (6, 6).
        blow: Covariance that a blow adds, shape (6, 6).
        gain: From the deflection to the output.
        noise: Variance of the output's.
    """

    step: Floats
    drift: Floats
    blow: Floats
    gain: float
    noise: float


def known(p: SlipPlantSettings) -> Known:
    """The plant's numbers (equations 1 and 6 of docs/explanation/slip.md)."""
    dt_s, bridge = 1.0 / p.rate_hz, p.bridges[-1]
    spring = p.mass_kg * (2.0 * math.pi * p.mode_hz) ** 2
    damper = 2.0 * p.damping_ratio * math.sqrt(spring * p.mass_kg)
    contact = p.contact_ratio * spring
    rows = [
        [0.0, 1.0, 0.0],
        [-(spring + contact) / p.mass_kg, -damper / p.mass_kg, 1.0 / p.mass_kg],
        [0.0] * 3,
    ]
    held = expm(np.array(rows) * dt_s)
    pole = math.exp(-2.0 * math.pi * p.rolling_hz * dt_s)
    rolling = np.array([[pole, 0.0], [(1.0 - pole) * pole, pole]])
    kick = np.outer([1.0 - pole, (1.0 - pole) ** 2], [1.0 - pole, (1.0 - pole) ** 2])
    step = np.eye(6)
    step[:2, :2], step[2:4, 2:4], step[4, 5] = held[:2, :2], rolling, 1.0
    step[:2, 3] = step[:2, 4] = held[:2, 2]
    drift, blow = np.zeros((6, 6)), np.zeros((6, 6))
    drift[2:4, 2:4] = kick * p.rolling_n**2 / solve_discrete_lyapunov(rolling, kick)[1, 1]
    drift[4, 4] = (DRIFT * bridge.noise / bridge.gain) ** 2
    # the starting arm stretches the contact; its slope grows over the time of the start
    drift[5, 5] = (contact * SPEED_M_S * dt_s / (START_S * p.rate_hz)) ** 2
    speed = (p.bump_events * p.slip_event_n) ** 2 / (spring * p.mass_kg)
    blow[:2, :2] = speed * np.array([[dt_s**2 / 3.0, dt_s / 2.0], [dt_s / 2.0, 1.0]])
    blow[4, 4] = (LOAD_V / bridge.gain) ** 2 if p.loads_hz > 0.0 else 0.0
    return Known(step, drift, blow, -spring * bridge.gain, bridge.noise**2 + bridge.step**2 / 12.0)


@compiled()
def _evidence(o: Odds, k: Known, values: Floats, first: int, out: Floats) -> None:
    """Page's sum over the filter's innovations, written to `out`; as `slip` has it, but for its running median."""
    state, spread = np.zeros(6), np.eye(6)
    state[0] = values[0] / k.gain
    total, credit = 0.0, o.cap
    for i in range(values.size):
        state = k.step @ state
        spread = k.step @ spread @ k.step.T + k.drift
        variance = k.gain * k.gain * spread[0, 0] + k.noise
        innovation = values[i] - k.gain * state[0]
        squared = innovation * innovation / variance
        if squared > BLOW:
            spread = spread + k.blow
            variance = k.gain * k.gain * spread[0, 0] + k.noise
        share = spread[:, 0] * (k.gain / variance)
        state = state + share * innovation
        spread = spread - np.outer(share, share) * variance
        spread = 0.5 * (spread + spread.T)
        if i >= first:
            worth = log_odds(o, squared)
            if worth > 0.0:
                worth = min(worth, credit)
                credit -= worth
            credit = min(o.cap, credit + o.refill)
            total = max(0.0, total + worth)
            out[i] = total


def knowing(p: SlipPlantSettings) -> Mapping[str, Rival]:
    """The sum on one plant, as the other detectors are."""
    return {"knocks of slip, structure known": partial(_statistic, known(p))}


def _statistic(k: Known, values: Floats, rate_hz: float) -> Floats:
    out = np.full(len(values), np.nan)
    odds = _odds(SlipSettings(), rate_hz)
    _evidence(odds, k, np.ascontiguousarray(values), round(LEARN_S * rate_hz), out)
    return out
