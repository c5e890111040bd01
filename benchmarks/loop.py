"""The cost of a campaign, layer by layer: processor time, one core, the program warm; eleven campaigns, all simulated.

`python -m benchmarks loop [--quick]`. A trial or a few of each profile; start of Python and compiling are left out.
"""

import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.results import save
from config import assemble
from config.profile import load_profile
from controller.arrivals import Arrivals
from controller.campaign import Campaign
from controller.console import Console
from controller.guard import Guard
from controller.loop import Loop
from controller.recording.reader import open_run
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder
from controller.reports.report import build_report
from controller.signals.protocol import Signals
from simulator.look_ahead import Snapshot
from simulator.mocks.base import MockDriver
from simulator.physics.aura_part import AuraPart
from simulator.physics.bench import Bench
from simulator.physics.finger_part import FingerPart
from simulator.physics.fingertip_part import FingertipPart

CAMPAIGNS = {
    "transient": (42, 4000),
    "static": (3, 2000),
    "weights": (1, 600),
    "pretouch": (4, 300),
    "touch": (4, 300),
    "objects": (2, 180),
    "centering": (4, 180),
    "slip": (3, 60),
    "pointer": (1, 120),
    "flexion": (1, 200),
    "chirp": (2, 25),
}
"""Trials of each profile (the first of seed 1), and virtual seconds a second of processor time that are wanted."""

REPEATS = 3
"""Runs without the stopwatch; the least is reported, which other load on the machine changes least."""

PARTS: tuple[tuple[str, type[Any], tuple[str, ...]], ...] = (
    ("physics", Bench, ("advance", "wrench", "places", "on_plan")),
    ("physics", FingerPart, ("sample", "events")),
    ("physics", FingertipPart, ("sample", "forces_n", "texels_v")),
    ("physics", AuraPart, ("baseband", "carrier")),
    ("signals", Signals, ("push",)),
    ("detectors", Loop, ("_detect",)),
    ("guard", Guard, ("check",)),
    ("guard", Arrivals, ("check", "whole_until_s")),
    ("keeping", Snapshot, ("__init__", "restore")),
    ("behavior", Loop, ("_handle",)),
    ("recorder", Recorder, ("record", "readings", "event", "begin_trial", "end_trial", "flush", "close")),
    ("loop", Loop, ("run",)),
    ("campaign", Campaign, ("run",)),
)
"""Part, class and methods whose time is reported; calls to other parts are not included."""


class Stopwatch:
    """Adds up the processor time spent in methods, exclusive of the watched methods that they call."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)
        self._running: list[float] = []

    def watch(self, owner: type[Any], method: str, part: str) -> Callable[[], None]:
        """Time a method as a part; returns a function that undoes it."""
        original = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            begun_s = time.process_time()
            self._running.append(0.0)
            try:
                return original(*args, **kwargs)
            finally:
                whole_s = time.process_time() - begun_s
                self.spent_s[part] += whole_s - self._running.pop()
                if self._running:
                    self._running[-1] += whole_s

        setattr(owner, method, timed)
        return lambda: setattr(owner, method, original)


@contextmanager
def watched() -> Iterator[Stopwatch]:
    """Watch every part."""
    stopwatch = Stopwatch()
    kinds: list[type[Any]] = [MockDriver, *_heirs(MockDriver)]
    own = [(kind, tuple(name for name in ("read", "poll", "apply") if name in vars(kind))) for kind in kinds]
    parts = (*PARTS, *(("drivers", *each) for each in own))
    undo = [stopwatch.watch(owner, method, part) for part, owner, methods in parts for method in methods]
    try:
        yield stopwatch
    finally:
        for restore in reversed(undo):
            restore()


def _heirs(kind: type[Any]) -> Iterator[type[Any]]:
    for heir in kind.__subclasses__():
        yield heir
        yield from _heirs(heir)


def campaign(name: str, trials: int, *, report: bool = False) -> tuple[float, float, dict[str, Any]]:
    """Run some trials of a mock profile; returns processor time of the run and of its report, s, and what the loop
    did."""
    profile = load_profile(f"mock/{name}", {})
    with tempfile.TemporaryDirectory() as folder:
        plan = assemble.plan_campaign(profile, profile.trials(1)[:trials], 1)
        begun_s = time.process_time()
        outcome = Campaign(plan, assemble.build_rig(profile), Console(), Path(folder)).run()
        ran_s = time.process_time()
        if report:
            build_report([open_run(outcome.folder)])
        return ran_s - begun_s, time.process_time() - ran_s, RunFolder(outcome.folder).read_manifest()["loop"]


def measured(name: str, trials: int, goal: float, repeats: int) -> dict[str, Any]:
    """One row of the table."""
    campaign(name, trials, report=True)  # compiled code loads, files are read once
    plain_s = min(campaign(name, trials)[0] for _ in range(repeats))
    report_s = campaign(name, trials, report=True)[1]
    with watched() as stopwatch:
        _, _, loop = campaign(name, trials)
    virtual_s, spent_s = loop["bench_s"], sum(stopwatch.spent_s.values())
    about = {"trials": trials, "virtual_s": virtual_s, "turns": loop["turns"], "processor_s": plain_s}
    return {
        **about,
        "virtual_s_per_s": virtual_s / plain_s,
        "goal": goal,
        "report_s": report_s,
        **{part: stopwatch.spent_s[part] / spent_s for part in ("drivers", *(p[0] for p in PARTS))},
    }


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    found: dict[str, Any] = {}
    for name, (trials, goal) in CAMPAIGNS.items():
        found[name] = measured(name, min(trials, 2) if quick else trials, goal, 1 if quick else REPEATS)
        save("loop", {"campaigns": found}, quick=quick)
