"""A grasp with little more than the least force (D1): ours, fixed grips, steps, the paper's slip rule, an oracle.

`python -m benchmarks grasp`. The program itself, as `run.py run mock/grasp`, on random objects: found by their aura,
centred on, gripped, lifted, shaken, loaded, tapped, set down. Objects of one seed choose the rule's settings and
the friction's interval, objects of another judge. Finished parts are kept, so that an interrupted study goes on.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.results import kept, played, progress, save
from config.profile import load_profile
from controller.recording.reader import Run
from controller.reports.counts import wilson
from simulator.physics.held_kernel import GRAVITY_M_S2, TURN_M

SEED_CHOOSE, SEED_JUDGE, SEED_VARY = 61_000, 62_000, 63_000

PART = 20
"""Objects of a run: so many are kept at once, with their own noise."""

LEAST_N, MOST_N = 7.0, 36.0
"""Least force at rest of the objects that are drawn: what the gripper can be asked for, half of the weight more too."""

BESIDE_M, ROOM_M, OPEN_M = 0.008, 0.008, 0.063
"""How far the object stands from the start pose at the most; how much room either finger has there at the least, more
than the 7 mm at which it sees; how far open the jaws are."""


class Thing(NamedTuple):
    """An object that is drawn, and where it stands."""

    number: int
    x_m: float
    mass_kg: float
    friction: float
    lever_m: float
    width_m: float
    stiffness_n_m: float
    roughness: float
    crush_n: float

    @property
    def least_n(self) -> float:
        """That holds it at rest."""
        lever = math.hypot(1.0, self.lever_m / TURN_M)
        return self.mass_kg * GRAVITY_M_S2 * lever / (2.0 * self.friction)

    def row(self, plant: Mapping[str, float]) -> dict[str, Any]:
        """A trial with it, settings of the plant multiplied by factors."""
        own = {"object_kg": self.mass_kg, "pad_friction": self.friction, "lever_m": self.lever_m}
        own |= {"object_width_m": self.width_m, "object_n_m": self.stiffness_n_m, "crush_n": self.crush_n}
        own |= {"pad_roughness": self.roughness}
        own |= {name: factor * own.get(name, PLANT[name]) for name, factor in plant.items()}
        about = {"object_x_m": self.x_m, "method": "ours", "speed_m_s": 0.01}
        return about | {f"plant.{name}": value for name, value in own.items()}


def drawn(seed: int, count: int) -> list[Thing]:
    """Random objects: masses log-uniform in 0.02 to 1 kg, friction in 0.15 to 0.9, every other one gripped up to 2 mm
    off its centre; those that the gripper cannot hold with little force are drawn anew."""
    random, found = np.random.default_rng(seed), list[Thing]()
    while len(found) < count:
        mass_kg, friction = 10 ** random.uniform(math.log10(0.02), 0.0), random.uniform(0.15, 0.9)
        lever_m = random.uniform(0.0, 0.002) if random.random() < 0.5 else 0.0
        width_m, stiffness_n_m = random.uniform(0.018, 0.04), 10 ** random.uniform(4.0, 5.0)
        roughness, crush = random.uniform(0.02, 0.1), random.uniform(1.3, 5.0)
        x_m = random.uniform(-1.0, 1.0) * min(BESIDE_M, 0.5 * (OPEN_M - width_m) - ROOM_M)
        thing = Thing(len(found), x_m, mass_kg, friction, lever_m, width_m, stiffness_n_m, roughness, 0.0)
        if LEAST_N <= thing.least_n <= MOST_N:
            # of the least that holds it through all, half of its weight more included
            found.append(thing._replace(crush_n=crush * 1.5 * thing.least_n))
    return found


PROFILE = load_profile("mock/grasp", {})
assert PROFILE.plant is not None
PLANT = PROFILE.plant.settings.model_dump()


def grasped(
    seed: int, things: Sequence[Thing], rule: Mapping[str, str], plant: Mapping[str, float]
) -> list[Mapping[str, Any]]:
    """Rows of the grasps of some objects, and what they took.

    Args:
        rule: Settings that differ from the profile's; `OVER_LEAST` is a fixed grip by the truth.
        plant: Factors of settings of the plant.
    """
    rest, rows = dict(rule), [thing.row(plant) for thing in things]
    if over := float(rest.pop(OVER_LEAST, "0")):
        for row, thing in zip(rows, things, strict=True):
            row["behavior.grip_force_n"] = min(max(over * thing.least_n, LEAST_N), 60.0)
    made = played("mock/grasp", rows, rest, seed, _told)
    return [{**thing._asdict(), **row} for thing, row in zip(things, made, strict=True)]


def _told(run: Run, row: Mapping[str, Any], spent_s: float) -> Mapping[str, Any]:
    times_s = [float(event["t_s"]) for event in run.events_of(row["trial"])]
    return {**row, "bench_s": times_s[-1] - times_s[0], "spent_s": spent_s}


OVER_LEAST = "grip over the least"
FIXED = {"behavior.slip": "[]", "behavior.load": "[]"}
STEPS = {"behavior.load": "[]", "behavior.rule": "step"}
PAPERS = {"behavior.slip": '["slip_paper"]'}

RULES: Mapping[str, Mapping[str, str]] = {
    "ours": {},
    **{
        f"fixed, {force_n} N": FIXED | {"behavior.grip_force_n": f"{force_n}.0"}
        for force_n in (10, 20, 40, 60)
    },
    "oracle, fixed at 1.65 of the least": FIXED | {OVER_LEAST: "1.65"},
    "paper's slip detector, steps of 2 N": STEPS | PAPERS,
    "our slip detector, steps of 2 N": STEPS,
    "ramp while slip is told, 25 N/s": STEPS | {"behavior.tighten_n": "0.5", "behavior.tighten_s": "0.02"},
    "ours, no slip detector": {"behavior.slip": "[]"},
    "ours, load not followed": {"behavior.load": "[]"},
    "ours, no plateau": {"behavior.plateau_s": "0.0"},
    "ours, no boost": {"behavior.boost": "1.0", "behavior.limit": "1.0"},
    "ours, the paper's slip detector": PAPERS,
    "ours, no centering": {"behavior.center": "false"},
}
"""Every rule in the same scene. The gripper presses with 60 N at the most: 80 N is out of its reach."""

CHOSEN = 180, 1000, 20, 10
"""Objects that choose, that judge ours, that judge each rival, and for each setting of the plant that is varied."""

VARIED = ("pad_roughness", "added", "pad_noise_scale")
FACTORS = (0.7, 0.9, 1.1, 1.3)


def judged(
    name: str, seed: int, things: Sequence[Thing], rule: Mapping[str, str], plant: Mapping[str, float] = {}
) -> list[Mapping[str, Any]]:
    """Rows of the grasps of some objects, part by part."""
    found: list[Mapping[str, Any]] = []
    file = "grasp_" + "".join(each if each.isalnum() else "_" for each in name)
    for first in range(0, len(things), PART):
        part = things[first : first + PART]
        compute = partial(grasped, seed + first, part, rule, plant)
        found += kept(f"{file}_{first}_{len(part)}", compute)
    progress(f"{name}: {dict(summary(found))}")
    return found


def _share(hits: int, of: int) -> Mapping[str, float]:
    low, high = wilson(hits, of)
    return {"count": hits, "of": of, "low": low, "high": high}


def _quantiles(values: Sequence[float | None]) -> Mapping[str, float | None]:
    known = np.array([value for value in values if value is not None])
    if not len(known):
        return {"of": 0, "median": None, "p95": None, "most": None}
    median, p95 = np.quantile(known, (0.5, 0.95)).tolist()
    return {"of": len(known), "median": median, "p95": p95, "most": float(known.max())}


def summary(rows: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """What a rule came to."""
    outcomes, n = Counter(row["outcome"] for row in rows), len(rows)
    lifts = [row for row in rows if row["told_false"] is not None]
    known = [row for row in lifts if row["friction"] is not None and row["friction_true"] is not None]
    inside = sum(row["friction_low"] <= row["friction_true"] <= row["friction_high"] for row in known)
    pushes_n = [row["push_n"] for row in lifts]
    return {
        "objects": n,
        "outcomes": dict(outcomes),
        "held": _share(outcomes["held"], n),
        "crushed": _share(outcomes["crushed"], n),
        "dropped": _share(outcomes["dropped"] + outcomes["not_lifted"], n),
        "over_least": _quantiles([row["grip_over_least"] for row in rows if row["outcome"] == "held"]),
        "tightened_falsely": _share(sum(bool(row["told_false"]) for row in lifts), len(lifts)),
        "told_true": sum(row["told_true"] for row in lifts),
        "told_false": sum(row["told_false"] for row in lifts),
        "untold": sum(row["untold"] for row in lifts),
        "slid_in_air": _share(sum(bool(row["arrested_m"]) for row in lifts), len(lifts)),
        "arrested_m": _quantiles([row["arrested_m"] for row in lifts if row["arrested_m"]]),
        "friction": _share(inside, len(known)),
        "push_n": _quantiles(pushes_n),
        "push_below": _share(sum(push < PUSH_N for push in pushes_n), len(lifts)),
        "felt_n": _quantiles([row["felt_n"] for row in lifts]),
        "cycle_s": _quantiles([row["cycle_s"] for row in lifts]),
        "times_real": sum(row["bench_s"] for row in rows) / sum(row["spent_s"] for row in rows),
    }


PUSH_N = 0.1
"""What a first touch may push at the most."""


def interval_of(rows: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Ends of the friction's 90 % interval, over the estimate."""
    ratios = [
        row["friction_true"] / row["friction"] for row in rows if row["friction"] and row["friction_true"]
    ]
    low, high = np.quantile(ratios, (0.05, 0.95)).tolist()
    return float(low), float(high)


def main(*, quick: bool = False) -> None:
    """Judge, choose, vary."""
    choose, judge, rivals, vary = (max(1, count // 20) for count in CHOSEN) if quick else CHOSEN
    result: dict[str, Any] = {"rules": {}, "varied": {}}
    objects = drawn(SEED_JUDGE, judge)
    for name, rule in RULES.items():
        part = objects if name == "ours" else objects[:rivals]
        result["rules"][name] = summary(judged(name, SEED_JUDGE, part, rule))
        save("grasp", result, quick=quick)
    things = drawn(SEED_CHOOSE, choose)
    rows = judged("choosing", SEED_CHOOSE, things, {})
    result["choosing"], result["interval"] = summary(rows), interval_of(rows)
    save("grasp", result, quick=quick)
    things = drawn(SEED_VARY, vary)
    for name in VARIED:
        for factor in FACTORS:
            rows = judged(f"varied {name} {factor}", SEED_VARY, things, {}, {name: factor})
            result["varied"][f"{name} x {factor}"] = summary(rows)
        save("grasp", result, quick=quick)
    result["varied"]["nothing"] = summary(judged("varied nothing", SEED_VARY, things, {}))
    save("grasp", result, quick=quick)
