"""Centering in difficult rooms, the paper's method at its best: `python -m benchmarks centering_rooms`."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import NamedTuple

from benchmarks.centering.scenes import LEVEL, Place
from benchmarks.centering.scoring import CenteringScore, score
from benchmarks.centering.search import Found
from benchmarks.centering.study import SEED_TUNE, SPEEDS_M_S, Method, eighty_five, gamma, made, methods
from benchmarks.results import save, workers
from config.assemble import Table
from config.profile import load_profile
from drivers.mock.physics.aura_settings import EchoSettings, RoomSettings

SEED = 47_000
WINDOWS_S = (0.03, 0.06, 0.125, 0.25, 0.5)
DISTANCES_M = (0.008, 0.0125)
"""Tried values of the paper's alpha, and of the distance for its gamma."""

SOUND_M_S = 343.2
"""As the detectors assume."""

WALL_FS = 1e-4
"""As received by a finger."""


class CenteringRoom(NamedTuple):
    """The room of 85 searches.

    Attributes:
        wall: Whether one of `WALL_FS` stands ahead or behind, in turn.
        second_path: Of the echo's amplitude.
        finger_db: Standard deviation of each finger's sensitivity from search to search.
        apart: Ratio of the right finger's sensitivity to the left one's.
        fades: The right finger's sensitivity after half a turn, as a share of the one before.
        decays: Distance over which the sound of the right finger spreads, as a share of the left one's.
        wave: Ratio of the wavelength that the detectors assume to the real one.
        repeats: Sets of 85.
    """

    wall: bool = False
    second_path: float = 0.0
    finger_db: float = 0.0
    apart: float = 1.0
    fades: float = 1.0
    decays: float = 1.0
    wave: float = 1.0
    repeats: int = 1


BROKEN = (0.05, 0.1, 0.3)

ROOMS = {
    "empty": CenteringRoom(),
    "fingers scatter by 1 dB": CenteringRoom(finger_db=1.0, repeats=3),
    "wall 1e-4": CenteringRoom(wall=True),
    "all three": CenteringRoom(wall=True, second_path=0.1, finger_db=1.0, repeats=3),
    **{f"second path {share:.0%}": CenteringRoom(second_path=share) for share in BROKEN},
    **{f"one finger {share:.0%} more sensitive": CenteringRoom(apart=1.0 + share) for share in BROKEN},
    **{f"one finger fades by {share:.0%} in the turn": CenteringRoom(fades=1.0 - share) for share in BROKEN},
    **{
        f"one finger's echo spreads over {share:.0%} more": CenteringRoom(decays=1.0 + share)
        for share in BROKEN
    },
    **{f"wave {share:.0%} longer than believed": CenteringRoom(wave=1.0 / (1.0 + share)) for share in BROKEN},
}
"""`all three`: scatter, a second path of 10 % and the wall."""


def places_in(room: CenteringRoom, repeat: int, speed_m_s: float) -> list[Place]:
    """85 places in a room."""
    found = []
    for place in eighty_five(SEED, repeat, speed_m_s, 20.0 * math.log10(room.apart)):
        wall = EchoSettings(size_fs=WALL_FS / LEVEL, away_m=0.3, cosine=(1.0, -1.0)[place.number % 2])
        settings = RoomSettings(echoes=(wall,) * room.wall, second_path=room.second_path)
        found.append(
            place._replace(room=settings, finger_db=room.finger_db, fades=room.fades, decays=room.decays)
        )
    return found


def believing(way: Method, wave: float) -> Method:
    """Ours, set to another wavelength."""
    if wave == 1.0:
        return way
    settings = dict(way.tuning.finder) | {"sound_m_s": SOUND_M_S * wave}
    return way._replace(tuning=replace(way.tuning, finder=settings))


def main(quick: bool = False) -> None:
    """Run the study; writes results/centering_rooms.json."""
    started_s, every = time.perf_counter(), 17 if quick else 1
    profile = methods(load_profile("mock/centering", {}, table=Table()))
    with workers() as pool:
        choices = papers_choices(profile["paper"], pool)
        best = {speed_m_s: _best(choices[speed_m_s]) for speed_m_s in SPEEDS_M_S}
        ours = profile["ours"]
        turned = ours._replace(course=replace(ours.course, turned=True))
        keys, work = [], []
        for (name, room), speed_m_s in itertools.product(ROOMS.items(), SPEEDS_M_S):
            ways = {"ours": believing(ours, room.wave), "ours, turned": believing(turned, room.wave)}
            if not room.fades < 1.0 and room.wave == 1.0:
                ways["paper"] = at(profile["paper"], *best[speed_m_s])
            if room.fades < 1.0:
                del ways["ours"]  # it does not turn
            for (way, method), repeat in itertools.product(ways.items(), range(room.repeats)):
                places = places_in(room, repeat, speed_m_s)[::every]
                keys += [(name, way, speed_m_s, repeat)] * len(places)
                work += [(place, method) for place in places]
        found: dict[tuple[str, str, float], dict[int, list[Found]]] = {}
        for (name, way, speed_m_s, repeat), outcome in zip(keys, made(work, pool), strict=True):
            found.setdefault((name, way, speed_m_s), {}).setdefault(repeat, []).append(outcome)
    scores = {key: score(list(repeats.values())) for key, repeats in found.items()}
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
    """The paper's method with an alpha and the gamma of a distance."""
    settings = dict(paper.tuning.finder) | {"window_s": window_s, "threshold": gamma(distance_m)}
    return paper._replace(tuning=replace(paper.tuning, finder=settings))


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
