"""Big campaigns: trials a second and memory against workers and trials; runs killed at random instants and resumed.

Rows must be the same to the byte however they were run and however often killed; this counts it.
"""

import hashlib
import multiprocessing
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.results import ROOT, save
from run import cli

KILLS = 100
SIZES = (100, 1_000, 10_000)
WORKERS = (1, 2, 4)
LARGEST = (2, 100_000)
"""Workers and trials of the longest campaign, the most that a run may have (`config.trials`)."""

FOURTEEN = (
    *("run", "mock/transient", "--no-report", "--set", "trials.repeats=1"),
    *("--set", "behavior.settle_s=1.0", "--set", "behavior.hold_s=0.05"),
)
"""The killed run: the loop just locks, and nothing is held."""

SHORT = {"behavior.settle_s": "0.2", "behavior.rest_s": "0.02", "behavior.record_s": "0.05"}
"""A short trial of mock/static: home, start, excite, settle, rest, record without contact, retract."""


def main(*, quick: bool = False) -> None:
    """Kill, resume and compare, then run ever longer campaigns; write results/campaigns.json."""
    kills, runs = killed(5 if quick else KILLS), []
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


def killed(count: int, seed: int = 1) -> dict[str, int]:
    """Results of runs of 14 trials, each killed (SIGKILL) at a random instant and resumed."""
    rng = random.Random(seed)
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        _verb(*FOURTEEN, "--out", str(folder / "first"))  # loads and compiles before the forks
        begun_s = time.monotonic()
        _forked(*FOURTEEN, "--out", str(folder / "whole")).join()
        length_s, expected = time.monotonic() - begun_s, _rows(folder / "whole")
        number = 0
        while found.total() - found["had_ended"] < count:
            number += 1
            found[_killed(folder / str(number), rng.uniform(0.0, length_s), expected)] += 1
            print(dict(found), flush=True)
    return dict(found)


def _killed(out: Path, after_s: float, expected: bytes) -> str:
    process = _forked(*FOURTEEN, "--out", str(out))
    process.join(after_s)
    process.kill()
    process.join()
    if process.exitcode == 0:
        return "had_ended"
    if not list(out.glob("*/manifest.json")):
        return "had_no_folder_yet"
    resumed = _forked("resume", "latest", "--out", str(out), "--no-report")
    resumed.join()
    if resumed.exitcode:
        return "refused"
    return "equal" if _rows(out) == expected else "different"


def _forked(*arguments: str) -> Any:
    process = multiprocessing.get_context("fork").Process(target=_verb, args=arguments)
    process.start()
    return process


def _verb(*arguments: str) -> None:
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        sys.stdout, kept = nowhere, sys.stdout
        try:
            cli.main(list(arguments), prog_name="run.py")
        except SystemExit as ended:
            if ended.code:
                raise
        finally:
            sys.stdout = kept


def _rows(out: Path) -> bytes:
    return next(out.glob("*/trials.csv")).read_bytes()


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
