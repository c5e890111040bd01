"""What is searched: the 85 of the paper, twenty times over, six objects, and unequal fingers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.centering.scenes import DRIVE_HZ, LEVEL, CenteringScene, Place, after
from benchmarks.centering.search import Found, SearchCourse, Tuning, block_of, finder, search
from controller.signals.along import as_complex
from drivers.mock.physics.aura import BOTH, ENVELOPE_HZ, LEFT, RIGHT, AuraMotion, AuraPlant
from drivers.mock.physics.aura_objects import NOTHING, OBJECTS, SIX
from drivers.mock.physics.gripper_part import AuraBenchSettings

SEED_TUNE, SEED_CALIBRATE, SEED_TEST, SEED_OBJECTS, SEED_SCATTER = 41_000, 42_000, 43_000, 44_000, 45_000
"""Every part has its own noise and places; choices were made on the first."""

SPEEDS_M_S = (0.01, 0.03)
MISMATCH_DB = 1.5
STARTS_M = ((0.006, 0.011), (-0.002, 0.002), (-0.011, -0.006))
"""Near the right finger, near the middle, near the left one."""
SHARES = (29, 27, 29)
"""Of the 85."""

LEAST_GAP_M = 0.007
"""No object of the six starts nearer than this to a finger: the detector needs 5 mm of travel."""

CALIBRATIONS = 10
"""Passes of each finger from which its gain is measured."""
CALIBRATION_GAP_M = 0.008
"""At this distance of the pipe."""

WINDOWS_S = (0.125, 0.25, 0.5, 1.0)
DISTANCES_M = (0.006, 0.008, 0.010, 0.0125, 0.015)
LEVELS_FS = (0.0, 0.0005, 0.001, 0.0015, 0.002, 0.0025, 0.003, 0.004)
"""Tried values of the paper's alpha, of the distance for its gamma, and of our amplitude."""

SCATTERS_DB = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class CenteringSize:
    """Size of the study.

    Attributes:
        repeats: Of the 85.
        aside: Repeats of the side studies.
        objects: Searches for each object, speed and method.
        tune: Searches for each of the settings that are tried.
    """

    repeats: int
    aside: int
    objects: int
    tune: int


FULL, QUICK = CenteringSize(20, 3, 85, 42), CenteringSize(2, 1, 17, 17)


class Method(NamedTuple):
    """A search method, from the profile.

    Attributes:
        tuning: Its detectors.
        course: Its procedure.
    """

    tuning: Tuning
    course: SearchCourse


def methods(profile: Any) -> dict[str, Method]:
    """The paper's and ours, as the profile has them."""
    behavior = profile.behavior
    course = SearchCourse(
        behavior.sweep_m, behavior.baseline_s, behavior.run_up, behavior.blind_m, profile.loop.rate_hz
    )
    given = {name: _given(entry.settings) for name, entry in profile.detectors.items()}
    contact = {key: value for key, value in given["left_contact"].items() if key != "input"}
    found = {}
    for name in ("paper", "ours"):
        sides = [dict(given[f"{side}_{name}"]) for side in ("right", "left")]
        gains = tuple(float(side.pop("gain", 1.0)) for side in sides)
        (settings,) = {tuple(sorted((k, v) for k, v in side.items() if k != "input")) for side in sides}
        tuning = Tuning(name, dict(settings), (gains[RIGHT], gains[LEFT]), contact)
        found[name] = Method(tuning, replace(course, run_up=course.run_up and name == "ours"))
    return found


def _given(settings: Any) -> dict[str, Any]:
    """A detector's settings that differ from its class's defaults in a profile."""
    return {name: getattr(settings, name) for name in settings.model_fields_set}


def eighty_five(seed: int, repeat: int, speed_m_s: float, mismatch_db: float = 0.0) -> list[Place]:
    """One repeat: 85 places, drawn anew, the same for every method."""
    rng = np.random.default_rng((seed, repeat, round(1e3 * speed_m_s)))
    spots = [rng.uniform(low_m, high_m, n) for (low_m, high_m), n in zip(STARTS_M, SHARES, strict=True)]
    numbers = 1000 * repeat + np.arange(sum(SHARES))
    return [
        Place(seed + round(1e3 * speed_m_s), int(number), "pipe", float(x_m), speed_m_s, mismatch_db)
        for number, x_m in zip(numbers, np.concatenate(spots), strict=True)
    ]


def with_object(name: str, n: int, speed_m_s: float) -> list[Place]:
    """Searches for one of the six, from anywhere at least `LEAST_GAP_M` from both fingers."""
    reach_m = object_reach_m(name)
    seed = SEED_OBJECTS + 100 * SIX.index(name) + round(1e3 * speed_m_s)
    spots = np.random.default_rng(seed).uniform(-reach_m, reach_m, n)
    return [Place(seed, number, name, float(x_m), speed_m_s) for number, x_m in enumerate(spots)]


def object_reach_m(name: str) -> float:
    """How far from the middle an object starts at the most."""
    room_m = CenteringScene(Place(0, 0, name, 0.0, 0.01)).gap_m(LEFT, 0.0)
    return min(STARTS_M[0][1], room_m - LEAST_GAP_M)


def made(work: Sequence[tuple[Place, Method]], pool: ProcessPoolExecutor) -> list[Found]:
    """All these searches, in order."""
    return list(pool.map(_one, work, chunksize=max(1, min(50, len(work) // 8))))


def _one(job: tuple[Place, Method]) -> Found:
    place, method = job
    return search(place, method.tuning, method.course)


# from a distance to an amplitude


def wave_fs(distance_m: float, name: str = "pipe") -> float:
    """Mean amplitude of what an object sends back from a distance, full scales at the drive's level."""
    settings = AuraBenchSettings(gain_scatter_db=0.0, phase_scatter_rad=0.0)
    fields = []
    for thing in (OBJECTS[name], OBJECTS.get(NOTHING)):
        plant = AuraPlant(settings)
        plant.begin((0, 0), thing, settings.object_top_m, "normal")
        gap_m = np.array([[distance_m, 1.0]])
        motion = AuraMotion(
            gap_m, np.zeros(1), np.zeros(1), np.full(1, 0.063), np.zeros((1, 2)), np.zeros(1), np.zeros(1)
        )
        fields.append(
            plant.field(motion, np.zeros(1), np.full(1, DRIVE_HZ), np.full(1, LEVEL), (RIGHT,))[0, RIGHT]
        )
    return float(abs(fields[0] - fields[1]))


def gamma(distance_m: float) -> float:
    """The paper's threshold for a distance: power of that wave in phase, if it kept its size over a window."""
    return 0.5 * wave_fs(distance_m) ** 2


def papers_choices(
    method: Method, size: CenteringSize, pool: ProcessPoolExecutor
) -> dict[tuple[float, float], dict[float, list[Found]]]:
    """Searches by alpha (s) and the distance (m) of gamma, both speeds."""
    keys = [(window_s, distance_m) for window_s in WINDOWS_S for distance_m in DISTANCES_M]
    found: dict[tuple[float, float], dict[float, list[Found]]] = _choices(
        method,
        {
            key: replace(
                method.tuning,
                finder=dict(method.tuning.finder) | {"window_s": key[0], "threshold": gamma(key[1])},
            )
            for key in keys
        },
        size,
        pool,
    )
    return found


def our_choices(
    method: Method, size: CenteringSize, pool: ProcessPoolExecutor
) -> dict[tuple[float, bool], dict[float, list[Found]]]:
    """Searches by amplitude (full scales), with and without the run-up, both speeds."""
    found: dict[tuple[float, bool], dict[float, list[Found]]] = {}
    for run_up in (False, True):
        tunings = {
            level_fs: replace(method.tuning, finder=dict(method.tuning.finder) | {"level_fs": level_fs})
            for level_fs in LEVELS_FS
        }
        way = method._replace(course=replace(method.course, run_up=run_up))
        found |= {
            (level_fs, run_up): by_speed for level_fs, by_speed in _choices(way, tunings, size, pool).items()
        }
    return found


def _choices(
    method: Method, tunings: Mapping[Any, Tuning], size: CenteringSize, pool: ProcessPoolExecutor
) -> Any:
    keys, work = [], []
    for key, tuning in tunings.items():
        for speed_m_s in SPEEDS_M_S:
            places = eighty_five(SEED_TUNE, 0, speed_m_s)[:: max(1, 85 // size.tune)]
            keys += [(key, speed_m_s)] * len(places)
            work += [(place, method._replace(tuning=tuning)) for place in places]
    found: dict[Any, dict[float, list[Found]]] = {}
    for (key, speed_m_s), outcome in zip(keys, made(work, pool), strict=True):
        found.setdefault(key, {}).setdefault(speed_m_s, []).append(outcome)
    return found


# gains of the two fingers


def gains_of(mismatch_db: float, method: Method) -> tuple[float, float]:
    """Gains of the right and the left finger, measured: with the pipe in the middle each finger goes to it ten times,
    and the mean amplitude that its detector fits at 8 mm is made the same for both."""
    logs = {RIGHT: [], LEFT: []}  # type: dict[int, list[float]]
    for number in range(CALIBRATIONS):
        for which in BOTH:
            place = Place(SEED_CALIBRATE, number, "pipe", 0.0, 0.01, mismatch_db)
            logs[which].append(math.log(_amplitude_fs(place, which, method)))
    half = 0.5 * (float(np.mean(logs[RIGHT])) - float(np.mean(logs[LEFT])))
    return math.exp(-half), math.exp(half)


def _amplitude_fs(place: Place, which: int, method: Method) -> float:
    """The detector's fitted amplitude at the distance of calibration."""
    bench = CenteringScene(place)
    forward = 1.0 if which == LEFT else -1.0
    bench.arm.move_at(place.begin_s, forward * place.speed_m_s, forward * 0.018)
    first, end = after(place.begin_s), after(bench.arm.arrival_s)
    z, _ = bench.receive(first, end)
    position_m = bench.arm.coordinates(np.arange(first, end) / ENVELOPE_HZ)[:, 0]
    detector = finder(replace(method.tuning, gains=(1.0, 1.0)), which)
    envelope = as_complex(block_of(which, first, z).physical)
    _, amplitudes_fs = detector.traced(envelope, position_m, float(ENVELOPE_HZ))  # type: ignore[union-attr]
    gaps_m: NDArray[np.float64] = np.array([bench.gap_m(which, x_m) for x_m in position_m.tolist()])
    known = np.isfinite(amplitudes_fs)
    order = np.argsort(gaps_m[known])
    return float(np.interp(CALIBRATION_GAP_M, gaps_m[known][order], amplitudes_fs[known][order]))
