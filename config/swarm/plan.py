"""What a seed draws: a profile of at most ten lines, which `run.py run` plays."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from config.assemble import plan_campaign, used_by
from config.profile import Profile, load_profile
from config.source import flatten, nest, toml_value
from config.swarm.cells import MOVING, NEEDS, PLANS, Cell, had
from controller.own_modules import found
from controller.registry import experiment_of, row
from simulator.devices.faults import OF_THE_BENCH

Settings = Mapping[str, Any]

EVENTS_MAX = 6
"""Most faults of a plan."""

TRIALS_MAX = 3

STRIDE = 1_000_003
"""From a led seed's cell to the next one's: a prime beyond the number of cells, so that each has its turn."""

BENCH_WIDE = ("loop", "keys", "disk")
"""What goes wrong and is no device: see `simulator.devices.faults.OF_THE_BENCH`."""

SHORTEST_S, LONGEST_S = 0.002, 2.0
"""Of a fault's length, log-uniform."""


class Way(NamedTuple):
    """What leads a trial into a state that most trials do not enter.

    Attributes:
        settings: Beside those drawn.
        rows: Factors of trials that enter it, and their values; of none, any trial does.
        faults: That come before.
    """

    settings: Mapping[str, Any] = {}
    rows: Mapping[str, Sequence[str]] = {}
    faults: Sequence[Mapping[str, Any]] = ()


class Excerpt(NamedTuple):
    """An experiment as the swarm plays it.

    Attributes:
        weight: How often, beside the others.
        short: Settings that keep its trials short.
        drawn: Bounds between which settings are drawn; log-uniform where both are above 0.
        extends: The profile `mock/…`, where it has another name.
        behavior: Of the swarm's own, in place of the profile's.
        ways: By state.
    """

    weight: int
    short: Settings
    drawn: Mapping[str, tuple[float, float]]
    extends: str = ""
    behavior: str = ""
    ways: Mapping[str, Way] = {}


_FINGER = {
    "behavior.settle_s": (1.0, 3.0),
    "loop.rate_hz": (60.0, 400.0),
    "limits.stale_s": (0.06, 0.2),
    "limits.stuck_s": (0.05, 0.5),
    "limits.late_s": (0.03, 0.3),
    "limits.force_n": (0.03, 2.0),
    "limits.force_median_s": (0.003, 0.05),
    "limits.retreat_m": (0.0005, 0.004),
}
_NEAR_OR_FAR = {"plant.surface_m": (0.0004, 0.0095), "behavior.approach_limit_m": (0.002, 0.0115)}
_SONIC: Settings = {
    "behavior.handling_speed_m_s": 0.05,
    "behavior.open_speed_m_s": 0.05,
    "behavior.hold_s": 0.2,
    "behavior.motion_timeout_s": 12.0,
    "loop.rate_hz": 50.0,
}

_NEAR: Settings = {**_SONIC, "behavior.clear_m": 0.01, "behavior.baseline_s": 1.0}
"""What stands between the fingers would be held while the jaws find their ends: not where they close on it."""

_TRANSIENT: Settings = {
    "behavior.settle_s": 1.0,
    "behavior.motion_timeout_s": 12.0,
    "detectors.contact.threshold_sigma": 8.0,
    "detectors.ours": "none",
}

_TURNED = {
    "behavior.half_turn": True,
    "devices.arm.max_turn_rad_s": 1.3,
    "limits.reach_rad": 3.2,
    "limits.turn_rad_s": 1.3,
}
_OURS = Way(rows={"method": ["ours"]})
_BETWEEN = {
    "HALF_TURN": Way(_TURNED),
    "BACKING_OFF": Way({f"detectors.{side}_contact.threshold": 0.5 for side in ("left", "right")}),
    "CONFIRMING": Way({f"detectors.{side}_contact.threshold": 1e6 for side in ("left", "right")}),
    "RUNNING_UP": _OURS,
    "REVERSING": _OURS,
}
"""The wrist turns; the fingers feel a touch where there is none; they do not feel what the jaws hold."""

NOT_ENTERED: Mapping[tuple[str, str], str] = {
    (
        "pretouch",
        "STOPPING",
    ): "an approach that is to touch nothing is stopped by no touch; `touch` has this state",
}
"""States that no trial of an experiment can enter, and why."""

_STOPPED = Way(faults=[{"device": "loop", "kind": "hang", "amount": 0.3, "after": "APPROACH", "at_s": 0.05}])
_TILTED = Way(rows={"sensor": ["fingertip"]})
_ROLLED = Way(rows={"sensor": ["fingertip", "wrist"]})
_SLIPPED = Way({"behavior.stop_on_slip": True}, {"sensor": ["fingertip", "barrett_finger"]})

SCENES: Mapping[str, Excerpt] = {
    "transient": Excerpt(
        8,
        _TRANSIENT,
        {
            **_FINGER,
            **_NEAR_OR_FAR,
            "behavior.hold_s": (0.05, 0.4),
            "plant.noise_scale": (0.3, 1.5),
            "detectors.contact.threshold_sigma": (4.0, 100.0),
        },
    ),
    "reckless": Excerpt(
        4,
        _TRANSIENT,
        {**_FINGER, **_NEAR_OR_FAR, "detectors.contact.threshold_sigma": (4.0, 100.0)},
        "transient",
        "config.swarm.reckless:Reckless",
        {"HEEDLESS": _STOPPED, "DRIVING_ON": _STOPPED},
    ),
    "first_contact": Excerpt(
        4,
        {"behavior.answer_timeout_s": 12.0, "behavior.motion_timeout_s": 12.0},
        {"behavior.speed_m_s": (0.0004, 0.001), "behavior.nudge_m": (0.0002, 0.0008)},
    ),
    "static": Excerpt(
        4,
        {
            "behavior.settle_s": 1.0,
            "behavior.motion_timeout_s": 12.0,
            "behavior.rest_s": 0.2,
            "behavior.record_s": 0.5,
        },
        {**_FINGER, "behavior.record_s": (0.3, 1.0)},
    ),
    "transient_arm": Excerpt(
        5,
        _TRANSIENT,
        {**_FINGER, **_NEAR_OR_FAR, "behavior.hold_s": (0.05, 0.4)},
    ),
    "pretouch": Excerpt(2, _NEAR, {"limits.stale_s": (0.06, 0.2)}),
    "touch": Excerpt(1, _NEAR, {"limits.stale_s": (0.06, 0.2)}),
    "centering": Excerpt(1, _SONIC, {"behavior.grip_force_n": (7.0, 14.0)}, ways=_BETWEEN),
    "grasp": Excerpt(
        1,
        {**_SONIC, "behavior.lift_m": 0.03, "behavior.shake_s": 0.8},
        {"behavior.grip_force_n": (7.0, 12.0)},
        ways=_BETWEEN,
    ),
    "slip": Excerpt(
        1,
        {"plant.surface_m": 0.0012, "behavior.motion_timeout_s": 12.0, "behavior.home_timeout_s": 60.0},
        {"behavior.rest_s": (0.2, 0.9)},
        ways={
            "TILTING": _TILTED,
            "ROLLING": _ROLLED,
            "LEVELLING": _ROLLED,
            "LOADING": Way(rows={"sensor": ["fingertip", "flexible_finger", "barrett_finger", "dsa"]}),
            "HALTING": _SLIPPED,
            "STOPPED": _SLIPPED,
        },
    ),
    "weights": Excerpt(
        1,
        {
            "behavior.answer_timeout_s": 12.0,
            "behavior.cycles": 1,
            "behavior.preloads": 0,
            "behavior.weights_x_n": [1.0, 2.0],
        },
        {"behavior.swing_s": (0.2, 1.0), "behavior.record_s": (0.1, 0.5)},
    ),
}
"""By name, each of the profile `mock/NAME` if it does not say another. Those with few trials a CPU second are drawn
seldom."""


@dataclass(frozen=True)
class Plan:
    """What is played.

    Attributes:
        seed: That drew it.
        settings: Dotted, beside those of the profile that it extends.
        trials: Its trials' factors, in their order.
        faults: As a profile has them.
    """

    seed: int
    experiment: str
    settings: Settings
    trials: Sequence[Mapping[str, Any]]
    faults: Sequence[Mapping[str, Any]]

    def profile(self, folder: Path) -> Profile:
        """Its profile, written into a folder."""
        path = folder / f"{self.experiment}.toml"
        path.write_text(self.toml())
        return load_profile(path)

    def toml(self, comment: str = "") -> str:
        """The text of its profile."""
        grid = {key: [self.trials[0][key]] for key in known(self.experiment).grid}
        scene = SCENES[self.experiment]
        rows = ", ".join(
            toml_value({key: value for key, value in row.items() if key not in grid}) for row in self.trials
        )
        return "\n".join(
            [
                f"# {comment or f'seed {self.seed} of the swarm'}",
                f'extends = "mock/{scene.extends or self.experiment}"',
                *([f'experiment = "{scene.behavior}"'] if scene.behavior else []),
                *(
                    f"{section} = {toml_value(table)}"
                    for section, table in nest(self.settings.items()).items()
                ),
                f'trials = {{ order = "listed", repeats = 1, list = [{rows}], grid = {toml_value(grid)} }}',
                f"faults = {toml_value([*self.faults])}",
                "",
            ]
        )


class Known(NamedTuple):
    """What is drawn from, of an experiment.

    Attributes:
        rows: Factors of the profile's trials.
        grid: Those of them that are crossed.
        states: In which a fault may begin.
        faults: What can go wrong: device and kind.
        used: Devices that a trial opens, by its factors.
        had: See `config.swarm.cells.had`.
    """

    profile: Profile
    rows: Sequence[Mapping[str, Any]]
    grid: Sequence[str]
    states: Sequence[str]
    faults: Sequence[tuple[str, str]]
    used: Mapping[tuple[Any, ...], frozenset[str]]
    had: Mapping[tuple[str, str], frozenset[str]]


@cache
def known(experiment: str) -> Known:
    """What is drawn from, of an experiment."""
    scene = SCENES[experiment]
    own = {"experiment": scene.behavior} if scene.behavior else {}
    profile = load_profile(f"mock/{scene.extends or experiment}", own)
    trials = profile.trials(0)
    needs = [(trial, needed.devices) for _, trial, needed in used_by(profile, trials)]
    used = {tuple(trial.factors.items()): devices & profile.devices.keys() for trial, devices in needs}
    devices = sorted(frozenset[str]().union(*used.values()))
    faults = [
        (name, kind) for name in devices for kind in row("driver", profile.devices[name].kind).faults("mock")
    ]
    faults += [(name, kind) for name, kinds in OF_THE_BENCH.items() for kind in kinds]
    grid = list(dict(flatten(profile.source.data.get("trials", {}).get("grid", {}))))
    states = found(experiment_of(profile.experiment).made).states
    different = {(devices, *_words(trial.factors)): trial for trial, devices in needs}
    planned = plan_campaign(profile, list(different.values())[:PLANS], 0).trials
    return Known(
        profile,
        [dict(trial.factors) for trial in trials],
        grid,
        [str(state) for state in states],
        faults,
        used,
        had(list(planned)),
    )


def _words(factors: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield from ((key, value) for key, value in factors.items() if isinstance(value, str))


@cache
def possible() -> tuple[Cell, ...]:
    """The cells of the coverage that can be: what a kind of fault needs is there in that state, by `NEEDS`, in a trial
    that enters it."""
    return tuple(
        (name, state, device, kind)
        for name in SCENES
        for state in known(name).states
        if state not in ("DONE", "FAILED") and (name, state) not in NOT_ENTERED
        for device, kind in known(name).faults
        if kind not in NEEDS or known(name).had.get((state, device), frozenset()) & {*NEEDS[kind]}
        if _entering(name, state, device)
    )


def _entering(experiment: str, state: str, device: str) -> Sequence[Mapping[str, Any]]:
    """Trials that come into a state and have a device."""
    of, way = known(experiment), SCENES[experiment].ways.get(state, Way())
    return [
        row
        for row in of.rows
        if all(row.get(key) in values for key, values in way.rows.items())
        and device in {*BENCH_WIDE, *of.used[tuple(row.items())]}
    ]


def drawn(seed: int, experiments: Sequence[str] = ()) -> Plan:
    """What a seed draws, in a fixed order, whatever was played before it.

    Every second seed is led to a cell of the coverage, each to another one until all had their turn. Of these every
    second one goes where something moves, and nothing else goes wrong before; in the others comes before it what is
    over so soon that the trial goes on, in the same experiment's other states.

    Args:
        experiments: That alone are drawn; none are all.
    """
    dice = random.Random(f"swarm {seed}")
    scenes = {name: scene for name, scene in SCENES.items() if not experiments or name in experiments}
    experiment = dice.choices(list(scenes), [scene.weight for scene in scenes.values()])[0]
    cell = None
    if seed % 2:
        moves = seed % 4 == 3
        cells = [
            each
            for each in possible()
            if each[0] in scenes and (each[1] in MOVING or not moves)
            if moves or not _passed(each)
        ]
        cell = cells[seed // 4 * STRIDE % len(cells)]
        experiment = cell[0]
    scene, of = SCENES[experiment], known(experiment)
    count = dice.choice([1, 1, 1, 2, 2, TRIALS_MAX]) if scene.weight > 1 and cell is None else 1
    way = Way() if cell is None else scene.ways.get(cell[1], Way())
    first = dice.choice(of.rows if cell is None else _entering(*cell[:3]))
    rows = [first, *(dice.choice(of.rows) for _ in range(count - 1))]
    rows = [{**row, **{key: first[key] for key in of.grid}} for row in rows]
    settings = {**_settings(dice, scene, of), **way.settings}
    there = frozenset(BENCH_WIDE).union(*(of.used.get(tuple(row.items()), ()) for row in rows))
    could = [(device, kind) for device, kind in of.faults if device in there]
    if cell is not None:
        _, state, device, kind = cell
        if kind == "overrun" and dice.random() < 0.5:
            settings["limits.follow_m"] = "none"
        faults = [_fault(dice, device, kind, state, count)]
        if not moves or dice.random() < 0.7:
            faults[0] = {"device": device, "kind": kind, "after": state, **_amount(dice, kind), **_ends(kind)}
        if not moves:
            before = [*way.faults, *_brief(dice, cell, first, EVENTS_MAX - 1 - len(way.faults))]
            return Plan(seed, experiment, settings, rows, [*before, *faults])
        if dice.random() < 0.5:
            faults.append(_fault(dice, *dice.choice(could), state, count))
            faults[1]["after"] = state
        return Plan(seed, experiment, settings, rows, [*way.faults, *faults])
    kinds = sorted({kind for _, kind in could})
    rates = {
        kind: math.exp(dice.uniform(math.log(0.05), math.log(2.0))) for kind in kinds if dice.random() < 0.5
    }
    faults = []
    for kind, rate in rates.items():
        for _ in range(_poisson(dice, rate * count)):
            device = dice.choice([device for device, each in could if each == kind])
            faults.append(_fault(dice, device, kind, dice.choice(of.states[:-2] or of.states), count))
    return Plan(seed, experiment, settings, rows, faults[:EVENTS_MAX])


def _settings(dice: random.Random, scene: Excerpt, of: Known) -> dict[str, Any]:
    settings = dict(scene.short)
    for key, (least, most) in scene.drawn.items():
        if dice.random() < 0.5:
            settings[key] = _rounded(math.exp(dice.uniform(math.log(least), math.log(most))))
    if "limits.force_n" in settings and dice.random() < 0.5:  # a push that is not much harder is sent back
        settings["limits.retreat_n"] = _rounded(settings["limits.force_n"] * dice.uniform(1.1, 2.0))
    if dice.random() < 0.3 and "board" in of.profile.devices and not scene.behavior:
        settings["devices.board.block_samples"] = dice.choice([16, 64, 501])
    if dice.random() < 0.3:  # redundant positions would hide that the others are not watched
        settings["limits.follow_m"] = "none"
    return settings


def _passed(cell: Cell) -> bool:
    """Whether a trial that is led elsewhere has it on its way: a brief fault, in a state that any trial enters, and not
    its first one, which may be over at once."""
    name, state, _, kind = cell
    way = SCENES[name].ways.get(state, Way())
    return kind in BRIEF and not (way.settings or way.faults) and state != known(name).states[0]


BRIEF: Mapping[str, Settings] = {
    **{kind: {} for kind in ("lose", "corrupt", "double", "stuck")},
    "late": {"amount": 0.005},
    "hang": {"amount": 0.004},
    "slow": {"amount": 1e-4},
    "overrun": {"amount": 1e-4},
}
"""Kinds of faults that a trial may outlast, and how much of them."""

BRIEF_S = 0.03
"""How long these last: a turn of the slowest loop here, and half of what a stream may be silent."""

SLOW_S = 0.5
"""How long a disk is slow that would be for good: it costs single turns, and shows nothing more by staying so."""


def _ends(kind: str) -> dict[str, float]:
    return {"for_s": SLOW_S} if kind == "slow" else {}


def _brief(dice: random.Random, cell: Cell, row: Mapping[str, Any], most: int) -> list[dict[str, Any]]:
    """Faults that are soon over, each of another device or in another state, before that of a cell."""
    name, end, *_ = cell
    of, ways = known(name), SCENES[name].ways
    order = {state: place for place, state in enumerate(of.states)}
    there = {*BENCH_WIDE, *of.used[tuple(row.items())]}
    entered = [
        state
        for state in of.states[: order[end]]
        if all(row.get(key) in values for key, values in ways.get(state, Way()).rows.items())
        if not (ways.get(state, Way()).settings or ways.get(state, Way()).faults)
    ]
    cells = [each for each in possible() if each[0] == name and each[3] in BRIEF]
    cells = [each for each in cells if each[1] in entered and each[2] in there]
    dice.shuffle(cells)
    drawn_cells = list({(state, device): kind for _, state, device, kind in cells}.items())[:most]
    return [
        {"device": device, "kind": kind, "after": state, "for_s": BRIEF_S, **BRIEF[kind]}
        for (state, device), kind in drawn_cells
    ]


def _fault(dice: random.Random, device: str, kind: str, state: str, count: int) -> dict[str, Any]:
    fault: dict[str, Any] = {"device": device, "kind": kind}
    when = dice.random()
    if when < 0.7:
        fault["after"] = state
        fault["at_s"] = _rounded(dice.choice([0.0, dice.uniform(0.0, 0.2), dice.uniform(0.0, 3.0)]))
    elif when < 0.85:
        fault["at_s"] = _rounded(dice.uniform(0.0, 10.0))
    else:
        fault["after"] = f"write {dice.randint(1, 12)}" if device not in BENCH_WIDE else state
        fault["at_s"] = _rounded(dice.uniform(0.0, 0.05))
    lasts = dice.random()
    length_s = _rounded(math.exp(dice.uniform(math.log(SHORTEST_S), math.log(LONGEST_S))))
    if lasts < 0.6:
        fault["for_s"] = length_s
    elif lasts < 0.75:
        fault |= {
            "for_s": length_s,
            "every_s": _rounded(length_s * dice.uniform(1.5, 10.0)),
            "times": dice.randint(2, 9),
        }
    else:
        fault |= _ends(kind)
    fault |= _amount(dice, kind)
    if count > 1 and dice.random() < 0.5:
        fault["trial"] = dice.randint(1, count)
    return fault


AMOUNTS: Mapping[str, Sequence[float]] = {
    "wrong": (-1.0, 0.0, 0.5, 2.0, 100.0),
    "late": (0.005, 0.03, 0.12, 0.5),
    "hang": (0.004, 0.05, 0.3, 2.0),
    "slow": (1e-4, 2e-3),
    "overrun": (1e-4, 2e-3, 0.02),
    "drift": (-10.0, -0.1, -1e-3, 1e-4, 0.01, 1.0),
}
"""What is drawn of how much."""


def _amount(dice: random.Random, kind: str) -> dict[str, float]:
    return {"amount": dice.choice(AMOUNTS[kind])} if kind in AMOUNTS else {}


def _poisson(dice: random.Random, mean: float) -> int:
    count, left = 0, math.exp(-mean)
    product = dice.random()
    while product > left:
        count, product = count + 1, product * dice.random()
    return count


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
