"""Big campaigns: trials a second and memory against workers and trials; runs killed at random instants and resumed.

Rows must be the same to the byte however they were run and however often killed; this counts it.
"""

import hashlib
import json
import math
import multiprocessing
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import Any, TextIO

from benchmarks.results import ROOT, save
from controller.recording.reader import open_run
from controller.recording.recorder import Recorder
from drivers.core.messages import SampleBlock
from run import cli

KILLS = 100
SIZES = (100, 1_000, 10_000)
WORKERS = (1, 2, 4)
LARGEST = (2, 100_000)
"""Workers and trials of the longest campaign, the most that a run may have (`config.trials`)."""

KILLED = {
    "mock/transient": ("behavior.settle_s=1.0", "behavior.hold_s=0.05"),
    "mock/slip": ("trials.repeats=1",),
}
"""The killed runs and what shortens them: 42 approaches, in which the loop just locks and nothing is
held; one trial with each of five sensors."""

SHORT = {"behavior.settle_s": "0.2", "behavior.rest_s": "0.02", "behavior.record_s": "0.05"}
"""A short trial of mock/static: home, start, excite, settle, rest, record without contact, retract."""


def main(*, quick: bool = False) -> None:
    """Kill, resume and compare, then run ever longer campaigns; write results/campaigns.json."""
    kills = {profile: killed(profile, 5 if quick else KILLS) for profile in KILLED}
    runs: list[dict[str, Any]] = []
    pairs = list(product(WORKERS, SIZES[:1])) if quick else [*product(WORKERS, SIZES), LARGEST]
    for workers, trials in sorted(pairs, key=lambda pair: pair[1]):
        with tempfile.TemporaryDirectory() as out:
            about = ("--no-report", "--jobs", str(workers), "--out", out)
            measured = _measured("run", "mock/static", *_short(trials), *about)
            digest = hashlib.sha256(_rows(Path(out))).hexdigest()[:12]
        runs.append({"workers": workers, "trials": trials, **measured, "rows_sha256": digest})
        save("campaigns", {"kills": kills, "runs": runs}, quick=quick)


def _short(trials: int) -> list[str]:
    """Settings of a campaign of `trials` short trials."""
    rows = -(-trials // 10_000)
    listed = ", ".join(['{ condition = "none" }'] * rows)
    settings = {**SHORT, "trials.list": f"[{listed}]", "trials.repeats": str(trials // rows)}
    return [f"--set={key}={value}" for key, value in settings.items()]


# --- killed --------------------------------------------------------------------------------------


def killed(profile: str, count: int, seed: int = 1) -> dict[str, float]:
    """Results of runs, each killed (SIGKILL) at a random instant and resumed; the longest time of which samples are
    lost, s."""
    rng = random.Random(seed)
    found: Counter[str] = Counter()
    longest_s = 0.0
    run = ("run", profile, "--no-report", "--jobs", "1", *(f"--set={each}" for each in KILLED[profile]))
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        _verb(*run, "--out", str(folder / "first"))  # loads and compiles before the forks
        begun_s = time.monotonic()
        _forked(*run, "--out", str(folder / "whole")).join()
        length_s, whole = time.monotonic() - begun_s, folder / "whole"
        number = 0
        while found.total() - found["had_ended"] < count:
            number += 1
            out = folder / str(number)
            result, lost_s = _killed(run, out, rng.uniform(0.0, length_s), whole)
            found[result] += 1
            longest_s = max(longest_s, lost_s)
            shutil.rmtree(out, ignore_errors=True)
            print(profile, dict(found), longest_s, flush=True)
    return {**found, "longest_lost_s": longest_s}


def _killed(run: Sequence[str], out: Path, after_s: float, whole: Path) -> tuple[str, float]:
    process = _forked(*run, "--out", str(out), told=(told := out.with_suffix(".told")))
    process.join(after_s)
    killed_s = time.monotonic()
    process.kill()
    process.join()
    if process.exitcode == 0:
        return "had_ended", 0.0
    if not list(out.glob("*/manifest.json")):
        return "had_no_folder_yet", 0.0
    lost_s = _lost_s(told, next(out.glob("*/manifest.json")).parent, killed_s)
    rows = b"".join(line for line in _rows(out).splitlines(keepends=True) if line.endswith(b"\n"))
    resumed = _forked("resume", "latest", "--out", str(out), "--no-report")
    resumed.join()
    if resumed.exitcode:
        return "refused", lost_s
    same = _rows(out).startswith(rows) and _rows(out) == _rows(whole) and _events(out) == _events(whole)
    return "equal" if same else "different", lost_s


def _lost_s(told: Path, run: Path, killed_s: float) -> float:
    """How long before the kill the recorder was handed the first sample that is not in the recording, s; else 0."""
    found = open_run(run)
    last_s: dict[tuple[int, str], float] = {}
    for line in told.read_text("utf-8").splitlines()[:-1]:
        handed_s, number, stream, t_s = line.split()
        trial = int(number)
        if (trial, stream) not in last_s:
            recorded = trial in found.recorded_trials
            times_s = found.trial(trial).stream(stream).times_s.tolist() if recorded else []
            last_s[trial, stream] = max(times_s, default=-math.inf)
        if float(t_s) > last_s[trial, stream]:
            return killed_s - float(handed_s)
    return 0.0


def _forked(*arguments: str, told: Path | None = None) -> Any:
    process = multiprocessing.get_context("fork").Process(target=_verb, args=arguments, kwargs={"told": told})
    process.start()
    return process


def _verb(*arguments: str, told: Path | None = None) -> None:
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere, ExitStack() as stack:
        if told is not None:
            _tell(stack.enter_context(told.open("w", encoding="utf-8", buffering=1)))
        sys.stdout, kept = nowhere, sys.stdout
        try:
            cli.main(list(arguments), prog_name="run.py")
        except SystemExit as ended:
            if ended.code:
                raise
        finally:
            sys.stdout = kept


def _tell(file: TextIO) -> None:
    """Write down what the recorder of this process is handed, and when: wall time, trial, stream, last sample."""
    record = Recorder.record

    def told(self: Recorder, blocks: Iterable[SampleBlock]) -> None:
        given = list(blocks)
        record(self, given)
        now_s = time.monotonic()
        for block in given:
            if len(block):
                file.write(f"{now_s} {self.trial.trial} {block.stream} {block.last_s!r}\n")

    Recorder.record = told  # type: ignore[method-assign]


def _events(out: Path) -> list[dict[str, Any]]:
    """Events of a run, without the numbers that commands have within a process."""
    lines = next(out.glob("*/events.jsonl")).read_text("utf-8").splitlines()
    return [{k: v for k, v in json.loads(line).items() if k != "command_id"} for line in lines]


def _rows(out: Path) -> bytes:
    return b"".join(path.read_bytes() for path in out.glob("*/trials.csv"))


# --- long ----------------------------------------------------------------------------------------

_RUN = """
import atexit, resource, sys
from run import cli
def report():
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(used.ru_maxrss / 1024, used.ru_utime + used.ru_stime, file=sys.stderr)
atexit.register(report)
cli(sys.argv[1:])
"""
"""The program, reporting at its end its largest memory, MB, and processor time, s."""


def _measured(*arguments: str) -> dict[str, float]:
    """Time and memory of a run with its workers, in a program of its own."""
    begun_s, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    to: dict[str, Any] = {"cwd": ROOT, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    done = subprocess.run([sys.executable, "-c", _RUN, *arguments], text=True, check=True, **to)
    wall_s, after = time.monotonic() - begun_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    memory_mb, writer_s = map(float, done.stderr.split()[-2:])
    return {
        "wall_s": wall_s,
        "processor_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "writer_processor_s": writer_s,
        "writer_peak_mb": memory_mb,
        "load": os.getloadavg()[0],
    }
