"""Storage of benchmark figures, with the machine they were measured on."""

import json
import multiprocessing
import os
import pickle
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from config.script import run_trials
from controller.recording.reader import Run

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "benchmarks" / "results"
KEPT = Path("build/benchmarks")
"""Finished parts of studies, by the code that they depend on."""

ROUNDS = 11
"""Measurements of what is timed."""

AT_LEAST_S = 0.004
"""A measurement shorter than this is repeated inside: a thousand times what reading the clock costs."""

T = TypeVar("T")
R = TypeVar("R")


def machine() -> dict[str, Any]:
    """The machine: ratios hold elsewhere, absolute times do not."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    about = {
        "cpu": model or platform.processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }
    return about | {"date": datetime.now(UTC).date().isoformat()}


def workers() -> ProcessPoolExecutor:
    """A process per core, each a fresh interpreter: a fork after loading numba's threads may hang."""
    return ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn"))


def in_parallel(function: Callable[[T], R], work: Iterable[T], pool: ProcessPoolExecutor) -> list[R]:
    """Results in order, computed on all cores."""
    listed = list(work)
    return list(pool.map(function, listed, chunksize=max(1, min(50, len(listed) // 8))))


def played(
    profile: str,
    trials: Sequence[Mapping[str, Any]],
    settings: Mapping[str, str],
    seed: int,
    take: Callable[[Run, Mapping[str, Any], float], T],
) -> list[T]:
    """Run trials by the program, and take something of each; a fault ends a run: those that are left have another one.

    Args:
        trials: Factors of each.
        take: From a run, a row of it, and what a trial took of processor time, s.
    """
    found = list[T]()
    while len(found) < len(trials):
        with TemporaryDirectory() as folder:
            begun_s, first = time.process_time(), len(found)
            about: dict[str, Any] = {"seed": seed + first, "out": Path(folder), "say": lambda line: None}
            _, run = run_trials(profile, trials[first:], settings=settings, **about)
            spent_s = (time.process_time() - begun_s) / len(run.trials)
            found += [take(run, row, spent_s) for row in run.trials]
    return found


def kept(name: str, compute: Callable[[], T]) -> T:
    """A part of a study, from the cache where it is there: an interrupted study continues, unless code has changed."""
    path = KEPT / _code() / f"{name}.pickle"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.with_suffix(".part").write_bytes(pickle.dumps(compute()))
        path.with_suffix(".part").rename(path)
    found: T = pickle.loads(path.read_bytes())
    return found


@cache
def _code() -> str:
    """Of studies, behaviors, detectors, signals and plants, as they are."""
    rooms = ("benchmarks", "behaviors", "controller/detectors", "controller/signals", "simulator/physics")
    files = sorted(path for room in rooms for path in ROOT.glob(f"{room}/*.py"))
    return sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def side_by_side_s(
    works: Sequence[tuple[Callable[[], object], Callable[[], object]]], rounds: int = ROUNDS
) -> NDArray[np.float64]:
    """CPU time of each after a warm-up, s, shape (rounds, works): measured in turns, so that other load affects all.

    Args:
        works: What has to be done before each run and is not timed, and the run.
        rounds: How often.
    """

    def once_s(before: Callable[[], object], run: Callable[[], object]) -> float:
        before()
        begun_s = time.process_time()
        run()
        return time.process_time() - begun_s

    for work in works:
        once_s(*work)  # compiles
    inners = [max(1, min(100, int(AT_LEAST_S / max(once_s(*work), 1e-6)))) for work in works]
    return np.array(
        [
            [
                sum(once_s(*work) for _ in range(inner)) / inner
                for work, inner in zip(works, inners, strict=True)
            ]
            for _ in range(rounds)
        ]
    )


def progress(what: str) -> None:
    """Print the progress of a study, with the time of day."""
    print(f"{time.strftime('%H:%M:%S')}  {what}", flush=True)


def save(name: str, result: Mapping[str, Any], *, quick: bool = False) -> None:
    """Write one benchmark's figures as JSON, and print them; those of a quick run to build/quick. The page beside them
    is written by hand. What the file has and the study measures no more goes under `earlier`."""
    folder = Path("build/quick") if quick else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    there = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    earlier = {key: value for key, value in there.items() if key not in ("machine", "earlier")}
    earlier = {k: v for k, v in {**there.get("earlier", {}), **earlier}.items() if k not in result}
    kept_too = {"earlier": earlier} if earlier else {}
    text = json.dumps({"machine": machine(), **result, **kept_too}, indent=2)
    path.write_text(text + "\n", encoding="utf-8")
    print("\n".join(shown(result)))


def shown(value: Any, title: str = "") -> Iterator[str]:
    """Rows as a table each, numbers as lines; lists of single measurements stay in the file."""
    if isinstance(value, Mapping):
        rows = list(value.values())
        if not rows or not all(isinstance(row, Mapping) for row in rows) or any(map(_deep, rows)):
            for key, part in value.items():
                yield from shown(part, f"{title}: {key}" if title else str(key))
            return
        value = [{"": key, **row} for key, row in value.items()]
    if not isinstance(value, (list, tuple)):
        yield f"{title}: {value:.4g}" if isinstance(value, float) else f"{title}: {value}"
    elif value and all(isinstance(row, Mapping) for row in value):
        flat = pd.json_normalize(list(value))
        columns = [name for name in flat if not any(isinstance(cell, (list, tuple)) for cell in flat[name])]
        yield f"\n{title}\n{flat[columns].to_string(index=False, float_format='{:.4g}'.format)}\n"


def _deep(row: Mapping[str, Any]) -> bool:
    """Whether it is a list of rows."""
    return all(isinstance(cell, Mapping) for cell in row.values())
