"""Centering in rooms that are less kind, the paper's way at its best: `python -m benchmarks centering_rooms`."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

from benchmarks.centering.scenes import LEVEL, Place
from benchmarks.centering.scoring import CenteringScore, score
from benchmarks.centering.search import Found
from benchmarks.centering.study import SEED_TUNE, SPEEDS_M_S, Method, eighty_five, gamma, made, methods
from benchmarks.results import save
from config.assemble import Table
from config.profile import load_profile
from drivers.mock.physics.aura_settings import EchoSettings, RoomSettings

SEED = 47_000
WINDOWS_S = (0.03, 0.06, 0.125, 0.25, 0.5)
DISTANCES_M = (0.008, 0.0125)
"""What is tried of the paper's alpha, and of the distance that its gamma means."""

WALL_FS = 1e-4
"""As a finger hears it."""


def _wall(number: int) -> tuple[EchoSettings, ...]:
    """Ahead or behind in turn, 30 cm away."""
    return (EchoSettings(size_fs=WALL_FS / LEVEL, away_m=0.3, cosine=(1.0, -1.0)[number % 2]),)


def places_in(room: str, repeat: int, speed_m_s: float) -> list[Place]:
    """85 places in a room."""
    found = []
    for place in eighty_five(SEED, repeat, speed_m_s):
        everything = room == "all three"
        settings = RoomSettings(
            echoes=_wall(place.number) if everything or room.startswith("wall") else (),
            second_path=0.3 if "30 %" in room else 0.1 if everything or "10 %" in room else 0.0,
        )
        scatter_db = 1.0 if everything or room.startswith("fingers") else 0.0
        found.append(place._replace(room=settings, finger_db=scatter_db))
    return found


ROOMS = (
    "empty",
    "fingers scatter by 1 dB",
    "second path 10 %",
    "second path 30 %",
    "wall 1e-4",
    "all three",
)
"""`all three`: scatter, a second path of 10 % and the wall."""


def main(quick: bool = False) -> None:
    """Run the study; writes results/centering_rooms.json."""
    started_s, every = time.perf_counter(), 17 if quick else 1
    profile = methods(load_profile("mock/centering", {}, table=Table()))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), context) as pool:
        choices = papers_choices(profile["paper"], pool)
        best = {speed_m_s: _best(choices[speed_m_s]) for speed_m_s in SPEEDS_M_S}
        keys, work = [], []
        for room in ROOMS:
            for speed_m_s in SPEEDS_M_S:
                ways = {"ours": profile["ours"], "paper": at(profile["paper"], *best[speed_m_s])}
                for name, way in ways.items():
                    if name == "paper" and room not in ("empty", "all three"):
                        continue
                    places = places_in(room, 0, speed_m_s)[::every]
                    keys += [(room, name, speed_m_s)] * len(places)
                    work += [(place, way) for place in places]
        found: dict[tuple[str, str, float], list[Found]] = {}
        for key, outcome in zip(keys, made(work, pool), strict=True):
            found.setdefault(key, []).append(outcome)
    scores = {key: score([outcomes]) for key, outcomes in found.items()}
    tried = [
        {"speed_m_s": speed_m_s, "window_s": choice[0], "distance_m": choice[1], **one._asdict()}
        | {"chosen": best[speed_m_s] == choice}
        for speed_m_s, by_choice in choices.items()
        for choice, one in by_choice.items()
    ]
    rows = {" | ".join(map(str, key)): one._asdict() for key, one in scores.items()}
    took_s = time.perf_counter() - started_s
    save("centering_rooms", {"rows": rows, "papers_choices": tried, "wall_s": took_s}, quick=quick)


Choice = tuple[float, float]


def at(paper: Method, window_s: float, distance_m: float) -> Method:
    """The paper's way with an alpha and the gamma of a distance."""
    told = dict(paper.tuning.finder) | {"window_s": window_s, "threshold": gamma(distance_m)}
    return paper._replace(tuning=replace(paper.tuning, finder=told))


def papers_choices(paper: Method, pool: ProcessPoolExecutor) -> dict[float, dict[Choice, CenteringScore]]:
    """Its settings by speed, on some searches of their own."""
    keys, work = [], []
    for speed_m_s in SPEEDS_M_S:
        places = eighty_five(SEED_TUNE, 1, speed_m_s)[::8]
        for window_s in WINDOWS_S:
            for distance_m in DISTANCES_M:
                keys += [(speed_m_s, (window_s, distance_m))] * len(places)
                work += [(place, at(paper, window_s, distance_m)) for place in places]
    found: dict[float, dict[Choice, list[Found]]] = {}
    for (speed_m_s, choice), outcome in zip(keys, made(work, pool), strict=True):
        found.setdefault(speed_m_s, {}).setdefault(choice, []).append(outcome)
    return {
        speed_m_s: {choice: score([outcomes]) for choice, outcomes in by_choice.items()}
        for speed_m_s, by_choice in found.items()
    }


def _best(choices: Mapping[Choice, CenteringScore]) -> Choice:
    """Least worst error among those that lost fewest."""
    fewest = min(one.searches - one.centred for one in choices.values())
    kept = {choice: one for choice, one in choices.items() if one.searches - one.centred <= fewest + 1}
    return min(kept, key=lambda choice: kept[choice].largest_m)


if __name__ == "__main__":
    main()
