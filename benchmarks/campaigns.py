"""Big campaigns: trials a second and memory against workers and trials; runs killed at random instants and resumed.

Rows are the same to the byte whoever ran them, and however often they were killed; this counts it.
"""

from __future__ import annotations

import multiprocessing
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.results import save
from run import cli

ROOT = Path(__file__).resolve().parents[1]

KILLS = 100
WORKERS = (1, 2)
REPEATS = (7, 70, 700)
"""Of 14 approaches each: about 1e2, 1e3 and 1e4 trials."""

SHORT = ("--set", "behavior.settle_s=1.0", "--set", "behavior.hold_s=0.05", "--no-report")
"""A short trial: the loop just locks, and nothing is held."""


def main(*, quick: bool = False) -> None:
    """Kill, resume and compare, then run ever longer campaigns; write results/campaigns.json."""
    kills = killed(5 if quick else KILLS)
    save("campaigns", {"kills": kills, "runs": (runs := [])})
    for repeats in REPEATS[:1] if quick else REPEATS:
        rows = set()
        for workers in WORKERS:
            measured, written = _campaign(repeats, workers)
            rows.add(written)
            runs.append({**measured, "same_rows": len(rows) == 1})
            print(runs[-1], flush=True)
            save("campaigns", {"kills": kills, "runs": runs})


# --- killed --------------------------------------------------------------------------------------


def killed(count: int, seed: int = 1) -> dict[str, int]:
    """What became of so many runs of 14 trials, each killed (SIGKILL) at a random instant and resumed."""
    rng = random.Random(seed)
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        _verb(*_asked(1), "--out", str(folder / "first"))  # loads and compiles here, for all that are forked
        begun_s = time.monotonic()
        _forked(*_asked(1), "--out", str(folder / "whole")).join()
        length_s, expected = time.monotonic() - begun_s, _rows(folder / "whole")
        number = 0
        while found.total() - found["had_ended"] < count:
            number += 1
            found[_killed(folder / str(number), rng.uniform(0.0, length_s), expected)] += 1
            print(dict(found), flush=True)
    return dict(found)


def _killed(out: Path, after_s: float, expected: bytes) -> str:
    process = _forked(*_asked(1), "--out", str(out))
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


def _asked(repeats: int) -> tuple[str, ...]:
    return ("run", "mock/transient", *SHORT, "--set", f"trials.repeats={repeats}")


def _rows(out: Path) -> bytes:
    return next(out.glob("*/trials.csv")).read_bytes()


# --- long ----------------------------------------------------------------------------------------

_RUN = """
import resource, sys
from run import cli
try:
    cli(sys.argv[1:])
finally:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, file=sys.stderr)
"""


def _campaign(repeats: int, workers: int) -> tuple[dict[str, float], bytes]:
    """A program of its own, its wall and processor time (s), and how much memory (MB) the one that writes took."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-c", _RUN, *_asked(repeats), "--jobs", str(workers), "--out", out]
        begun_s, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=True
        )
        wall_s, after = time.monotonic() - begun_s, resource.getrusage(resource.RUSAGE_CHILDREN)
        rows = _rows(Path(out))
    trials = 14 * repeats
    processor_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "workers": workers,
        "trials": trials,
        "trials_a_second": trials / wall_s,
        "wall_s": wall_s,
        "processor_ms_a_trial": 1e3 * processor_s / trials,
        "peak_memory_of_the_writer_mb": float(done.stderr.split()[-1]),
        "load": os.getloadavg()[0],
    }, rows
