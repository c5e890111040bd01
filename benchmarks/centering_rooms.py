"""Centering in difficult rooms, the paper's method at its best: `python -m benchmarks centering_rooms`."""

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks.centering import (
    APART,
    OURS,
    PAPER,
    SCATTER,
    SEED_TUNE,
    SPEEDS_M_S,
    Key,
    Method,
    Searches,
    repeated,
    scores,
)
from benchmarks.results import save, workers
from simulator.physics.aura import RIGHT, AuraMotion, AuraPlant
from simulator.physics.aura_settings import NOTHING, OBJECTS
from simulator.physics.gripper_part import AuraBenchSettings

SEED_ROOMS = 47_000
WINDOWS_S = (0.03, 0.06, 0.125, 0.25, 0.5)
DISTANCES_M = (0.008, 0.0125)
"""Tried values of the paper's alpha, and of the distance for its gamma."""

SOUND_M_S = 343.2
"""As the detectors assume."""

DRIVE_HZ, LEVEL = 40_000.0, 0.5
"""As behaviors/sonic.py drives it."""

WALL_FS = 1e-4
"""As received by a finger."""

TURNED = replace(OURS, profile="mock/centering_turned")

BROKEN = (0.05, 0.1, 0.3)

ROOMS: Mapping[str, Mapping[str, float]] = {
    "empty": {},
    "fingers scatter by 1 dB": {"scatter_db": 1.0, "repeats": 3},
    "wall 1e-4": {"wall": 1},
    "all three": {"wall": 1, "second_path": 0.1, "scatter_db": 1.0, "repeats": 3},
    **{f"second path {share:.0%}": {"second_path": share} for share in BROKEN},
    **{f"one finger {share:.0%} more sensitive": {"apart": 1.0 + share} for share in BROKEN},
    **{f"wave {share:.0%} longer than believed": {"wave": 1.0 / (1.0 + share)} for share in BROKEN},
}
"""What differs from like fingers, no other echo and one set of 85: standard deviation of each finger's sensitivity from
search to search; `wall`: one of `WALL_FS` ahead; `apart`: ratio of the right finger's sensitivity to
the left one's; `wave`: of the wavelength that detectors assume to the real one. `all three`: scatter, a second path of
10 % and the wall."""


def inside(room: Mapping[str, float], method: Method) -> Method:
    """A method in a room."""
    wall = f"{{ size_fs = {WALL_FS / LEVEL}, away_m = 0.3 }}" if "wall" in room else ""
    settings = {
        APART: 20.0 * math.log10(room.get("apart", 1.0)),
        SCATTER: room.get("scatter_db", 0.0),
        "plant.room.second_path": room.get("second_path", 0.0),
        "plant.room.echoes": f"[{wall}]",
    }
    for key, value in settings.items():
        method = method.having(key, value)
    return method.finding("sound_m_s", SOUND_M_S * room["wave"]) if "wave" in room else method


def wave_fs(distance_m: float) -> float:
    """Mean amplitude of what the pipe sends back from a distance, full scales at the drive's level."""
    settings = AuraBenchSettings(gain_scatter_db=0.0, phase_scatter_rad=0.0)
    fields = []
    for thing in (OBJECTS["pipe"], OBJECTS.get(NOTHING)):
        plant = AuraPlant(settings)
        plant.begin((0, 0), thing, settings.object_top_m, "normal")
        one, gap_m = np.zeros(1), np.array([[distance_m, 1.0]])
        motion = AuraMotion(gap_m, one, one, np.full(1, 0.063), np.zeros((1, 2)), one, one)
        fields.append(plant.field(motion, one, np.full(1, DRIVE_HZ), np.full(1, LEVEL), (RIGHT,))[0, RIGHT])
    return float(abs(fields[0] - fields[1]))


def paper_at(window_s: float, distance_m: float) -> Method:
    """The paper's method with an alpha, and the gamma of a distance: power of its wave in phase, if it kept its size
    over a window."""
    return PAPER.finding("window_s", window_s).finding("threshold", 0.5 * wave_fs(distance_m) ** 2)


def main(quick: bool = False) -> None:
    """Run the study; writes results/centering_rooms.json."""
    started_s, one_in = time.perf_counter(), 17 if quick else 1
    with workers() as pool:
        choices = product(SPEEDS_M_S, WINDOWS_S, DISTANCES_M)
        tried = scores(
            {key: repeated(1, paper_at(*key[1:]), key[0], SEED_TUNE, 4 * one_in + 4) for key in choices}, pool
        )
        best = {speed: _best({key: tried[key] for key in tried if key[0] == speed}) for speed in SPEEDS_M_S}
        jobs: dict[Key, list[Searches]] = {}
        for (name, room), speed in product(ROOMS.items(), SPEEDS_M_S):
            ways = {"ours, turned": TURNED, "ours": OURS}
            ways |= {} if "wave" in room else {"paper": paper_at(*best[speed][1:])}
            count = int(room.get("repeats", 1))
            for way, method in ways.items():
                jobs[name, way, speed] = repeated(count, inside(room, method), speed, SEED_ROOMS, one_in)
        found = scores(jobs, pool)
    names = ("speed_m_s", "window_s", "distance_m")
    listed = [
        dict(zip(names, key, strict=True)) | one | {"chosen": key in best.values()}
        for key, one in tried.items()
    ]
    rows = {" | ".join(map(str, key)): one for key, one in found.items()}
    took_s = time.perf_counter() - started_s
    save("centering_rooms", {"rows": rows, "papers_choices": listed, "wall_s": took_s}, quick=quick)


def _best(tried: Mapping[Key, Mapping[str, Any]]) -> Key:
    """Least worst error among those that lost fewest."""
    fewest = min(one["searches"] - one["centred"] for one in tried.values())
    least = {key: one for key, one in tried.items() if one["searches"] - one["centred"] <= fewest + 1}
    return min(least, key=lambda key: least[key]["largest_m"] or math.inf)
