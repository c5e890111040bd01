"""Input of the detectors: sensors with their structures off, recordings without slip, and slips.

Everything here is simulated. Detectors see the sensor's output alone; the truth is used for scoring.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.mock.physics.slip import SlipPlant, SlipPlantSettings
from drivers.mock.physics.slip_nuisances import SlipNuisances
from drivers.mock.physics.slip_sensors import SENSORS

Floats = NDArray[np.float64]

OFF = ((0.7, 3.0), (1.3, 1.0 / 3.0), (0.7, 1.0 / 3.0), (1.3, 3.0))
"""Factors on frequency and damping of the structure that the detectors are scored on: 30 % and 3 either way."""

NUISANCES: Mapping[str, Mapping[str, Any]] = {
    "clean": {},
    "bumps": {"bumps_hz": 1.0},
    "loads": {"loads_hz": 0.5},
    "tails": {"nuisances": SlipNuisances(tails=1.4)},
    "tremor": {"nuisances": SlipNuisances(tremor_n=0.05)},
    "smooth": {"nuisances": SlipNuisances(smoothness=10.0)},
    "bouncing": {"bumps_hz": 0.2, "nuisances": SlipNuisances(bounces=3)},
    "impacts": {"bumps_hz": 0.2, "nuisances": SlipNuisances(bounces=3, tremor_n=0.05)},
    "rolling, 0.6 N": {"rolling_n": 0.6},
    "rolling, 1 N": {"rolling_n": 1.0},
    "rolling, 2 N": {"rolling_n": 2.0},
    "table moves": {"nuisances": SlipNuisances(table_m_s=0.01)},
}
"""What is different from rolling on a smooth table under the sensor's noise. Bumps are exponential, 1.5 slip events in
the mean, load steps of 0.3 to 1 V."""

SPEED_M_S = 0.01
"""Of the slip. Assumption: the paper prints none."""

PRELOAD = 0.85
RAMP_PRELOAD = 0.98
"""Share of the mean friction that the tip already carries when the arm starts: rolling has loaded it. Assumption;
for the ramp almost all of it, so that the slip begins while the arm is slow."""

START_S = 0.03
RAMP_S = 0.05
"""How long the arm takes to its speed: smoothly (assumption), and linearly for the 50 ms ramp."""

RECORDING_S = 600.0
"""Length of one recording without slip; each has its own key."""

SETTLE_S = 5.0
"""Omitted at its beginning, while a detector learns. Its events in that time are counted separately."""

ARMED_S = 1.0
"""When both detectors decide: ours learns for so long."""

BEFORE_S = 3.0
AFTER_S = 1.0
"""Of a slip trial: before the arm starts and after."""

FIRM_M = 0.01
LIGHT_M = 0.001
"""How far the arm presses: firmly where nothing may slip, as the paper does where something shall."""


def sensor(name: str, nuisance: str, frequency: float = 1.0, damping: float = 1.0) -> SlipPlantSettings:
    """A sensor of the paper, its last bridge alone, under a nuisance, its structure off by these factors.

    The stiffness stays; the mass changes.
    """
    base = SENSORS[name]
    return base.model_copy(
        update={
            "bridges": base.bridges[-1:],
            "mode_hz": base.mode_hz * frequency,
            "mass_kg": base.mass_kg / frequency**2,
            "damping_ratio": base.damping_ratio * damping,
            **NUISANCES[nuisance],
        }
    )


def recordings(settings: SlipPlantSettings, hours: float, seed: int) -> Iterator[Floats]:
    """Recordings without slip, shape (n, 1) each; the arm rolls to and fro all the time."""
    plant = SlipPlant(settings)
    n = round(RECORDING_S * settings.rate_hz)
    t_s = np.arange(1, n + 1) / settings.rate_hz
    roll_rad = 0.5 * np.abs((t_s / 10.0) % 2.0 - 1.0)
    for number in range(round(hours * 3600.0 / RECORDING_S)):
        plant.begin(key=(seed, number), press_m=FIRM_M)
        values = plant.advance(np.zeros(n), np.full(n, FIRM_M), roll_rad)
        if np.ptp(plant.slid_m) != 0.0:
            raise RuntimeError("a recording without slip slipped: press harder")
        yield values


STEP_S = 4.0
"""Before a step of the noise, and after."""


def stepped(kind: str, rate_hz: float, factor: float, seed: int) -> Floats:
    """The fingertip in the air while its noise steps: white, hum of one sine from 50 to 500 Hz that is switched on, or
    noise below a converter's step."""
    hum_hz = float(np.random.default_rng(seed).uniform(50.0, min(500.0, 0.4 * rate_hz)))
    changes: Mapping[str, dict[str, Any]] = {
        "white": {"noise_factor": factor},
        "hum": {"hum": math.sqrt(factor**2 - 1.0), "hum_hz": (hum_hz,)},
        "converter": {"noise_factor": factor, "converter": 2.0},
    }
    settings = sensor("fingertip", "clean").model_copy(
        update={
            "rate_hz": rate_hz,
            "nuisances": SlipNuisances.model_validate({"change_s": STEP_S, **changes[kind]}),
        }
    )
    plant = SlipPlant(settings)
    plant.begin(key=(seed, 0), press_m=-LIGHT_M)
    n = round(2.0 * STEP_S * rate_hz)
    values: Floats = plant.advance(np.zeros(n), np.full(n, -LIGHT_M), np.zeros(n))[:, 0]
    return values


AIR_S, CONTACT_S = 3.0, 60.0
"""In the air, where a detector learns, and then in contact."""


def contact(
    settings: SlipPlantSettings, seed: int, press_m: float, *, rolls: bool
) -> tuple[Floats, int, bool]:
    """A tip that is lowered to the table and stays: its signal, the sample of the touch, and whether it slid."""
    plant = SlipPlant(settings)
    touch = round(AIR_S * settings.rate_hz)
    n = touch + round(CONTACT_S * settings.rate_hz)
    press = np.where(np.arange(n) < touch, -LIGHT_M, press_m)
    t_s = np.arange(1, n + 1) / settings.rate_hz
    roll_rad = 0.5 * np.abs((t_s / 10.0) % 2.0 - 1.0) if rolls else np.zeros(n)
    plant.begin(key=(seed, 0), press_m=-LIGHT_M, roll_rad=float(roll_rad[0]))
    values = plant.advance(np.zeros(n), press, roll_rad)[:, 0]
    return values, touch, bool(np.ptp(plant.slid_m[touch + 1 :]) > 0.0)


@dataclass(frozen=True)
class SlipTrial:
    """One slip trial.

    Attributes:
        values: The sensor's signal, shape (n, 1).
        start: Sample at which the arm starts.
        onset: Sample at which the contact has first moved after that. None where it never does.
        moved_before: Whether it has moved before, too: a load step or rolling pushed the tip on, and it held again.
    """

    values: Floats
    start: int
    onset: int | None
    moved_before: bool


def slips(settings: SlipPlantSettings, count: int, seed: int, *, ramp: bool = False) -> Iterator[SlipTrial]:
    """Slip trials: the tip is loaded slowly, held while it rolls, and then dragged."""
    plant = SlipPlant(settings)
    rate_hz = settings.rate_hz
    n = round((BEFORE_S + AFTER_S) * rate_hz)
    t_s = np.arange(1, n + 1) / rate_hz
    spring_n_m = settings.mass_kg * (2.0 * math.pi * settings.mode_hz) ** 2
    friction_n = settings.friction * settings.normal_n_m * LIGHT_M
    # the arm that loads the tip stretches the sensor's spring and the contact, one behind the other
    whole_m = friction_n / spring_n_m * (1.0 + 1.0 / settings.contact_ratio)
    loading = 0.5 - 0.5 * np.cos(np.pi * np.clip(t_s - 0.5, 0.0, 1.0))
    for number in range(count):
        # the golden ratio spreads the starts evenly over the paper's blocks
        start_s = BEFORE_S - 0.2 + 0.1 * (number * 0.6180339887 % 1.0)
        since_s = np.maximum(0.0, t_s - start_s)
        if ramp:
            way_m = np.where(since_s < RAMP_S, since_s**2 / (2.0 * RAMP_S), since_s - RAMP_S / 2.0)
        else:
            smooth = 0.5 * (since_s - START_S / np.pi * np.sin(np.pi * since_s / START_S))
            way_m = np.where(since_s < START_S, smooth, since_s - START_S / 2.0)
        arm_m = SPEED_M_S * way_m + (RAMP_PRELOAD if ramp else PRELOAD) * whole_m * loading
        plant.begin(key=(seed, number), press_m=LIGHT_M)
        values = plant.advance(arm_m, np.full(n, LIGHT_M), 0.1 * t_s)
        moved = np.flatnonzero(np.diff(plant.slid_m) != 0.0) + 1
        start = int(start_s * rate_hz)
        # tips that a push had moved before the arm started slip as well: omitting them would favour calm trials
        slid = moved[moved >= start]
        yield SlipTrial(values, start, int(slid[0]) if slid.size else None, slid.size < moved.size)
