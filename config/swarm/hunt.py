"""Seeds played one after the other: what does not hold, made small; and which cells were seen."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from config.profile import Profile, load_profile
from config.source import flatten
from config.swarm import checkers
from config.swarm.cells import Cell
from config.swarm.checkers import Violation
from config.swarm.plan import SCENES, Plan, drawn, possible
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
        met: Cells whose fault was on from the entry of the state for good, and how often.
        findings: By seed.
    """

    seeds: int = 0
    seen: Counter[Cell] = field(default_factory=Counter)
    met: Counter[Cell] = field(default_factory=Counter)
    findings: dict[int, Sequence[Violation]] = field(default_factory=dict)

    def summary(self) -> str:
        """One line: how many seeds, cells and findings."""
        ends = Counter(findings[0].end for findings in self.findings.values())
        failed = ", ".join(f"{count} {end}" for end, count in sorted(ends.items())) or "nothing failed"
        seen, never = len(set(self.seen) & set(possible())), len(self.never)
        of = len(possible()) - never
        return f"{self.seeds} seeds: {failed}; {seen} of {of} cells seen with effect, {never} cannot be"

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


def examined(plan: Plan, deep: str = "", hunt: Hunt | None = None) -> Sequence[Violation]:
    """What does not hold of a plan.

    Args:
        deep: Which check of two stories is made besides.
        hunt: Gets what was seen.
    """
    with memory() as folder:
        return _examined(plan, plan.profile(folder), folder, [deep], hunt)


def replayed(path: Path, compared: bool = True) -> Sequence[Violation]:
    """What does not hold of a plan in a file, as the corpus keeps it.

    Args:
        compared: Whether all checks of two stories but of a kill are made, too.
    """
    profile, drawn_there = load_profile(path), flatten(tomllib.loads(path.read_text(encoding="utf-8")))
    with memory() as folder:
        plan = Plan(0, profile.experiment, dict(drawn_there), [], [])
        return _examined(plan, profile, folder, ["idle", "split", "resumed"] if compared else [])


def _examined(
    plan: Plan, profile: Profile, folder: Path, deep: Sequence[str], hunt: Hunt | None = None
) -> Sequence[Violation]:
    kill_at = 1 + plan.seed % KILLED_BEFORE if "killed" in deep else None
    story = play(plan, folder, profile, kill_at=kill_at)
    if hunt is not None:
        hunt.note(story)
    findings = list(checkers.check(story))
    for each in deep if story.error is None and not findings else ():
        findings += _deep(story, profile, each, folder)
    return findings


def _deep(story: Story, profile: Profile, deep: str, folder: Path) -> Iterator[Violation]:
    """Another story beside the first, equal in what must be equal."""
    again, healthy = partial(play, story.plan, folder), replace(profile, faults=())
    broken = {"resumed": story.folder if story.exit_code not in (0, 1) else None, "killed": story.killed}
    if deep == "twice":
        yield from checkers.same(story, again(profile), "the same plan twice")
    elif broken_off := broken.get(deep):
        yield from checkers.healed(story, again(healthy, broken_off), again(healthy))
    elif deep == "idle":
        device = profile.faults[0].device if profile.faults else "loop"
        kind = {"loop": "hang", "keys": "pause", "disk": "full"}.get(device, "late")
        idle = {"device": device, "kind": kind, "at_s": 1e6}
        more = [Fault.model_validate(each) for each in (idle, SLOW)]
        slow = replace(profile, faults=(*profile.faults, *more))
        yield from checkers.same(story, again(slow), "a fault after the end, and a slow disk")
    elif deep == "split" and (board := profile.devices.get("board")):
        told = any(fault.kind in TOLD for fault in profile.faults)
        one = healthy if told else profile
        cut = board.settings.model_copy(update={"block_samples": 3})
        split = replace(one, devices={**one.devices, "board": replace(board, settings=cut)})
        yield from checkers.same(again(one) if told else story, again(split), "other block splits")


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
        if findings:
            hunt.findings[seed] = findings
            yield seed, plan, deep, findings


def deep_of(plan: Plan) -> str:
    """Which check of two stories a plan has: over the seeds, each kind of plan (`drawn`) has all of them."""
    turn = plan.seed // 4 + 3 * (plan.seed % 4)
    if SCENES[plan.experiment].weight == 1 and turn // len(DEEP) % DEAR:
        return ""
    return DEEP[turn % len(DEEP)]
