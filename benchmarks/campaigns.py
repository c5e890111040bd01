"""Big campaigns: trials a second and memory against workers and trials; runs killed at random instants and resumed.

Rows must be the same to the byte however they were run and however often killed; this counts it.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import Executor, Future
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from config.assemble import Table, plan_campaign
from config.jobs import Crew, Order, Silent, cores, in_parts
from config.profile import load_profile
from controller.parts import RunPart
from run import cli

ROOT = Path(__file__).resolve().parents[1]

KILLS = 100
SIZES = (100, 1_000, 10_000)
WORKERS = (1, 2, 4)
LARGEST = (2, 100_000)
"""Workers and trials of the longest campaign, the most that a run may have (`config.trials`)."""

PART = 256
"""Trials of the part that the writer alone processes repeatedly: the most that a part has."""

FOURTEEN = (
    *("run", "mock/transient", "--no-report", "--set", "trials.repeats=1"),
    *("--set", "behavior.settle_s=1.0", "--set", "behavior.hold_s=0.05"),
)
"""The killed run: the loop just locks, and nothing is held."""

SHORT = {
    "behavior.settle_s": "0.2",
    "behavior.rest_s": "0.02",
    "behavior.record_s": "0.05",
}
"""A short trial of mock/static: home, start, excite, settle, rest, record without contact, retract."""


def main(*, quick: bool = False) -> None:
    """Kill, resume and compare, then run ever longer campaigns; write results/campaigns.json."""
    kills = killed(5 if quick else KILLS)
    scaled({"kills": kills, "equal_rows": equal()}, quick=quick)


def scaled(known: dict[str, Any], *, quick: bool = False) -> None:
    """Measure what the known rows lack, the shortest first."""
    from benchmarks.results import save  # pandas: 60 MB, where the writer's memory is measured

    runs, alone = known.setdefault("runs", []), known.setdefault("writer_alone", [])
    for trials in (*SIZES[: 1 if quick else None], *(() if quick else LARGEST[1:])):
        if trials not in [row["asked"] for row in alone]:
            alone.append({"asked": trials, **_measured(_WRITER, str(trials))})
            save("campaigns", known, quick=quick)
    pairs = [(workers, trials) for trials in SIZES[: 1 if quick else None] for workers in WORKERS]
    for workers, trials in (*pairs, *(() if quick else (LARGEST,))):
        if (workers, trials) not in [(row["workers"], row["trials"]) for row in runs]:
            with tempfile.TemporaryDirectory() as out:
                asked = (
                    "run",
                    "mock/static",
                    *_sets(trials),
                    "--no-report",
                    "--jobs",
                    str(workers),
                    "--out",
                    out,
                )
                measured = _measured(_RUN, *asked)
                digest = hashlib.sha256(_rows(Path(out))).hexdigest()[:12]
            runs.append({"workers": workers, "trials": trials, **measured, "rows_sha256": digest})
            save("campaigns", known, quick=quick)


def _short(trials: int) -> dict[str, str]:
    """Settings of a campaign of `trials` short trials."""
    rows = -(-trials // 10_000)
    listed = ", ".join(['{ condition = "none" }'] * rows)
    return {**SHORT, "trials.list": f"[{listed}]", "trials.repeats": str(trials // rows)}


def _sets(trials: int) -> list[str]:
    return [f"--set={key}={value}" for key, value in _short(trials).items()]


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


def equal() -> dict[str, bool]:
    """Whether each other way of running the main job, 42 approaches, gives the rows of one core."""
    from distributed import LocalCluster

    run = ("run", "mock/transient", "--no-report")
    with tempfile.TemporaryDirectory() as text:
        out = Path(text)
        _verb(*run, "--jobs", "1", "--out", str(out / "one core"))
        _verb(*run, "--jobs", "2", "--out", str(out / "two cores"))
        with LocalCluster(2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as dask:  # type: ignore[no-untyped-call]
            _verb(*run, "--scheduler", dask.scheduler_address, "--out", str(out / "Dask"))
        for number in range(1, 8):
            _verb(*run, "--jobs", "1", "--shard", f"{number}/7", "--out", str(out / "shards" / str(number)))
        shards = map(str, (out / "shards").glob("*/*"))
        _verb("merge", *shards, "--out", str(out / "seven shards"))
        _with_a_worker_killed(*run, "--jobs", "2", "--out", str(out / "worker killed"))
        expected = _rows(out / "one core")
        return {way.name: _rows(way) == expected for way in sorted(out.iterdir()) if way.name != "shards"}


def _with_a_worker_killed(*arguments: str) -> None:
    """Run a verb, and kill one of its workers when some rows are there."""
    process = subprocess.Popen(
        [sys.executable, "run.py", *arguments], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert process.stdout is not None
    lines = iter(process.stdout.readline, b"")
    next(line for line in lines if line.startswith(b"[5/"))
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text("utf-8").split()
    os.kill(int(children[-1]), signal.SIGKILL)
    output = process.stdout.read()
    assert process.wait() == 0, output


# --- long ----------------------------------------------------------------------------------------

_REPORTING = """
import atexit, resource, sys
def report():
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(used.ru_maxrss / 1024, used.ru_utime + used.ru_stime, file=sys.stderr)
atexit.register(report)
"""
"""Makes a program report at its end its largest memory, MB, and processor time, s."""

_RUN = f"{_REPORTING}from run import cli\ncli(sys.argv[1:])"
_WRITER = f"{_REPORTING}from benchmarks.campaigns import write\nwrite(int(sys.argv[1]))"


def _measured(program: str, *arguments: str) -> dict[str, float]:
    """Time and memory of a separate program with its workers."""
    begun_s, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", program, *arguments]
    done = subprocess.run(
        command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=True
    )
    wall_s, after = time.monotonic() - begun_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    memory_mb, writer_s = map(float, done.stderr.split()[-2:])
    return {
        "wall_s": wall_s,
        "processor_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "writer_processor_s": writer_s,
        "writer_peak_mb": memory_mb,
        "load": os.getloadavg()[0],
    }


class Again(Executor):
    """Returns the same part, already run, each time."""

    def __init__(self, part: RunPart) -> None:
        self._part = part

    def submit(self, *_: Any, **__: Any) -> Future[Any]:
        """That part."""
        future: Future[RunPart] = Future()
        future.set_result(self._part)
        return future


def write(trials: int) -> None:
    """Process `trials` trials, or a few more, in this process: the same part repeatedly, without computing it."""
    profile = load_profile("mock/static", _short(trials), table=Table())
    listed = profile.trials(0)
    plan = plan_campaign(profile, listed, 0)
    with closing(cores(1)) as crew:
        order = Order.of(profile, listed, plan.factors, 0)
        part = replace(crew.submit(order, listed[:PART]).result(), took_s=0.0)
    with tempfile.TemporaryDirectory() as out:
        in_parts(Crew(1, lambda: Again(part), lambda _: None), profile, plan, Silent(), Path(out)).run()


if __name__ == "__main__":
    from benchmarks.results import FOLDER

    scaled(json.loads((FOLDER / "campaigns.json").read_text("utf-8")))
