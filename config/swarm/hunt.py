"""Seeds played one after the other: what does not hold, made small; and which cells were seen."""

from __future__ import annotations

import os
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from config.profile import load_profile
from config.source import flatten
from config.swarm import checkers
from config.swarm.cells import Cell
from config.swarm.checkers import Violation
from config.swarm.plan import SCENES, Plan, drawn, known, possible
from config.swarm.play import Story, memory, play
from drivers.core.clock import monotonic_s
from simulator.devices.faults import Fault

SHRINKING_RUNS = 200
"""Most runs that make a failing plan smaller."""

DEEP = ("twice", "resumed", "idle", "split", "killed", "", "", "", "", "")
"""Checks of two stories: every second seed of a quick experiment has one, the checks in turn."""

DEAR = 4
"""How many times seldomer those have one that take long: what is compared is of loop, campaign and recorder, which are
the same in all."""

KILLED_BEFORE = 60
"""Turn before which a program is killed: a short trial has some forty of its own."""

OFTEN = 100
"""Seeds between two looks at the memory: in the first of them everything is loaded."""

TOLD = ("lose", "corrupt")
"""Faults of which each block that is lost is told by itself: as many events as blocks."""

SHOWN_NOTHING = 3
"""How often a fault must have been on for the whole of a state, and shown nothing, until that cell cannot be."""


SLOW = {"device": "disk", "kind": "slow", "amount": 0.002, "for_s": 1.0, "every_s": 5.0}
"""A disk that takes its time now and then. Turns are not taken as one meanwhile: no byte may depend on that either."""


@dataclass
class Hunt:
    """What a hunt has seen.

    Attributes:
        seen: Cells in which a fault took effect, and how often.
        memory_mb: Of this process, resident, after each `OFTEN` seeds.
        met: Cells whose fault was on from the entry of the state for good, and how often.
        findings: By seed.
    """

    seeds: int = 0
    seen: Counter[Cell] = field(default_factory=Counter)
    memory_mb: list[float] = field(default_factory=list)
    met: Counter[Cell] = field(default_factory=Counter)
    findings: dict[int, Sequence[Violation]] = field(default_factory=dict)
    outcomes: Counter[str] = field(default_factory=Counter)

    def summary(self) -> str:
        """One line: how many seeds, cells and findings."""
        ends = Counter(findings[0].end for findings in self.findings.values())
        failed = ", ".join(f"{count} {end}" for end, count in sorted(ends.items())) or "nothing failed"
        seen, never = len(set(self.seen) & set(possible())), len(self.never)
        of, memory = len(possible()) - never, ""
        if len(self.memory_mb) > 1:
            memory = f"; memory {self.memory_mb[0]:.0f} MB after {OFTEN} seeds, {self.memory_mb[-1]:.0f} at the end"
        return (
            f"{self.seeds} seeds: {failed}; {seen} of {of} cells seen with effect, {never} cannot be{memory}"
        )

    @property
    def never(self) -> set[Cell]:
        """Cells that cannot be: the device sends nothing in that state, nothing is asked of it that it could refuse, or
        the state takes no time."""
        return {cell for cell, times in self.met.items() if times >= SHOWN_NOTHING and cell not in self.seen}

    def page(self) -> str:
        """The table of cells: of each experiment and device, in how many of the states that can be each kind of fault
        was seen."""
        lines = [
            "| experiment | device | faults: states in which they were seen, of those that can be |",
            "| --- | --- | --- |",
        ]
        never, groups = self.never, dict[tuple[str, str], dict[str, list[Cell]]]()
        for cell in possible():
            if cell not in never:
                groups.setdefault((cell[0], cell[2]), {}).setdefault(cell[3], []).append(cell)
        for (name, device), kinds in groups.items():
            shares = (
                f"{kind} {sum(each in self.seen for each in cells)}/{len(cells)}"
                for kind, cells in kinds.items()
            )
            lines.append(f"| {name} | {device} | {', '.join(shares)} |")
        head = ["# Cells of the swarm", "", f"`make swarm`, on mock benches: {self.summary()}.", ""]
        return "\n".join([*head, *lines, ""])

    def note(self, story: Story) -> None:
        """Count the cells of a story."""
        trials, name = {trial.number: trial for trial in story.trials}, story.plan.experiment
        for effect in story.effects:
            if (trial := trials.get(effect["trial"])) is not None:
                # what it took effect in, not what followed from it in the same turn
                entered_s, after = dict(trial.states), str(effect.get("after"))
                at_entry = abs(entered_s.get(after, -1.0) - effect["effect_s"]) < 1e-6
                state = after if at_entry else checkers.state_at(trial, effect["effect_s"] - 1e-6)
                self.seen[name, state, effect["device"], effect["kind"]] += 1
        for fault in story.plan.faults:
            if not fault.keys() & {"at_s", "for_s"}:
                for trial in story.trials:
                    if (
                        fault["after"] in dict(trial.states)
                        and fault.get("trial", trial.number) == trial.number
                    ):
                        self.met[name, fault["after"], fault["device"], fault["kind"]] += 1
        self.outcomes.update(row["outcome"] for row in story.rows)


def examined(plan: Plan, deep: str = "", hunt: Hunt | None = None) -> Sequence[Violation]:
    """What does not hold of a plan.

    Args:
        deep: Which check of two stories is made besides.
        hunt: Gets what was seen.
    """
    with memory() as folder:
        story = play(plan, folder, kill_at=1 + plan.seed % KILLED_BEFORE if deep == "killed" else None)
        if hunt is not None:
            hunt.note(story)
        findings = list(checkers.check(story))
        if story.error is None and not findings:
            findings += _deep(plan, story, deep, folder)
    return findings


def _deep(plan: Plan, story: Story, deep: str, folder: Path) -> Iterator[Violation]:
    """Another story beside the first, equal in what must be equal."""
    healthy = replace(plan, faults=())
    if deep == "twice":
        yield from checkers.same(story, play(plan, folder), "the same plan twice")
    elif deep == "resumed" and story.exit_code not in (0, 1):
        going_on = play(healthy, folder, resumed=story.folder)
        yield from checkers.healed(story, going_on, play(healthy, folder))
    elif deep == "killed" and story.killed is not None:
        going_on = play(healthy, folder, resumed=story.killed)
        yield from checkers.healed(story, going_on, play(healthy, folder))
    elif deep == "idle":
        device, kind = (plan.faults[0]["device"], "late") if plan.faults else ("loop", "hang")
        kind = {"loop": "hang", "keys": "pause", "disk": "full"}.get(device, kind)
        idle = {"device": device, "kind": kind, "at_s": 1e6}
        same = play(replace(plan, faults=[*plan.faults, idle, SLOW]), folder)
        yield from checkers.same(story, same, "a fault after the end, and a slow disk")
    elif deep == "split" and "board" in known(plan.experiment).profile.devices:
        told = any(fault["kind"] in TOLD for fault in plan.faults)
        one = healthy if told else plan
        other = replace(one, settings={**plan.settings, "devices.board.block_samples": 3})
        first = play(one, folder) if told else story
        yield from checkers.same(first, play(other, folder), "other block splits")


def shrunk(plan: Plan, deep: str, end: str) -> tuple[Plan, int]:
    """The plan made small, as long as it ends in the same class; and how many runs that took."""
    runs = 0

    def fails(other: Plan) -> bool:
        nonlocal runs
        runs += 1
        return any(finding.end == end for finding in examined(other, deep))

    going = True
    while going and runs < SHRINKING_RUNS:
        going = False
        for other in _smaller(plan):
            if runs >= SHRINKING_RUNS:
                break
            if fails(other):
                plan, going = other, True
                break
    return plan, runs


def _smaller(plan: Plan) -> Iterator[Plan]:
    """Plans with less in them: fewer trials, fewer faults, defaults, plainer and shorter faults."""
    for place in range(len(plan.trials)):
        if len(plan.trials) > 1:
            yield replace(plan, trials=[*plan.trials[:place], *plan.trials[place + 1 :]])
    for place in range(len(plan.faults)):
        yield replace(plan, faults=[*plan.faults[:place], *plan.faults[place + 1 :]])
    short = SCENES[plan.experiment].short
    for key in plan.settings:
        if key not in short:
            yield replace(
                plan, settings={each: value for each, value in plan.settings.items() if each != key}
            )
    for place, fault in enumerate(plan.faults):
        for key in ("every_s", "trial", "at_s", "for_s"):
            if key in fault and fault[key] != 0.0:
                less = {each: value for each, value in fault.items() if each != key}
                if key == "every_s":
                    less.pop("times", None)
                if key == "for_s" and "every_s" in less:
                    continue
                yield replace(plan, faults=[*plan.faults[:place], less, *plan.faults[place + 1 :]])


def hunted(
    seeds: Sequence[int], hunt: Hunt, experiments: Sequence[str] = (), minutes: float | None = None
) -> Iterator[tuple[int, Plan, str, Sequence[Violation]]]:
    """Play seeds; yields those of which something does not hold.

    Args:
        experiments: That are played alone; none are all.
        minutes: After which no other seed begins.
    """
    since_s = monotonic_s()
    for seed in seeds:
        if minutes is not None and monotonic_s() - since_s > 60.0 * minutes:
            return
        plan = drawn(seed, experiments)
        deep = deep_of(plan)
        findings = examined(plan, deep, hunt)
        hunt.seeds += 1
        if hunt.seeds % OFTEN == 0:
            hunt.memory_mb.append(_resident_mb())
        if findings:
            hunt.findings[seed] = findings
            yield seed, plan, deep, findings


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def deep_of(plan: Plan) -> str:
    """Which check of two stories a plan has: over the seeds, each kind of plan (`drawn`) has all of them."""
    turn = plan.seed // 4 + 3 * (plan.seed % 4)
    if SCENES[plan.experiment].weight == 1 and turn // len(DEEP) % DEAR:
        return ""
    return DEEP[turn % len(DEEP)]


def replayed(path: Path, compared: bool = True) -> Sequence[Violation]:
    """What does not hold of a plan in a file, as the corpus keeps it.

    Args:
        compared: Whether all checks of two stories are made, too.
    """
    from config.swarm.play import played

    profile = load_profile(path)
    seen: list[Violation] = []
    drawn_there = dict(flatten(tomllib.loads(path.read_text(encoding="utf-8"))))
    plan = Plan(0, profile.experiment, drawn_there, [], [])
    with memory() as folder:
        story = played(plan, profile, folder)
        seen += checkers.check(story)
        if compared and story.error is None:
            slow = replace(profile, faults=(*profile.faults, Fault.model_validate(SLOW)))
            seen += checkers.same(story, played(plan, slow, folder), "the same plan on a slow disk")
            if "board" in profile.devices and not any(each.kind in TOLD for each in profile.faults):
                cut = load_profile(path, {"devices.board.block_samples": "3"})
                seen += checkers.same(story, played(plan, cut, folder), "other block splits")
            if story.exit_code not in (0, 1):
                healthy = replace(profile, faults=())
                going_on = played(plan, healthy, folder, resumed=story.folder)
                seen += checkers.healed(story, going_on, played(plan, healthy, folder))
    return seen
