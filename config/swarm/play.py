"""One plan played: profile, campaign, guard, drivers and recorder on a bench in virtual time, and the truth."""

from __future__ import annotations

import csv
import json
import math
import shutil
import tempfile
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from config.assemble import build_rig, plan_campaign
from config.profile import Profile
from config.swarm.plan import Plan
from controller.by_hand import sources
from controller.campaign import Campaign, CampaignPlan, TrialPlan
from controller.console import Console
from controller.recording.joining import broken_off
from controller.recording.run_folder import RunFolder
from controller.rig import Rig, TrialScene

MEMORY = Path("/dev/shm")
"""A disk in memory, where there is one."""

TURNS_MAX = 100_000
"""Turns after which a trial never ends: ten times the longest of a plan."""

BENCH_S_MAX = 3600.0
"""Likewise in bench time, with a person who takes ten minutes."""


HALT_STEP_S, HALT_S = 0.02, 2.5
"""How often, and for how long, movers are looked at after the last turn; a bench remembers four seconds."""


class EndlessError(Exception):
    """A trial does not come to its end."""


@dataclass
class TrueTrial:
    """What really happened in a trial.

    Attributes:
        samples: At each turn: bench time; where axis and jaws are, m, and what presses, N, by name.
        states: Entered, and when.
        end_s: When its row was written.
        outcome: In that row.
        moving: Places that still changed then, m/s.
        touched_s: When the finger was touched first, bench time; infinite: never; None where there is no finger.
    """

    number: int
    samples: list[tuple[float, Mapping[str, float]]] = field(default_factory=list)
    states: list[tuple[str, float]] = field(default_factory=list)
    end_s: float = 0.0
    outcome: str = ""
    moving: Mapping[str, float] = field(default_factory=dict)
    touched_s: float | None = None


@dataclass
class Story:
    """A played plan: what the bench knows, and what was written.

    Attributes:
        limits: Of the profile, resolved.
        error: What the campaign raised, or a fault of the program itself.
        rows: Of trials.csv.
        measured: Devices of the streams that each state measures.
        raw: Its bytes, and those of events.jsonl.
        killed: A copy of the folder, as a program that is killed leaves it.
        left: Threads and file descriptors that were not there before.
    """

    plan: Plan
    folder: Path
    limits: Mapping[str, Any]
    profile: Mapping[str, Any]
    trials: list[TrueTrial]
    exit_code: int | None = None
    line: str = ""
    error: Exception | None = None
    manifest: Mapping[str, Any] = field(default_factory=dict)
    rows: Sequence[Mapping[str, str]] = ()
    measured: dict[str, set[str]] = field(default_factory=dict)
    raw: tuple[bytes, bytes] = (b"", b"")
    killed: Path | None = None
    left: Mapping[str, int] = field(default_factory=dict)

    @property
    def effects(self) -> Sequence[Mapping[str, Any]]:
        """Faults that took effect."""
        found: Sequence[Mapping[str, Any]] = self.manifest.get("plant", {}).get("faults", ())
        return found

    def events(self) -> Iterator[Mapping[str, Any]]:
        """Of events.jsonl."""
        for line in self.raw[1].splitlines():
            yield json.loads(line)


class Onlooker(Console):
    """A console without a person, that keeps what the bench knows.

    Args:
        kill_at: Number of the turn, of all trials, at which the folder is copied as a kill would leave it.
    """

    def __init__(self, kill_at: int | None = None) -> None:
        super().__init__()
        self.trials: list[TrueTrial] = []
        self.lines: list[str] = []
        self.killed: Path | None = None
        self._kill_at, self._seen = kill_at, 0
        self._turns = 0

    def attach(self, rig: Rig) -> Rig:
        """The rig, seen at each turn."""
        self._rig = rig
        self._bench: Any = next(
            (each._bench for each in rig.devices.values() if hasattr(each, "_bench")), None
        )
        parts = getattr(self._bench, "_parts", ())
        self._offers = frozenset[str]().union(*(part.offers for part in parts))  # asked for at every turn

        def pressed() -> str | None:
            self._see()
            return rig.pressed()

        def begin_trial(scene: TrialScene) -> None:
            rig.begin_trial(scene)
            self._turns = 0

        return replace(rig, pressed=pressed, begin_trial=begin_trial)

    def _see(self) -> None:
        t_s = self._rig.clock.now()
        self._turns += 1
        self._seen += 1
        if self._seen == self._kill_at:
            self.killed = self._folder.with_name("killed")
            shutil.copytree(self._folder, self.killed)
        if self._turns > TURNS_MAX or t_s > BENCH_S_MAX:
            raise EndlessError(f"turn {self._turns}, at {t_s:.1f} s")
        if self.trials:
            self.trials[-1].samples.append((t_s, self._places(t_s)))

    def _places(self, t_s: float) -> dict[str, float]:
        mover: Any = getattr(self._bench, "mover", None)
        places: dict[str, float] = {}
        if hasattr(mover, "position"):
            places["axis_m"] = mover.position(t_s)
        if "force_n" in self._offers:
            places["force_n"] = self._bench.force_n
        if "jaws" in self._offers:
            jaws = self._bench.jaws
            places |= {"width_m": jaws.width_m, "grip_n": jaws.contact_n}
        return places

    def state(self, name: str, t_s: float) -> None:
        """See `LoopOperator.state`."""
        self.trials[-1].states.append((name, t_s))

    def campaign_started(self, title: str, trials: int, folder: Path) -> None:
        """See `Console`."""
        self._folder = folder

    def trial_started(self, trial: int, factors: Mapping[str, Any]) -> None:
        """See `Console`."""
        self.trials.append(TrueTrial(trial))

    def trial_ended(self, trial: int, outcome: str, row: Mapping[str, Any]) -> None:
        """See `Console`."""
        self.trials[-1].outcome = outcome
        self._see_halt()

    def _see_halt(self) -> None:
        """After the last turn the loop waits for every mover to stand still: where they were meanwhile."""
        t_s, samples = self._rig.clock.now(), self.trials[-1].samples
        mover: Any = getattr(self._bench, "mover", None)
        since_s = samples[-1][0] if samples else 0.0
        if hasattr(mover, "position"):
            for each_s in np.arange(since_s + HALT_STEP_S, min(t_s, since_s + HALT_S), HALT_STEP_S).tolist():
                samples.append((each_s, {"axis_m": mover.position(each_s)}))
        samples.append((t_s, self._places(t_s)))
        if hasattr(self._bench, "contacts"):
            touches_s = [touch_s for touch_s, made in self._bench.contacts if made]
            self.trials[-1].touched_s = min(touches_s, default=math.inf)

    def campaign_ended(self, line: str) -> None:
        """See `Console`: the movers are looked at a moment later, before another trial or the end of the process."""
        self.lines.append(line)

    def rest(self) -> None:
        """Keep whether anything moves at the end."""
        if not self.trials:
            return
        t_s = self._rig.clock.now()
        before, after = self._places(t_s), {}
        mover: Any = getattr(self._bench, "mover", None)
        if hasattr(mover, "position"):
            after["axis_m"] = (mover.position(t_s + 0.01) - before["axis_m"]) / 0.01
        if hasattr(mover, "offsets"):
            two = mover.offsets(np.array([t_s, t_s + 0.01]))
            after["tool_m"] = float(np.linalg.norm((two[1] - two[0])[:3]) / 0.01)
        self.trials[-1].end_s, self.trials[-1].moving = t_s, after


def held() -> dict[str, int]:
    """What this process holds."""
    return {"threads": threading.active_count(), "descriptors": len(list(Path("/proc/self/fd").iterdir()))}


@contextmanager
def memory() -> Iterator[Path]:
    """A folder on a disk in memory, gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="swarm_", dir=MEMORY if MEMORY.is_dir() else None))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _noted(trials: Iterable[TrialPlan], measured: dict[str, set[str]]) -> Iterator[TrialPlan]:
    """The trials; which devices each state measures is noted."""
    for trial in trials:
        made = {signal.info.name: signal for signal in trial.signals}
        for state, plans in trial.behavior.foreseen.items():
            streams = [stream for plan in plans for stream in plan.measures]
            measured.setdefault(state, set()).update(sources(streams, made))
        yield trial


def play(
    plan: Plan,
    folder: Path,
    profile: Profile | None = None,
    resumed: Path | None = None,
    kill_at: int | None = None,
) -> Story:
    """Play a plan, or go on with a run that broke off.

    Args:
        folder: In which the run's folder is made.
        profile: That is played; None is the plan's own.
        resumed: Folder of the run that broke off.
        kill_at: See `Onlooker`.
    """
    profile = profile or plan.profile(folder)
    limits = profile.limits.model_dump(mode="json")
    story = Story(plan, folder, limits, profile.resolved, [])
    witness, there = Onlooker(kill_at), held()
    try:
        before = broken_off(RunFolder(resumed)) if resumed else None
        campaign: CampaignPlan = plan_campaign(
            profile, profile.trials(0), 0, done=before.done if before else ()
        )
        campaign = replace(campaign, trials=_noted(campaign.trials, story.measured))
        rig = build_rig(profile, devices=campaign.devices)
        try:
            with warnings.catch_warnings():  # a person would read them amid the run, and know no more
                warnings.simplefilter("error", RuntimeWarning)
                outcome = Campaign(campaign, witness.attach(rig), witness, folder / "runs", before).run()
        finally:
            witness.rest()
        story.folder, story.exit_code, story.line = outcome.folder, outcome.exit_code, outcome.line
        story.error = outcome.error
    except Exception as error:  # whatever it is: it is what the swarm looks for
        story.error = error
        return story
    finally:
        story.trials, story.killed = witness.trials, witness.killed
    story.left = {name: count - there[name] for name, count in held().items() if count > there[name]}
    story.manifest = json.loads((story.folder / "manifest.json").read_bytes())
    trials_path, events_path = story.folder / "trials.csv", story.folder / "events.jsonl"
    if trials_path.exists():
        story.raw = trials_path.read_bytes(), events_path.read_bytes()
        with trials_path.open(newline="", encoding="utf-8") as file:
            story.rows = list(csv.DictReader(file))
    return story
