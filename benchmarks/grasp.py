"""A grasp with little more than the least force (D1): ours, fixed grips, steps, the paper's slip rule, an oracle.

`python -m benchmarks grasp`. The mock bench's own jaws, object and pad, the program's own detectors, behavior and
measure in a closed loop, without drivers, sound and recorder: from the rest over the object, in the middle, to the end
of the hold. Contact is told 30 ms after both fingers touch. Objects of one seed set margin, boost and the friction's
interval, objects of another judge. Finished parts are kept, so that an interrupted study goes on.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from behaviors.events import Contact, Event, Tick
from behaviors.grasp import Grasp, GraspSettings
from behaviors.search import SearchFactors
from benchmarks.results import kept, progress, save
from config.profile import load_profile
from controller.detectors.load import LoadDetector, LoadSettings
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.measures import grasp as measures
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from controller.reports.counts import wilson
from controller.signals.strain import Strain, StrainSettings
from drivers.can_gripper.units import POSITION_COUNTS, GripperUnits, speed_ticks_s
from drivers.core.messages import (
    Grip,
    MovePose,
    Reached,
    SampleBlock,
    Standstill,
    Stop,
    Twist,
)
from drivers.gripper.outcome import GripperOutcome
from simulator.mocks.can_gripper import _runs as runs_of
from simulator.physics.bench import Bench
from simulator.physics.gripper_part import GripperPart
from simulator.physics.held_kernel import GRAVITY_M_S2, TURN_M
from simulator.physics.pad_part import GraspBenchSettings, PadPart
from simulator.physics.tool_motion import ToolMotion

SEED_CHOOSE, SEED_JUDGE, SEED_VARY = 61_000, 62_000, 63_000

LEAST_N, MOST_N = 7.0, 36.0
"""Least force at rest of the objects that are drawn: what the gripper can be asked for, half of the weight more too."""

TURN_S, CAN_S = 0.005, 0.001
"""Turn of the loop, and what an order takes to the drive (docs/reference/can_gripper.md: a frame at 1 Mbit/s, a turn of
its loop)."""

SLOW_TURNS = 4
"""Turns at once where nothing is sensed."""

FELT_S, OBJECT_S, ARRIVED_S, POLL_HZ = 0.03, 0.03, 0.01, 100.0
"""Contact is told, something must hold the jaws, an arrival is told so much later; how often the drive is polled."""

BEGIN_S, ABOVE = 13.0, (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)
"""When the rest over the object begins; where the jaws are calibrated."""

DETECTORS = frozenset(
    {"left_ours", "right_ours", "left_contact", "right_contact", "slip_ours", "slip_paper", "load"}
)


class Thing(NamedTuple):
    """An object that is drawn."""

    number: int
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


def drawn(seed: int, count: int) -> list[Thing]:
    """Random objects: masses log-uniform in 0.02 to 1 kg, friction in 0.15 to 0.9, every other one gripped up to 2 mm
    off its centre; those that the gripper cannot hold with little force are drawn anew."""
    random, found = np.random.default_rng(seed), list[Thing]()
    while len(found) < count:
        mass_kg, friction = 10 ** random.uniform(math.log10(0.02), 0.0), random.uniform(0.15, 0.9)
        lever_m = random.uniform(0.0, 0.002) if random.random() < 0.5 else 0.0
        width_m, stiffness_n_m = random.uniform(0.018, 0.055), 10 ** random.uniform(4.0, 5.0)
        roughness, crush = random.uniform(0.02, 0.1), random.uniform(1.3, 5.0)
        thing = Thing(len(found), mass_kg, friction, lever_m, width_m, stiffness_n_m, roughness, 0.0)
        if LEAST_N <= thing.least_n <= MOST_N:
            # of the least that holds it through all, half of its weight more included
            found.append(thing._replace(crush_n=crush * 1.5 * thing.least_n))
    return found


PROFILE = load_profile("mock/grasp", {})
assert PROFILE.plant is not None
PLANT = PROFILE.plant.settings.model_dump()


def grasped(seed: int, thing: Thing, rule: Mapping[str, Any], plant: Mapping[str, Any]) -> Mapping[str, Any]:
    """One grasp: outcome and columns of its measure.

    Args:
        rule: Settings of the behavior that differ from the profile's; `grip_over_least` is a fixed grip by the truth.
        plant: Factors of settings of the plant.
    """
    rule = dict(rule)
    if over := rule.pop("grip_over_least", None):
        rule["grip_force_n"] = min(max(over * thing.least_n, LEAST_N), 60.0)
    usual = PROFILE.behavior.model_dump()
    settings = GraspSettings.model_validate(usual | {"center": False} | rule)
    own = {"object_kg": thing.mass_kg, "pad_friction": thing.friction, "lever_m": thing.lever_m}
    own |= {"object_width_m": thing.width_m, "object_n_m": thing.stiffness_n_m, "crush_n": thing.crush_n}
    own |= {"pad_roughness": thing.roughness}
    about = PLANT | own
    about |= {name: factor * about[name] for name, factor in plant.items()}
    return GraspScene(GraspBenchSettings.model_validate(about), (seed, thing.number), settings).run()


class GraspScene:
    """A closed loop around one object."""

    def __init__(self, plant: GraspBenchSettings, key: tuple[int, int], settings: GraspSettings) -> None:
        self.bench = Bench(plant, "gripper")
        self.gripper = GripperPart(self.bench, plant)
        self.senses = bool(settings.slip or settings.load)
        # a fixed grip needs neither a sensor nor quick turns
        self.pad = PadPart(self.bench, self.gripper, plant) if self.senses else None
        self.turns = 1 if self.senses else SLOW_TURNS
        self.arm = ToolMotion((1.0, 0.0, 0.0), acceleration_m_s2=0.5, max_speed_m_s=0.06)
        self.bench.mount(self.arm)
        self.bench.restart()
        self.bench.begin(0.0, *key, {}, plant.model_dump(mode="json"))
        self.jaws, self.units = self.bench.jaws, GripperUnits(plant.closed_width_m)
        self.jaws.poll_at(POLL_HZ)
        # calibrated and opened above the object, as COMING_IN does it
        self.arm.move_pose(0.0, ABOVE, 0.06)
        self.jaws.advance(3.0)
        self.jaws.calibrate()
        self.jaws.advance(7.0)
        self.jaws.go(0.0, 40_000.0, 300.0)
        self.arm.move_pose(8.0, (0.0,) * 6, 0.06)
        self.jaws.advance(BEGIN_S)
        self.jaws.take()
        self.settings = settings
        self.behavior = Grasp(settings, SearchFactors(), DETECTORS)
        detectors = PROFILE.detectors
        slips: list[SlipDetector | SlipPaperDetector] = [
            SlipDetector("slip_ours", _of(SlipSettings, detectors["slip_ours"].settings)),
            SlipPaperDetector("slip_paper", _of(SlipPaperSettings, detectors["slip_paper"].settings)),
        ]
        self.slips = [slip for slip in slips if slip.name in settings.slip]
        self.load = LoadDetector("load", _of(LoadSettings, detectors["load"].settings))
        self.strain = Strain("pad", _of(StrainSettings, PROFILE.signals["pad"].settings))
        self.events: list[Event] = []
        self.entered_s: dict[str, float] = {}
        self._orders: list[tuple[float, Grip]] = []
        self._outcome = GripperOutcome("gripper", self.units, OBJECT_S)
        self._arrives_s = math.inf
        self._felt_s: float | None = None

    def run(self) -> Mapping[str, Any]:
        """To the end of the hold."""
        turn, behavior = round(BEGIN_S / TURN_S), self.behavior
        behavior.begin(BEGIN_S)
        ways = self._here(BEGIN_S), _jaws(BEGIN_S), _jaws(BEGIN_S), self._here(BEGIN_S)
        for way in ways:
            behavior.handle(way)
        behavior.handle(Tick(BEGIN_S + self.settings.baseline_s))
        behavior._entered_s = BEGIN_S
        assert behavior.state == "RESTING", behavior.state
        last = round(BEGIN_S * 1000.0)
        while behavior.state not in ("LOWERING", "RELEASING", "LEAVING", "FAILED", "DONE") and turn < 12_000:
            turn += self.turns
            t_s = turn * TURN_S
            while self._orders and self._orders[0][0] <= t_s:
                due_s, command = self._orders.pop(0)
                self.jaws.advance(due_s)
                order = self.units.grip(command)
                self.jaws.go(order.position / POSITION_COUNTS, speed_ticks_s(order.speed), order.current_ma)
            self.bench.advance(t_s, frozenset({"pad"}))
            ticks = np.arange(last + 1, round(t_s * 1000.0) + 1)
            last = int(ticks[-1])
            events = [*(self._sensed(ticks) if self.senses else ()), *self._statuses(t_s)]
            for event in sorted(events, key=lambda event: event.t_s):
                self._handle(event, t_s)
            if t_s >= behavior.wake_s - 1e-9:
                self._handle(Tick(t_s), t_s)
        return self._measured()

    def _here(self, t_s: float) -> Reached:
        return Reached(t_s, "arm", 0.0)

    def _sensed(self, ticks: Any) -> list[Event]:
        volts = self.bench.sample("pad", ticks / 1000.0)
        block = SampleBlock("board.pad", int(ticks[0]), float(ticks[0]) / 1000.0, volts, rate_hz=1000.0)
        forces = next(made for made in self.strain.push(block) if isinstance(made, SampleBlock))
        found = [event for slip in self.slips for event in slip.push(block)]
        return [*found, *(self.load.push(forces) if self.settings.load else ())]

    def _statuses(self, t_s: float) -> list[Event]:
        events: list[Event] = []
        if t_s >= self._arrives_s:
            self._arrives_s = math.inf
            events.append(self._here(t_s))
        number, states = self.jaws.take()
        for count, state in runs_of(states) if len(states) else ():
            for each in range(number, number + count):
                events += self._outcome.push(each / POLL_HZ, state, fault=False)
            number += count
        if self._felt_s is None and all(self.gripper.finger_contacts):
            self._felt_s = t_s + FELT_S
        if self._felt_s is not None and t_s >= self._felt_s:
            self._felt_s = math.inf
            events += [Contact(t_s, f"{finger}_contact", 1.0, 0.0) for finger in ("left", "right")]
        return events

    def _handle(self, event: Event, t_s: float) -> None:
        before = self.behavior.state
        commands = self.behavior.handle(event)
        self.events.append(event)
        if self.behavior.state != before:
            self.entered_s[self.behavior.state] = event.t_s
        for command in commands:
            match command:
                case Grip():
                    self._orders.append((t_s + CAN_S, command))
                    self._outcome.begin(command, t_s, drives=True)
                case MovePose(offset=offset, speed_m_s=speed_m_s):
                    self.arm.move_pose(t_s, offset, speed_m_s)
                    self._arrives_s = self.arm.arrival_s + ARRIVED_S
                case Twist(twist=twist, duration_s=duration_s):
                    self.arm.twist(t_s, twist, duration_s)
                case Stop(device="arm"):
                    self.arm.stop(t_s, 3.0)
                    self.behavior.handle(Standstill(t_s, "arm", 0.0))

    def _measured(self) -> Mapping[str, Any]:
        entered_s = {"LOADING": math.inf, "LOWERING": self.bench.t_s} | self.entered_s
        evidence = TrialEvidence({}, TrialRecording(0), entered_s=entered_s, notes=self.behavior.notes)
        evidence.slips = self.pad.slips if self.pad else ()
        evidence.lifts, evidence.slides = self.gripper.lifts, self.gripper.slides
        row: dict[str, Any] = dict.fromkeys(measures.COLUMNS)
        row |= measures._friction(evidence)
        begun_s, over_s = entered_s["LOADING"], entered_s["LOWERING"]
        row |= measures._true(evidence, self.behavior.notes.get("slip_s", ()), begun_s, over_s)
        row["lifted_m"] = self.settings.lift_m
        outcome = self.behavior.outcome
        if "LOADING" in self.entered_s:
            outcome = measures._judged(evidence, self.settings, outcome, row)
        return {"outcome": outcome, "bench_s": self.bench.t_s} | row


def _jaws(t_s: float) -> Reached:
    return Reached(t_s, "gripper", 0.063)


def _of(kind: type[Any], settings: Any) -> Any:
    return kind.model_validate(settings.model_dump())


RULES: Mapping[str, Mapping[str, Any]] = {
    "ours": {},
    **{
        f"fixed, {force_n} N": {"slip": (), "load": (), "grip_force_n": float(force_n)}
        for force_n in (10, 20, 40, 60)
    },
    "oracle, fixed at 1.65 of the least": {"slip": (), "load": (), "grip_over_least": 1.65},
    "paper's slip detector, steps of 2 N": {"slip": ("slip_paper",), "load": (), "rule": "step"},
    "our slip detector, steps of 2 N": {"load": (), "rule": "step"},
    "ramp while slip is told, 25 N/s": {"load": (), "rule": "step", "tighten_n": 0.5, "tighten_s": 0.02},
    "ours, no slip detector": {"slip": ()},
    "ours, no plateau": {"plateau_s": 0.0},
    "ours, no boost": {"boost": 1.0, "limit": 1.0},
    "ours, the paper's slip detector": {"slip": ("slip_paper",)},
}
"""Every rule in the same scene. The gripper presses with 60 N at the most: 80 N is out of its reach."""

MARGINS, BOOSTS = (1.1, 1.15), (1.4,)
"""What is chosen from."""

CHOSEN = 4, 24, 4, 1
"""Objects that choose, that judge ours, that judge each rival, and for each setting of the plant that is varied."""

VARIED = ("pad_noise_scale", "pad_roughness", "added")
FACTORS = (0.7, 0.9, 1.1, 1.3)


def judged(
    name: str, seed: int, things: Sequence[Thing], rule: Mapping[str, Any], plant: Mapping[str, float] = {}
) -> list[Mapping[str, Any]]:
    """Rows of the grasps of some objects."""

    def compute() -> list[Mapping[str, Any]]:
        begun_s = time.process_time()
        rows = [{**thing._asdict(), **grasped(seed, thing, rule, plant)} for thing in things]
        spent_s = time.process_time() - begun_s
        return [{**row, "spent_s": spent_s / len(rows)} for row in rows]

    found = kept(f"grasp_{name}_{len(things)}".replace(" ", "_").replace("/", "_").replace("'", ""), compute)
    progress(f"{name}: {dict(summary(found))}")
    return found


def _share(rows: Sequence[Mapping[str, Any]], hits: int) -> Mapping[str, float]:
    low, high = wilson(hits, len(rows))
    return {"count": hits, "low": low, "high": high}


def _quantiles(values: Sequence[float]) -> Mapping[str, float | None]:
    known = np.array([value for value in values if value is not None])
    if not len(known):
        return {"median": None, "p95": None}
    return {"median": float(np.median(known)), "p95": float(np.quantile(known, 0.95))}


def summary(rows: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """What a rule came to."""
    outcomes = [row["outcome"] for row in rows]
    with_friction = [row for row in rows if row["friction"] is not None and row["friction_true"] is not None]
    inside = sum(row["friction_low"] <= row["friction_true"] <= row["friction_high"] for row in with_friction)
    slid = [row["arrested_m"] for row in rows if row["arrested_m"]]
    return {
        "objects": len(rows),
        "held": _share(rows, outcomes.count("held")),
        "crushed": _share(rows, outcomes.count("crushed")),
        "dropped": _share(rows, len(rows) - outcomes.count("held") - outcomes.count("crushed")),
        "over_least": _quantiles([row["grip_over_least"] for row in rows if row["outcome"] == "held"]),
        "tightened_falsely": _share(rows, sum(bool(row["told_false"]) for row in rows)),
        "told_true": sum(row["told_true"] or 0 for row in rows),
        "told_false": sum(row["told_false"] or 0 for row in rows),
        "untold": sum(row["untold"] or 0 for row in rows),
        "slid_in_air": len(slid),
        "arrested_m": _quantiles(slid),
        "friction": _share(with_friction, inside),
        "friction_of": len(with_friction),
        "times_real": float(
            np.sum([row["bench_s"] for row in rows]) / np.sum([row["spent_s"] for row in rows])
        ),
    }


def interval_of(rows: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Ends of the friction's 90 % interval, over the estimate."""
    ratios = [
        row["friction_true"] / row["friction"] for row in rows if row["friction"] and row["friction_true"]
    ]
    low, high = np.quantile(ratios, (0.05, 0.95)).tolist()
    return float(low), float(high)


def main(*, quick: bool = False) -> None:
    """Choose, judge, vary."""
    choose, judge, rivals, vary = (max(1, count // 12) for count in CHOSEN) if quick else CHOSEN
    result: dict[str, Any] = {}
    objects = drawn(SEED_JUDGE, judge)
    result["rules"] = {}
    save("grasp", result, quick=quick)
    for name, rule in RULES.items():
        senses = {"slip", "load"} - {key for key, value in rule.items() if value == ()}
        part = objects if name == "ours" or not senses else objects[:rivals]
        result["rules"][name] = summary(judged(name, SEED_JUDGE, part, rule))
        save("grasp", result, quick=quick)
    things = drawn(SEED_CHOOSE, choose)
    chosen = {
        f"margin {margin}, boost {boost}": judged(
            f"choosing margin {margin} boost {boost}", SEED_CHOOSE, things, {"margin": margin, "boost": boost}
        )
        for margin in MARGINS
        for boost in BOOSTS
    }
    result["choosing"] = {name: summary(rows) for name, rows in chosen.items()}
    result["interval"] = {name: interval_of(rows) for name, rows in chosen.items()}
    save("grasp", result, quick=quick)
    result["varied"] = {
        f"{name} x {factor}": summary(
            judged(f"varied {name} {factor}", SEED_VARY, drawn(SEED_VARY, vary), {}, {name: factor})
        )
        for name in VARIED
        for factor in FACTORS
    }
    save("grasp", result, quick=quick)
