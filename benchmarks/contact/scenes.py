"""Approaches to the simulated finger, generated in batch: the plant alone, without loop and devices."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.mock.physics.finger import FingerPlant, FingerSettings

Floats = NDArray[np.float64]

PROFILES = Path(__file__).resolve().parents[2] / "config" / "profiles" / "mock"

RATE_HZ = 1000.0
"""Of the waveforms, as on the bench's board."""

SETTLE_S, BASELINE_S = 90.0, 10.0
"""Settling: paper III.B. Baseline: what every detector but the paper's own is given."""

STOPS_S, HOLD_S, RETRACT_M_S, AFTER_S = 0.15, 1.5, 0.010, 1.0
"""The probe stops this long after the first touch, stands, retracts; then the finger is recorded on."""

LISTENS_S = 0.6
"""How long after the touch a detector may take where nothing is held."""

GAP_M = (0.003, 0.004)
"""The probe's travel before the touch, uniformly distributed: the first touch meets the oscillation at any phase."""


def rows() -> list[tuple[str, float]]:
    """Location and speed (m/s) of Table I's rows, as `mock/transient` has them."""
    trials = tomllib.loads((PROFILES / "transient.toml").read_text(encoding="utf-8"))["trials"]["list"]
    return [(str(row["location"]), float(row["speed_m_s"])) for row in trials]


def level(name: str) -> FingerSettings:
    """The finger of `mock/transient_NAME`; `kind` is that of `mock/transient` itself."""
    if name == "kind":
        return FingerSettings()
    plant: dict[str, Any] = tomllib.loads((PROFILES / f"transient_{name}.toml").read_text(encoding="utf-8"))[
        "plant"
    ]
    return FingerSettings(**plant)


@dataclass(frozen=True, eq=False)
class ApproachScene:
    """The board's recording of one approach, from the baseline's start on, and the truth.

    Attributes:
        ends_s, periods_s: The oscillator's periods.
        times_s, accelerometer, force_n: Waveforms at `RATE_HZ`.
        distal: The second accelerometer's, empty where there is none.
        starts_s: Start of the probe's motion and end of the baseline.
        contacts: (time, made or lost).
        stops_s, leaves_s: When the probe stands, and when it begins to retract.
    """

    ends_s: Floats
    periods_s: Floats
    times_s: Floats
    accelerometer: Floats
    force_n: Floats
    distal: Floats
    starts_s: float
    contacts: tuple[tuple[float, bool], ...]
    stops_s: float
    leaves_s: float
    location: str
    speed_m_s: float

    @property
    def touch_s(self) -> float:
        """The first touch."""
        return next(t_s for t_s, made in self.contacts if made)


def approach(
    s: FingerSettings,
    seed: int,
    trial: int,
    row: tuple[str, float],
    hold_s: float = HOLD_S,
    noise: float = 1.0,
    touching: bool = True,
    away_m_s: float = RETRACT_M_S,
) -> ApproachScene:
    """One approach: settle, baseline, approach until `STOPS_S` after the touch, hold, retract.

    Args:
        s: The finger.
        seed, trial: They key the noise and draw the gap.
        row: Location and speed, m/s.
        hold_s: Time at standstill; 0 ends the scene where the probe would stop.
        noise: Factor on every noise once the baseline has ended.
        touching: Whether the probe is there: without it the same finger in the same noise is recorded for as long.
        away_m_s: How fast it retracts.
    """
    location, speed_m_s = row
    rng = np.random.default_rng((seed, trial))
    gap_m = float(rng.uniform(*GAP_M))
    plant = FingerPlant(s)
    plant.begin(key=(seed, trial), location=location, gap_m=gap_m if touching else 1.0)
    plant.excite(True)
    plant.advance(SETTLE_S)
    starts_s = SETTLE_S + BASELINE_S
    plan = [(SETTLE_S, 0.0, 0.0, 0.0), (starts_s, 0.0, speed_m_s, 0.0)]
    plant.move_probe(plan)
    observed = frozenset({"accelerometer", "load_cell", "period"})
    observed |= {"distal"} if s.distal_accelerometer_arm_m else set()
    pieces: dict[str, list[Floats]] = {"accelerometer": [], "load_cell": [], "distal": []}
    contacts: list[tuple[float, bool]] = []
    ends: list[Floats] = []
    periods: list[Floats] = []
    now = round(SETTLE_S * RATE_HZ)

    def until(t_s: float) -> None:
        nonlocal now
        plant.advance(t_s, observed)
        last = int(np.floor(t_s * RATE_HZ + 1e-6))
        times_s = np.arange(now + 1, last + 1) / RATE_HZ
        for name in observed - {"period"}:
            pieces[name].append(plant.sample(name, times_s))
        e, p = plant.periods()
        ends.append(e)
        periods.append(p)
        contacts.extend(plant.contacts())
        now = last

    if noise != 1.0:
        until(starts_s)
        plant.settings = s.model_copy(update={"noise_scale": noise * s.noise_scale})
        plant.set_tendon(0.0)  # its former value: the finger is rebuilt from its settings
    reach_s = starts_s + (gap_m - 0.001) / speed_m_s
    until(round(reach_s, 3))
    while (
        touching and not contacts
    ):  # the swing meets the probe up to a millimetre before the resting surface
        until(round(plant.t_s + 0.02, 3))
    touch_s = contacts[0][0] if touching else reach_s + 0.5
    stops_s = leaves_s = round(touch_s + (STOPS_S if hold_s else LISTENS_S), 3)
    until(stops_s)
    if hold_s:
        there_m, leaves_s = (stops_s - starts_s) * speed_m_s, stops_s + hold_s
        away_s = 0.004 / away_m_s
        plant.move_probe(
            [
                (stops_s, there_m, 0.0, 0.0),
                (leaves_s, there_m, -away_m_s, 0.0),
                (leaves_s + away_s, there_m - 0.004, 0.0, 0.0),
            ]
        )
        until(round(leaves_s + away_s + AFTER_S, 3))
    times_s = np.arange(round(SETTLE_S * RATE_HZ) + 1, now + 1) / RATE_HZ
    waves = {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in pieces.items()}
    return ApproachScene(
        np.concatenate(ends),
        np.concatenate(periods),
        times_s,
        waves["accelerometer"],
        waves["load_cell"],
        waves["distal"],
        starts_s,
        tuple(contacts),
        stops_s,
        leaves_s,
        location,
        speed_m_s,
    )
