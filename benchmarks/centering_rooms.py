"""Centering in difficult rooms, the paper's method at its best: `python -m benchmarks centering_rooms`."""

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

from benchmarks.centering import (
    LEVEL,
    SEED_TUNE,
    SPEEDS_M_S,
    CenteringScore,
    Key,
    Place,
    eighty_five,
    methods,
    paper_at,
    scores,
)
from benchmarks.results import save, workers
from simulator.physics.aura_settings import EchoSettings, RoomSettings

SEED_ROOMS = 47_000
WINDOWS_S = (0.03, 0.06, 0.125, 0.25, 0.5)
DISTANCES_M = (0.008, 0.0125)
"""Tried values of the paper's alpha, and of the distance for its gamma."""

SOUND_M_S = 343.2
"""As the detectors assume."""

WALL_FS = 1e-4
"""As received by a finger."""


BROKEN = (0.05, 0.1, 0.3)

ROOMS: Mapping[str, Mapping[str, float]] = {
    "empty": {},
    "fingers scatter by 1 dB": {"finger_db": 1.0, "repeats": 3},
    "wall 1e-4": {"wall": 1},
    "all three": {"wall": 1, "second_path": 0.1, "finger_db": 1.0, "repeats": 3},
    **{f"second path {share:.0%}": {"second_path": share} for share in BROKEN},
    **{f"one finger {share:.0%} more sensitive": {"apart": 1.0 + share} for share in BROKEN},
    **{f"one finger fades by {share:.0%} in the turn": {"fades": 1.0 - share} for share in BROKEN},
    **{f"one finger's echo spreads over {share:.0%} more": {"decays": 1.0 + share} for share in BROKEN},
    **{f"wave {share:.0%} longer than believed": {"wave": 1.0 / (1.0 + share)} for share in BROKEN},
}
"""What differs from like fingers, no other echo and one set of 85: of a `Place`; `wall`: one of `WALL_FS` ahead or
behind, in turn; `apart`: ratio of the right finger's sensitivity to the left one's; `wave`: of the wavelength that
detectors assume to the real one. `all three`: scatter, a second path of 10 % and the wall."""


def places_in(room: Mapping[str, float], repeat: int, speed_m_s: float) -> list[Place]:
    """85 places in a room."""
    found, about = [], {key: room[key] for key in ("finger_db", "fades", "decays") if key in room}
    for place in eighty_five(SEED_ROOMS, repeat, speed_m_s, 20.0 * math.log10(room.get("apart", 1.0))):
        wall = EchoSettings(size_fs=WALL_FS / LEVEL, away_m=0.3, cosine=(1.0, -1.0)[place.number % 2])
        echoes = (wall,) if "wall" in room else ()
        settings = RoomSettings(echoes=echoes, second_path=room.get("second_path", 0.0))
        found.append(place._replace(**{"room": settings, **about}))  # type: ignore[arg-type]
    return found


def main(quick: bool = False) -> None:
    """Run the study; writes results/centering_rooms.json."""
    started_s, every = time.perf_counter(), 17 if quick else 1
    pipe = methods("mock/centering")
    paper, ours = pipe["paper"], pipe["ours"]
    with workers() as pool:
        aside = {speed: eighty_five(SEED_TUNE, 1, speed)[::8] for speed in SPEEDS_M_S}
        choices = product(SPEEDS_M_S, WINDOWS_S, DISTANCES_M)
        tried = scores(
            {key: [[(place, paper_at(paper, *key[1:])) for place in aside[key[0]]]] for key in choices}, pool
        )
        best = {speed: _best({key: tried[key] for key in tried if key[0] == speed}) for speed in SPEEDS_M_S}
        jobs: dict[Key, Any] = {}
        for (name, room), speed in product(ROOMS.items(), SPEEDS_M_S):
            own = ours.set_to(sound_m_s=SOUND_M_S * room["wave"]) if "wave" in room else ours
            ways = {"ours, turned": replace(own, turned=True)}
            if "fades" not in room:  # the others do not turn
                ways["ours"] = own
                ways |= {} if "wave" in room else {"paper": paper_at(paper, *best[speed][1:])}
            for way, method in ways.items():
                sets = [
                    places_in(room, repeat, speed)[::every] for repeat in range(int(room.get("repeats", 1)))
                ]
                jobs[name, way, speed] = [[(place, method) for place in places] for places in sets]
        found = scores(jobs, pool)
    names = ("speed_m_s", "window_s", "distance_m")
    listed = [
        dict(zip(names, key, strict=True)) | one | {"chosen": key in best.values()}
        for key, one in tried.items()
    ]
    rows = {" | ".join(map(str, key)): one for key, one in found.items()}
    took_s = time.perf_counter() - started_s
    save("centering_rooms", {"rows": rows, "papers_choices": listed, "wall_s": took_s}, quick=quick)


def _best(tried: Mapping[Key, CenteringScore]) -> Key:
    """Least worst error among those that lost fewest."""
    fewest = min(one["searches"] - one["centred"] for one in tried.values())
    least = {key: one for key, one in tried.items() if one["searches"] - one["centred"] <= fewest + 1}
    return min(least, key=lambda key: least[key]["largest_m"] or math.inf)
