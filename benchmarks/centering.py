"""Centering without touching (C3): the paper's method and ours, 85 searches many times over, six objects, rooms.

`python -m benchmarks centering`. The program itself, as `run.py run mock/centering`, without the grasp.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, TypeVar

import numpy as np
from scipy.stats import t

from benchmarks.results import in_parallel, played, progress, save, workers
from config.profile import load_profile
from controller.detectors.envelope import as_complex
from controller.detectors.pretouch import PreTouchDetector
from controller.recording.reader import Run
from drivers.can_gripper.units import STROKE_M
from simulator.physics.aura import RIGHT, AuraMotion, AuraPlant
from simulator.physics.aura_settings import NOTHING, OBJECTS, SIX
from simulator.physics.gripper_part import AuraBenchSettings

SEED_TUNE, SEED_CALIBRATE, SEED_TEST, SEED_OBJECTS, SEED_ROOMS = 41_000, 42_000, 43_000, 44_000, 47_000
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

FULL, QUICK = (20, 85, 1), (1, 3, 17)
"""Repeats of the 85; searches for each object; and one in so many of the 85."""

Trial = Mapping[str, Any]
"""Factors of a search, and then its row."""


@dataclass(frozen=True)
class Method:
    """A way to search: a profile, which of its methods, and settings that differ, as TOML."""

    profile: str
    name: str
    settings: Mapping[str, str] = field(default_factory=dict)

    def having(self, key: str, value: object) -> Method:
        """The same with another setting."""
        return replace(self, settings={**self.settings, key: str(value)})

    def finding(self, key: str, value: float) -> Method:
        """The same with another setting of both finders."""
        left, right = (f"detectors.{side}_{self.name}.{key}" for side in ("left", "right"))
        return self.having(left, value).having(right, value)


APART, SCATTER = "plant.mismatch_db", "plant.finger_scatter_db"

PAPER, OURS = Method("mock/centering", "paper"), Method("mock/centering", "ours")


def half_m(name: str) -> float:
    """Room on either side of an object in the middle."""
    return 0.5 * (AuraBenchSettings().closed_width_m + STROKE_M - OBJECTS[name].width_m)


@dataclass(frozen=True)
class Searches:
    """A set of searches, all with one method; the seed keys their noise."""

    method: Method
    trials: Sequence[Trial]
    seed: int


T = TypeVar("T")


def taken(searches: Searches, take: Callable[[Run, Trial], T]) -> list[T]:
    """Make them, and take something of each."""
    method = searches.method
    trials = [{**trial, "method": method.name} for trial in searches.trials]
    settings = {**method.settings, "behavior.grasp": "false"}
    return played(method.profile, trials, settings, searches.seed, lambda run, row, spent_s: take(run, row))


def made(searches: Searches) -> list[Trial]:
    """Rows of the trials."""
    return taken(searches, lambda run, row: row)


# --- scores ------------------------------------------------------------------------------------


def clean(rows: Iterable[Trial]) -> list[Trial]:
    """Searches that found the middle without a touch: if a finger pushes the object, the middle of two touches is the
    object's anyway."""
    return [row for row in rows if row["error_m"] is not None and not row["touched"]]


def score(repeats: Sequence[Sequence[Trial]]) -> dict[str, Any]:
    """Of repeats of the same set: mean of the largest error in each with its 95 % interval (Student's t), the largest,
    mean, deviation and skewness of the errors, the median of their sizes; how many searches there were, saw
    nothing, were ended by the contact detectors, really touched the object, found the middle without; median distance
    at which the object was seen, and time. None where nothing is known."""
    every = [row for repeat in repeats for row in repeat]
    good = clean(every)
    errors_m = np.array([row["error_m"] for row in good])
    worst = [max(abs(row["error_m"]) for row in clean(repeat)) for repeat in repeats if clean(repeat)]
    mean, lo, hi = interval(worst)
    found: dict[str, Any] = {"worst_m": mean, "worst_lo_m": lo, "worst_hi_m": hi, "searches": len(every)}
    found |= {
        "unseen": sum(row["outcome"] == "not_found" for row in every),
        "stopped": sum(row["outcome"] == "false_contact" for row in every),
        "touched": sum(bool(row["touched"]) for row in every),
        "centred": len(good),
    }
    values: dict[str, Any] = {
        "largest_m": lambda: max(worst),
        "mean_m": errors_m.mean,
        "sd_m": errors_m.std,
        "median_m": lambda: np.median(np.abs(errors_m)),
        "skewness": lambda: np.mean((errors_m - errors_m.mean()) ** 3) / (errors_m.std() or math.nan) ** 3,
        "seen_m": lambda: np.median([_seen_m(row) for row in good]),
        "search_s": lambda: np.median([row["search_s"] for row in good]),
    }
    numbers = {name: float(value()) if good else math.nan for name, value in values.items()}
    return found | {name: None if math.isnan(number) else number for name, number in numbers.items()}


def _seen_m(row: Trial) -> list[float]:
    """Distance of the left and of the right finger from the object when they saw it, less than half of the room."""
    room_m = half_m(row.get("object", "pipe"))
    return [room_m - abs(row[side] - row["object_x_m"]) for side in ("left_m", "right_m")]


def interval(values: Sequence[float]) -> tuple[float | None, float | None, float | None]:
    """Mean and its 95 % interval by Student's t; None of too few."""
    n = len(values)
    mean = float(np.mean(values)) if n else None
    if mean is None or n < 2:
        return mean, None, None
    half = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / math.sqrt(n))
    return mean, mean - half, mean + half


# --- what is searched --------------------------------------------------------------------------


def eighty_five(seed: int, repeat: int, speed_m_s: float) -> list[Trial]:
    """One repeat: 85 places, drawn anew, the same for every method."""
    rng = np.random.default_rng((seed, repeat, round(1e3 * speed_m_s)))
    spots = [rng.uniform(low_m, high_m, n) for (low_m, high_m), n in zip(STARTS_M, SHARES, strict=True)]
    return [{"object_x_m": x_m, "speed_m_s": speed_m_s} for x_m in np.concatenate(spots).tolist()]


def repeated(count: int, method: Method, speed_m_s: float, seed: int, one_in: int = 1) -> list[Searches]:
    """The 85, or one in so many of them, so many times."""
    noise = seed + round(1e3 * speed_m_s)
    return [
        Searches(method, eighty_five(seed, repeat, speed_m_s)[::one_in], noise + 1000 * repeat)
        for repeat in range(count)
    ]


def with_object(name: str, n: int, speed_m_s: float, method: Method) -> list[Searches]:
    """Searches for one of the six, from anywhere at least `LEAST_GAP_M` from both fingers."""
    reach_m = min(STARTS_M[0][1], half_m(name) - LEAST_GAP_M)
    seed = SEED_OBJECTS + 100 * SIX.index(name) + round(1e3 * speed_m_s)
    spots = np.random.default_rng(seed).uniform(-reach_m, reach_m, n)
    about = {"object": name, "speed_m_s": speed_m_s}
    return [Searches(method, [{"object_x_m": x_m, **about} for x_m in spots.tolist()], seed)]


Key = tuple[Any, ...]


def scores(jobs: Mapping[Key, Sequence[Searches]], pool: Any) -> dict[Key, dict[str, Any]]:
    """The score of each, of which each has one or more repeats of the same set."""
    found = iter(in_parallel(made, [each for sets in jobs.values() for each in sets], pool))
    return {key: score([next(found) for _ in sets]) for key, sets in jobs.items()}


def gains_of(mismatch_db: float) -> tuple[float, float]:
    """Gains of the right and the left finger, measured: with the pipe in the middle each finger goes to it ten times,
    and the mean amplitude that its detector fits at 8 mm is made the same for both."""
    nearer = OURS.having(APART, mismatch_db).finding("level_fs", 0.003)  # both come past that distance
    passes = Searches(nearer, [{"object_x_m": 0.0, "speed_m_s": 0.01}] * CALIBRATIONS, SEED_CALIBRATE)
    fitted_fs = taken(passes, lambda run, row: [_amplitude_fs(run, row, side) for side in (-1, 1)])
    right, left = np.log(fitted_fs).mean(axis=0).tolist()
    return math.exp(0.5 * (left - right)), math.exp(0.5 * (right - left))


def _amplitude_fs(run: Run, row: Trial, side: int) -> float:
    """The detector's fitted amplitude at the distance of calibration, in the pass towards -1, right, or 1, left."""
    trial, state = row["trial"], "SEEKING_FORWARD" if side > 0 else "SEEKING_BACKWARD"
    begun_s = next(float(e["t_s"]) for e in run.events_of(trial) if e["next"] == state)
    ended_s = next(
        float(e["t_s"]) for e in run.events_of(trial) if e["state"] == state and e["next"] != state
    )
    envelope = run.signal(trial, "signals.left" if side > 0 else "signals.right")
    inside = (envelope.times_s >= begun_s) & (envelope.times_s <= ended_s)
    encoder = run.signal(trial, "arm.position")
    position_m = np.interp(envelope.times_s[inside], encoder.times_s, encoder.values[:, 0])
    profile: Any = load_profile(OURS.profile, {})
    settings = profile.detectors["right_ours"].settings
    _, amplitudes_fs = PreTouchDetector("right", settings).traced(
        as_complex(envelope.values[inside]), position_m, 1000.0
    )
    gap_m = half_m("pipe") - side * position_m
    known = np.flatnonzero(np.isfinite(amplitudes_fs))[::-1]  # the distance falls
    return float(np.interp(CALIBRATION_GAP_M, gap_m[known], amplitudes_fs[known]))


# --- rooms, and the paper's method at its best -------------------------------------------------


WINDOWS_S = (0.03, 0.06, 0.125, 0.25, 0.5)
DISTANCES_M = (0.008, 0.0125)
"""Tried values of the paper's alpha, and of the distance for its gamma."""

DRIVE_HZ, LEVEL = 40_000.0, 0.5
"""As behaviors/sonic.py drives it."""

WALL = f"[{{ size_fs = {1e-4 / LEVEL}, away_m = 0.3 }}]"
"""Ahead; 1e-4 of full scale as received by a finger."""

TURNED = replace(OURS, profile="mock/centering_turned")

ROOMS: Mapping[str, tuple[Mapping[str, object], int]] = {
    "empty": ({}, 1),
    "fingers scatter by 1 dB": ({SCATTER: 1.0}, 3),
    "wall 1e-4": ({"plant.room.echoes": WALL}, 1),
    "all three": ({SCATTER: 1.0, "plant.room.echoes": WALL, "plant.room.second_path": 0.1}, 3),
}
"""What differs from an empty room and fingers of equal sensitivity, and how many sets of 85. Scatter: standard
deviation of each finger's sensitivity from search to search. `all three`: with a second path of 10 % as well."""


def inside(room: Mapping[str, object], method: Method) -> Method:
    """A method in a room."""
    for key, value in {APART: 0.0, **room}.items():
        method = method.having(key, value)
    return method


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


def in_rooms(pool: Any, one_in: int) -> dict[str, Any]:
    """What the paper's method chooses, and every method in every room at its speeds."""
    choices = product(SPEEDS_M_S, WINDOWS_S, DISTANCES_M)
    tried = scores(
        {key: repeated(1, paper_at(*key[1:]), key[0], SEED_TUNE, 4 * one_in + 4) for key in choices}, pool
    )
    best = {speed: _best({key: tried[key] for key in tried if key[0] == speed}) for speed in SPEEDS_M_S}
    jobs: dict[Key, list[Searches]] = {}
    for (name, (room, count)), speed in product(ROOMS.items(), SPEEDS_M_S):
        for way, method in {
            "ours, turned": TURNED,
            "ours": OURS,
            "paper": paper_at(*best[speed][1:]),
        }.items():
            jobs[name, way, speed] = repeated(count, inside(room, method), speed, SEED_ROOMS, one_in)
    rows = {" | ".join(map(str, key)): one for key, one in scores(jobs, pool).items()}
    names = ("speed_m_s", "window_s", "distance_m")
    listed = [
        dict(zip(names, key, strict=True)) | one | {"chosen": key in best.values()}
        for key, one in tried.items()
    ]
    return {"rows": rows, "papers_choices": listed}


def _best(tried: Mapping[Key, Mapping[str, Any]]) -> Key:
    """Least worst error among those that lost fewest."""
    fewest = min(one["searches"] - one["centred"] for one in tried.values())
    least = {key: one for key, one in tried.items() if one["searches"] - one["centred"] <= fewest + 1}
    return min(least, key=lambda key: least[key]["largest_m"] or math.inf)


def main(quick: bool = False) -> None:
    """Run the study, print the worst of the 85; writes results/centering.json and results/centering_rooms.json."""
    started_s, (repeats, objects, one_in) = time.perf_counter(), QUICK if quick else FULL
    right, left = gains_of(MISMATCH_DB)
    calibrated = OURS.having("detectors.right_ours.gain", right).having("detectors.left_ours.gain", left)
    ways = [
        ("paper", PAPER, 0.0),
        ("ours", OURS, 0.0),
        ("paper", PAPER, MISMATCH_DB),
        ("ours", OURS, MISMATCH_DB),
    ]
    ways.append(("ours, gains calibrated", calibrated, MISMATCH_DB))
    six = {each.name: replace(each, profile="mock/centering_objects") for each in (PAPER, OURS)}
    tables: dict[str, tuple[tuple[str, ...], dict[Key, list[Searches]]]] = {
        "eighty_five": (
            ("method", "mismatch_db", "speed_m_s"),
            {
                (name, db, v): repeated(repeats, method.having(APART, db), v, SEED_TEST, one_in)
                for (name, method, db), v in product(ways, SPEEDS_M_S)
            },
        ),
        "objects": (
            ("object", "method", "speed_m_s"),
            {
                (name, kind, v): with_object(name, objects, v, six[kind])
                for name, kind, v in product(SIX, six, SPEEDS_M_S)
            },
        ),
    }
    study: dict[str, Any] = {"simulated": True, "gains_right_left": {f"{MISMATCH_DB:g} dB": (right, left)}}
    with workers() as pool:
        for table, (names, jobs) in tables.items():
            found = scores(jobs, pool)
            study[table] = [dict(zip(names, key, strict=True)) | one for key, one in found.items()]
            progress(table)
        save("centering_rooms", in_rooms(pool, one_in), quick=quick)
    save("centering", study | {"wall_s": time.perf_counter() - started_s}, quick=quick)
