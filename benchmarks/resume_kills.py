"""Runs killed at random instants and resumed: do the joined rows equal those of an uninterrupted run?

python -m benchmarks.resume_kills [KILLS]
"""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.results import save

ROOT = Path(__file__).resolve().parents[1]

KILLS = 100
ARGUMENTS = ("mock/transient", "--set", "behavior.settle_s=2.0", "--set", "trials.repeats=1", "--no-report")


def main(*, quick: bool = False, kills: int = KILLS) -> None:
    """Kill, resume, compare; write results/resume.json."""
    kills = 5 if quick else kills
    rng = random.Random(1)
    counts = {"equal": 0, "before_there_was_a_folder": 0, "after_the_end": 0, "different": 0, "refused": 0}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        begun_s = time.monotonic()
        _run("run", *ARGUMENTS, "--out", str(folder / "whole"))
        length_s = time.monotonic() - begun_s
        expected = _rows(folder / "whole")
        for number in range(kills):
            counts[_killed(folder / str(number), rng.uniform(0.3, 1.0) * length_s, expected)] += 1
    print(
        f"{kills} kills: " + ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
    )
    save("resume", {"kills": kills, **counts})


def _killed(out: Path, after_s: float, expected: bytes) -> str:
    process = subprocess.Popen(
        [sys.executable, "run.py", "run", *ARGUMENTS, "--out", str(out)], cwd=ROOT, stdout=subprocess.DEVNULL
    )
    try:
        process.wait(after_s)
        return "after_the_end"
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if not list(out.glob("*/manifest.json")):
        return "before_there_was_a_folder"
    if _run("resume", "latest", "--out", str(out), "--no-report"):
        return "refused"
    return "equal" if _rows(out) == expected else "different"


def _run(*arguments: str) -> int:
    return subprocess.run(
        [sys.executable, "run.py", *arguments], cwd=ROOT, stdout=subprocess.DEVNULL, check=False
    ).returncode


def _rows(out: Path) -> bytes:
    return next(out.glob("*/trials.csv")).read_bytes()


if __name__ == "__main__":
    main(kills=int(sys.argv[1]) if sys.argv[1:] else KILLS)
