"""What the loop costs: virtual seconds a second, turns, time a turn by part, start-up of `run.py list`."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.results import save
from config import assemble
from config.jobs import Silent
from config.profile import load_profile
from controller.campaign import Campaign
from controller.guard import Guard
from controller.loop import Loop
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder
from drivers.mock.physics.finger import FingerPlant

ROOT = Path(__file__).resolve().parent.parent
STARTS = 15
"""Starts of `run.py list`; the median is told."""


class Stopwatch:
    """Adds up the time spent in methods, exclusive of the watched methods that they call."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = defaultdict(float)
        self._running: list[float] = []

    def watch(self, owner: type, method: str, part: str) -> Callable[[], None]:
        """Time a method under a name; returns what undoes it."""
        original = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            begun_s = time.perf_counter()
            self._running.append(0.0)
            try:
                return original(*args, **kwargs)
            finally:
                whole_s = time.perf_counter() - begun_s
                self.spent_s[part] += whole_s - self._running.pop()
                if self._running:
                    self._running[-1] += whole_s

        setattr(owner, method, timed)
        return lambda: setattr(owner, method, original)


PARTS = (
    (FingerPlant, "advance", "physics"),
    (FingerPlant, "sample", "physics"),
    (FingerPlant, "periods", "physics"),
    (FingerPlant, "begin", "physics"),
    (Loop, "_gather", "drivers (mock)"),
    (Guard, "watch", "guard"),
    (Loop, "_detect", "detectors"),
    (Loop, "_handle", "behavior and commands"),
    (Recorder, "record", "recorder"),
    (Recorder, "event", "recorder"),
    (Recorder, "flush", "recorder"),
    (Recorder, "begin_trial", "recorder"),
    (Recorder, "end_trial", "recorder"),
    (Recorder, "close", "recorder"),
    (Loop, "_turn", "loop"),
    (Loop, "run", "loop"),
    (Campaign, "run", "campaign: manifest, building, measuring"),
)


def campaign(watch: bool) -> tuple[float, dict[str, float], dict[str, Any]]:
    """Run the 42 approaches of the transient profile; returns seconds, seconds by part and the manifest."""
    profile = load_profile("mock/transient", {}, table=assemble.Table())
    stopwatch = Stopwatch()
    undo = [stopwatch.watch(*part) for part in PARTS] if watch else []
    try:
        with tempfile.TemporaryDirectory() as folder:
            plan = assemble.plan_campaign(profile, profile.trials(1), 1)
            begun_s = time.perf_counter()
            outcome = Campaign(plan, assemble.build_rig(profile), Silent(), Path(folder)).run()
            whole_s = time.perf_counter() - begun_s
            manifest = RunFolder(outcome.folder).read_manifest()
    finally:
        for restore in reversed(undo):
            restore()
    return whole_s, dict(stopwatch.spent_s), manifest


def start_up() -> float:
    """Median wall time of `run.py list` in seconds."""
    times_s = []
    for _ in range(STARTS):
        begun_s = time.perf_counter()
        subprocess.run([sys.executable, "run.py", "list"], cwd=ROOT, check=True, capture_output=True)
        times_s.append(time.perf_counter() - begun_s)
    return statistics.median(times_s)


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    campaign(watch=False)  # compiled code loads, files are read once
    plain_s = statistics.median(campaign(watch=False)[0] for _ in range(1 if quick else 5))
    watched_s, parts, manifest = campaign(watch=True)
    loop = manifest["loop"]
    turns = loop["turns"]
    save(
        "loop",
        {
            "trials": 42,
            "virtual_s": loop["bench_s"],
            "turns": turns,
            "wall_s": plain_s,
            "virtual_s_per_s": loop["bench_s"] / plain_s,
            "wall_watched_s": watched_s,
            "parts_s": parts,
            "parts_us_a_turn": {part: spent_s / turns * 1e6 for part, spent_s in parts.items()},
            "run_py_list_s": start_up(),
        },
        quick=quick,
    )


if __name__ == "__main__":
    main("--quick" in sys.argv)
