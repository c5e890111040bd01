"""The physics benchmark: `python -m benchmarks physics`, or `python -m benchmarks.physics [--quick]`."""

from __future__ import annotations

import sys
import time
from importlib.metadata import version
from typing import Any

from benchmarks.physics import comparison, figures, life, ours, stress
from benchmarks.physics.model import scenes
from benchmarks.physics.report import Findings, claim, document, ratios, scenes_of
from benchmarks.results import FOLDER, machine, save

VERSIONS = ("numpy", "numba", "scipy", "mujoco", "mpmath")


def _say(*cells: Any) -> None:
    print("  ".join(str(cell) for cell in cells), flush=True)


def _compare(quick: bool) -> tuple[list[comparison.Point], list[comparison.Check]]:
    points, checks = [], []
    for found in comparison.compare(quick=quick):
        if isinstance(found, comparison.Check):
            checks.append(found)
            continue
        points.append(found)
        _say(
            f"{found.scene + (', closed' if found.closed else ', open'):22}",
            f"{found.solver:24} {found.setting:>10} {found.us_per_s:12,.0f} us/s",
            f"theta {found.off.theta_rad:.0e}  events {found.off.event_s:.0e}",
            "" if found.whole else f"{found.off.missed} missed, {found.off.invented} invented",
        )
    return points, checks


def _sweep(quick: bool) -> list[stress.Cell]:
    cells = []
    for cell in stress.sweep(quick=quick):
        cells.append(cell)
        if not cell.met:
            _say(
                f"stress {cell.stiffness_n_m:g} N/m, {cell.damping_n_s_m:g} N s/m, closed={cell.closed}:",
                cell.off,
            )
    _say(f"stress: bounds met in {sum(c.met for c in cells)} of {len(cells)} cells")
    return cells


def main(quick: bool = False) -> None:
    """Measure, print a table; write results and figures, unless it is quick (too coarse to be kept)."""
    begun_s = time.perf_counter()
    points, checks = _compare(quick)
    cells = _sweep(quick)
    speeds, trials = life.speeds(quick=quick), life.trials()
    for speed in speeds:
        _say(
            f"{speed.scene}, noise {'on' if speed.noise else 'off'}: {speed.times_real:,.0f} times real time"
        )
    for trial in trials:
        _say(
            f"95 s, {trial.name}: {trial.at_once_ms:.1f} ms read at once, {trial.in_turns_ms:.1f} ms in turns"
        )
    if not quick:
        where = {**machine(), **{name: version(name) for name in VERSIONS}}
        set_up_ms = 1e3 * ours.set_up_s(scenes(closed=True)[1])
        memory_mb, first_uses = life.memory_mb(), life.first_uses()
        took_s = time.perf_counter() - begun_s
        found = Findings(
            where, points, checks, speeds, trials, memory_mb, first_uses, cells, set_up_ms, took_s
        )
        _write(found)
    _say()
    _say(claim(points))


def _write(found: Findings) -> None:
    (FOLDER / "physics.md").write_text(document(found), encoding="utf-8")
    save(
        "physics",
        {
            "versions": {name: found.machine[name] for name in VERSIONS},
            "claim": claim(found.points),
            "ratios": [r._asdict() for r in ratios(found.points)],
            "points": [{**p._asdict(), "off": p.off._asdict()} for p in found.points],
            "checks": [{**c._asdict(), "scipy": c.scipy._asdict()} for c in found.checks],
            "speeds": [s._asdict() for s in found.speeds],
            "trials": [t._asdict() for t in found.trials],
            "memory_mb": dict(found.memory_mb),
            "first_uses": {name: use._asdict() for name, use in found.first_uses.items()},
            "stress": [{**c._asdict(), "off": c.off._asdict(), "met": c.met} for c in found.cells],
            "set_up_ms": found.set_up_ms,
            "took_s": found.took_s,
        },
    )
    for closed in sorted({closed for _, closed in scenes_of(found.points)}):
        figures.draw(found.points, closed=closed)


if __name__ == "__main__":
    main("--quick" in sys.argv)
