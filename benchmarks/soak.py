"""Whole runs on the emulated bench, one after the other, and the tests, idle and beside a process that burns a core.

python -m benchmarks.soak                            everything: 20 runs of each, `make test` five times; hours
python -m benchmarks.soak --runs 2 --tests 0 emulated/slip
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import click

from benchmarks.results import ROOT, save

PROFILES = ("emulated/slip", "emulated/transient_arm", "emulated/centering", "emulated/transient")
BESIDE = {"idle": 0, "busy": 1}
"""How many processes burn a core beside it."""

LOOK_S = 0.2
"""Interval between readings of the processes' CPU time, s; the last reading may lack as much."""

PARTS = {"emulator": "simulator.wiring.emulator", "arm": "drivers.arm.process"}
"""Processes that a run starts, by their modules."""


class Ended(NamedTuple):
    """Result of one run: exit code, last line, wall and bench time, the loop's latest turn (0 where none was a whole
    period late), CPU time of each process."""

    code: int
    said: str
    wall_s: float
    bench_s: float = 0.0
    late_s: float = 0.0
    cpu_s: Mapping[str, float] = {}


@contextmanager
def burners(count: int) -> Iterator[None]:
    """Processes that load a core each."""
    started = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for one in started:
            one.kill()
            one.wait()


def run(profile: str) -> Ended:
    """One run by the command line."""
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "run.py", "run", profile, "--no-report", "--out", out]
        with (Path(out) / "output").open("w+", encoding="utf-8") as output:
            child = subprocess.Popen(command, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT)
            cpu_s: dict[str, float] = {}
            while child.poll() is None:
                cpu_s.update(_cpu_s(child.pid))
                time.sleep(LOOK_S)
            output.seek(0)
            last = (output.read().strip().splitlines() or [""])[-1]
        manifests = list(Path(out).glob("*/manifest.json"))
        loop = json.loads(manifests[0].read_text(encoding="utf-8"))["loop"] if manifests else {}
    wall_s = time.monotonic() - began_s
    return Ended(
        child.returncode, last, wall_s, loop.get("bench_s", 0.0), loop.get("worst_late_s", 0.0), cpu_s
    )


def _cpu_s(parent: int) -> Iterator[tuple[str, float]]:
    """CPU time, s, of a run's processes so far."""
    tick_s = 1.0 / os.sysconf("SC_CLK_TCK")
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            fields = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            command = (folder / "cmdline").read_bytes().decode(errors="replace")
        except OSError:  # it has ended meanwhile
            continue
        used_s = (int(fields[11]) + int(fields[12])) * tick_s
        if int(folder.name) == parent:
            yield "program", used_s
        elif int(fields[1]) == parent:
            for name, module in PARTS.items():
                if module in command:
                    yield name, used_s


def suite() -> Ended:
    """The tests, once."""
    began_s = time.monotonic()
    done = subprocess.run(["make", "test"], cwd=ROOT, capture_output=True, text=True, check=False)
    last = (done.stdout.strip().splitlines() or [""])[-1]
    return Ended(done.returncode, last, time.monotonic() - began_s)


def row(name: str, beside: str, ended: Sequence[Ended]) -> dict[str, object]:
    """A line of the table; shares are of one core."""

    def share(part: str) -> float | None:
        used = [one.cpu_s[part] / one.wall_s for one in ended if part in one.cpu_s]
        return sum(used) / len(used) if used else None

    wall_s = sorted(one.wall_s for one in ended)
    return {
        "what": name,
        "beside": beside,
        "ended_well": sum(one.code == 0 for one in ended),
        "of": len(ended),
        "worst_late_s": max(one.late_s for one in ended),
        "median_wall_s": wall_s[len(wall_s) // 2],
        "bench_s_a_wall_s": sum(one.bench_s for one in ended) / sum(wall_s),
        **{f"{part}_share": share(part) for part in PARTS},
        "runs": [one._asdict() for one in ended],
    }


@click.command()
@click.argument("profiles", nargs=-1)
@click.option("--runs", default=20, show_default=True, help="Of each profile, idle and busy.")
@click.option("--tests", default=5, show_default=True, help="How often `make test` runs, busy.")
@click.option("--beside", type=click.Choice(tuple(BESIDE)), multiple=True, help="Idle or busy alone.")
def main(profiles: Sequence[str], runs: int, tests: int, beside: Sequence[str]) -> None:
    """Run, count, print, save."""
    rows: list[dict[str, object]] = []
    failed = False
    every = product(profiles or PROFILES, beside or BESIDE)
    kinds: list[tuple[str, str, int, Callable[[], Ended]]] = []
    kinds += [(profile, kind, runs, partial(run, profile)) for profile, kind in every]
    for name, kind, count, one in [*kinds, ("make test", "busy", tests, suite)]:
        ended: list[Ended] = []
        with burners(BESIDE[kind]):
            for number in range(count):
                ended.append(one())
                print(f"{name}, {kind}, {number + 1} of {count}: {ended[-1]}", flush=True)
        if ended:
            rows.append(row(name, kind, ended))
            failed |= any(one.code for one in ended)
    save("soak", {"load": os.getloadavg(), "runs": rows})
    sys.exit(failed)


if __name__ == "__main__":
    main()
