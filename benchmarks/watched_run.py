"""Whether a live page can disturb its run: a wire run twice without a page, and once with one that misbehaves.

All three run side by side, so that other load affects them alike. The page of the third has a client that
does not read, then its process is stopped, then it is killed: a third of the run each.
"""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live_page import READY_S, connected
from benchmarks.results import save

ROOT = Path(__file__).resolve().parents[1]

REPEATS, RUN_S = 38, 1200.0
QUICK_REPEATS, QUICK_RUN_S = 1, 36.0

SIGMA = 6.0
"""Threshold of the paper's detector, which stops the stage here, in standard deviations: at the paper's 3 noise stops
one approach in seven, each time another one."""

COMPARED = ("delay_s", "force_n", "stop_travel_m")
"""Columns whose quantiles are reported: each run decides on other samples, by when the finger was switched on."""


def begun(folder: Path, repeats: int, *more: str) -> subprocess.Popen[str]:
    """A run of the emulated bench."""
    sets = (
        f"trials.repeats={repeats}",
        "behavior.detector=contact",
        f"detectors.contact.threshold_sigma={SIGMA}",
    )
    command = [
        sys.executable,
        str(ROOT / "run.py"),
        "run",
        "emulated/transient",
        "--out",
        str(folder),
        "--no-report",
    ]
    command += [part for each in sets for part in ("--set", each)]
    return subprocess.Popen(
        [*command, *more],
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def page_of(run: subprocess.Popen[str]) -> int:
    """The process that serves its page."""
    children = " ".join(path.read_text() for path in Path(f"/proc/{run.pid}/task").glob("*/children"))
    for child in children.split():
        if b"controller.watching.page" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    raise RuntimeError("the run has no page")


def results_of(folder: Path) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """The account of a run's loop, and its rows."""
    (run,) = (path.parent for path in folder.glob("*/trials.csv"))
    with (run / "trials.csv").open(encoding="utf-8") as file:
        rows = sorted(csv.DictReader(file), key=lambda row: int(row["trial"]))
    return json.loads((run / "manifest.json").read_text(encoding="utf-8"))["loop"], rows


def quantiles(rows: list[dict[str, str]]) -> dict[str, float]:
    """Median and 90th percentile of some columns."""
    found: dict[str, float] = {}
    for name in COMPARED:
        known = [float(row[name]) for row in rows if row[name]]
        found |= {f"{name} p{part}": float(np.percentile(known, part)) for part in (50, 90)}
    return found


def misbehave(run: subprocess.Popen[str], seconds: float) -> list[str]:
    """A client that does not read, a page that is stopped, a page that is killed; the actions with their times."""
    assert run.stdout is not None
    link = next(line.split()[-1] for line in run.stdout if "token=" in line)
    host, token = link.removeprefix("http://").split("/?token=")
    began_s, done = time.monotonic(), []
    time.sleep(READY_S)
    page = page_of(run)

    def at(part: float, what: str) -> None:
        time.sleep(max(0.0, began_s + part * seconds - time.monotonic()))
        done.append(f"{time.monotonic() - began_s:.0f} s: {what}")
        print(done[-1], flush=True)

    at(0.0, "a client connects and does not read")
    deaf = connected(host, token)
    at(1 / 3, "SIGSTOP of the page's process")
    os.kill(page, signal.SIGSTOP)
    at(2 / 3, "SIGKILL of the page's process")
    os.kill(page, signal.SIGKILL)
    run.wait()
    deaf.close()
    return done


def main(quick: bool = False) -> None:
    """Run the three, compare, save."""
    repeats, seconds = (QUICK_REPEATS, QUICK_RUN_S) if quick else (REPEATS, RUN_S)
    names = ("without a page", "without a page, again", "with the page")
    with tempfile.TemporaryDirectory() as place:
        folders = {name: Path(place) / str(number) for number, name in enumerate(names)}
        began_s = time.monotonic()
        runs = {name: begun(folders[name], repeats) for name in names[:2]}
        runs[names[2]] = begun(folders[names[2]], repeats, "--watch")
        done = misbehave(runs[names[2]], seconds)
        codes = {name: run.wait() for name, run in runs.items()}
        seconds = time.monotonic() - began_s
        results = {name: results_of(folder) for name, folder in folders.items()}
    outcomes = {name: [row["outcome"] for row in rows] for name, (_, rows) in results.items()}
    first = outcomes[names[0]]
    result = {
        "seconds": seconds,
        "page": done,
        "runs": {
            name: {
                "exit": codes[name],
                "turns": account["turns"],
                "overruns": account["overruns"],
                "worst_late_ms": 1e3 * account["worst_late_s"],
                "trials": len(rows),
                "contacts": outcomes[name].count("contact"),
                "other than the first's": sum(a != b for a, b in zip(outcomes[name], first, strict=True)),
                **quantiles(rows),
            }
            for name, (account, rows) in results.items()
        },
    }
    save("watched_run", result, quick=quick)


if __name__ == "__main__":
    main("--quick" in sys.argv)
