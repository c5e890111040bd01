"""The physics benchmark in words and tables (Markdown), from what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from benchmarks.physics.comparison import CROSS_CHECK, EULER, EXACT, ORDER_8, RK4, Check, Point, cost_at
from benchmarks.physics.life import FirstUse, Speed, TrialCost
from benchmarks.physics.scipy_rivals import MAX_STEP_S
from benchmarks.physics.stress import EVENT_BOUND_S, THETA_BOUND_RAD, Cell
from benchmarks.results import table

LEVELS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-9, 1e-12)
"""Errors at which the cheapest solver is named."""


class Findings(NamedTuple):
    """Everything that was measured."""

    machine: Mapping[str, Any]
    points: Sequence[Point]
    checks: Sequence[Check]
    speeds: Sequence[Speed]
    trials: Sequence[TrialCost]
    memory_mb: Mapping[str, float]
    first_uses: Mapping[str, FirstUse]
    cells: Sequence[Cell]
    set_up_ms: float
    took_s: float


class Ratio(NamedTuple):
    """How many times longer than the exact pieces others take, on one scene."""

    scene: str
    closed: bool
    exact_us_per_s: float
    exact_error: float
    rk4_1e9: float
    rk4_1e12: float
    order_8_1e12: float
    scipy_1e9: float
    mujoco_1e5: float
    """By theta alone."""


def scenes_of(points: Iterable[Point]) -> list[tuple[str, bool]]:
    """Scenes in the order in which they were solved."""
    return list(dict.fromkeys((p.scene, p.closed) for p in points))


def solvers_of(points: Iterable[Point]) -> list[str]:
    """Solvers in the order in which they ran."""
    return list(dict.fromkeys(p.solver for p in points))


def _of(points: Iterable[Point], scene: str, closed: bool) -> dict[str, list[Point]]:
    here = [p for p in points if (p.scene, p.closed) == (scene, closed)]
    return {solver: [p for p in here if p.solver == solver] for solver in solvers_of(here)}


def ratios(points: Sequence[Point]) -> list[Ratio]:
    """The headline, scene by scene."""
    found = []
    for scene, closed in scenes_of(points):
        by = _of(points, scene, closed)
        (exact,) = by[EXACT]

        def least(kind: str, error: float, theta: bool = False, by: dict[str, list[Point]] = by) -> float:
            costs = [
                cost_at(p, error, (lambda q: q.off.theta_rad) if theta else (lambda q: q.error))
                for solver, p in by.items()
                if solver.startswith(kind)
            ]
            return min(costs, default=math.inf)

        us = exact.us_per_s
        found.append(
            Ratio(
                scene,
                closed,
                us,
                exact.error,
                least(RK4, 1e-9) / us,
                least(RK4, 1e-12) / us,
                least(ORDER_8, 1e-12) / us,
                least("scipy", 1e-9) / us,
                least("MuJoCo", 1e-5, theta=True) / us,
            )
        )
    return found


def _span(values: Iterable[float]) -> str:
    """The range of some ratios, to two digits."""
    found = list(values)
    finite = sorted(v for v in found if math.isfinite(v))
    if not finite:
        return "(never reached)"
    low, high = _two(finite[0]), _two(finite[-1])
    everywhere = "" if len(finite) == len(found) else f" (in {len(finite)} of {len(found)} scenes)"
    return (low if low == high else f"{low} to {high}") + everywhere


def _two(value: float) -> str:
    """To two digits."""
    if not math.isfinite(value):
        return "–"
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def claim(points: Sequence[Point]) -> str:
    """The honest sentence, from the closed loop."""
    closed = [r for r in ratios(points) if r.closed]
    cheaper = [level for level in LEVELS if _cheaper(points, level)]
    limit = f"{min(cheaper):g}" if cheaper else "none of these"
    return (
        "With the loop closed and 1 kHz output on one core, the exact pieces take"
        f" {_span(r.exact_us_per_s for r in closed)} us per simulated second with every event within"
        f" {max(r.exact_error for r in closed):.0e} s of a 40-digit reference; compiled RK4 with event location takes"
        f" {_span(r.rk4_1e9 for r in closed)} times as long at an error of 1e-9 and"
        f" {_span(r.rk4_1e12 for r in closed)} times at 1e-12, a compiled method of order 8 with the same event"
        f" location {_span(r.order_8_1e12 for r in closed)} times at 1e-12, and where errors of {limit} and more are"
        " good enough, RK4 with event location is the faster choice."
    )


def _cheaper(points: Sequence[Point], level: float) -> bool:
    """Whether located RK4 beats the exact pieces at an error, on every closed scene."""
    costs = []
    for scene, closed in scenes_of(points):
        if closed:
            by = _of(points, scene, closed)
            costs.append(cost_at(by[RK4], level) < by[EXACT][0].us_per_s)
    return all(costs)


def cheapest(points: Sequence[Point]) -> str:
    """Which solver is the cheapest at which error."""
    rows = []
    for level in LEVELS:
        row = [f"{level:g}"]
        for scene, closed in scenes_of(points):
            if not closed:
                continue
            by = _of(points, scene, closed)
            us, name = min((cost_at(p, level), solver) for solver, p in by.items())
            euler = cost_at(by[EULER], level)
            row.append(f"{name}: {_two(us)} (exact {_two(by[EXACT][0].us_per_s)}, Euler {_two(euler)})")
        rows.append(row)
    heads = [scene for scene, closed in scenes_of(points) if closed]
    return table(["error at most", *heads], rows)


def _point_rows(points: Sequence[Point], scene: str, closed: bool) -> Iterator[list[str]]:
    for p in points:
        if (p.scene, p.closed) == (scene, closed):
            yield [
                p.solver,
                p.setting,
                f"{p.us_per_s:,.0f}",
                f"{1e6 / p.us_per_s:,.2g}" if p.us_per_s > 1e5 else f"{1e6 / p.us_per_s:,.0f}",
                f"{p.off.theta_rad:.0e}",
                f"{p.off.event_s:.0e}",
                f"{p.off.missed}/{p.off.invented}" if not p.whole else "",
            ]


def _ratio_table(points: Sequence[Point]) -> str:
    head = ["scene", "exact, us/s", "its error", "RK4 located, 1e-9", "1e-12", "order 8 located, 1e-12"]
    head += ["fastest of scipy, 1e-9", "MuJoCo, 1e-5 rad"]
    rows = [
        [
            f"{r.scene}, {'closed' if r.closed else 'open'}",
            f"{r.exact_us_per_s:.0f}",
            f"{r.exact_error:.0e}",
            *(_two(value) for value in r[4:]),
        ]
        for r in ratios(points)
    ]
    return table(head, rows)


def _stress_table(cells: Sequence[Cell], closed: bool) -> str:
    dampings = sorted({c.damping_n_s_m for c in cells})
    rows = []
    for stiffness in sorted({c.stiffness_n_m for c in cells}):
        row = [f"{stiffness:.0e}"]
        for damping in dampings:
            for c in cells:
                if (c.stiffness_n_m, c.damping_n_s_m, c.closed) == (stiffness, damping, closed):
                    lost = (
                        f", {c.off.missed}/{c.off.invented} events" if c.off.missed or c.off.invented else ""
                    )
                    mark = "" if c.met else " **missed**"
                    row.append(f"{c.contacts}: {c.off.theta_rad:.0e}, {c.off.event_s:.0e}{lost}{mark}")
        rows.append(row)
    return table(["k2, N/m \\ c2, N s/m", *(f"{d:g}" for d in dampings)], rows)


def document(found: Findings) -> str:
    """results/physics.md."""
    machine = ", ".join(f"{key} {value}" for key, value in found.machine.items())
    scenes = scenes_of(found.points)
    parts = [
        "# Physics: run time against error",
        f"Measured by `make bench` on: {machine}. CPU time of the process, medians of repeats after a warm-up, set-up"
        f" not counted (the plant's: {found.set_up_ms:.2f} ms a trial); the machine had other users, so ratios hold and"
        " absolute times do not."
        f" The whole took {found.took_s / 60:.1f} minutes.",
        claim(found.points),
        "## How many times longer than the exact pieces",
        "At equal error, on the straight line in logarithms between a solver's nearest settings; error: the larger of"
        " events' time error in s and theta's in rad, every event found (MuJoCo: by theta alone).",
        _ratio_table(found.points),
        "## The cheapest solver at an error",
        "us per simulated second, loop closed.",
        cheapest(found.points),
        "## In the bench's life",
        table(
            ["scene, loop closed, 1 kHz output", "noise", "times real time"],
            [[s.scene, _yes(s.noise), f"{s.times_real:,.0f}"] for s in found.speeds],
        ),
        table(
            [
                "a trial of 95 virtual s",
                "read at once, ms",
                "read in turns of 50 ms, ms",
                "seconds by tier",
                "off, rad",
            ],
            [
                [
                    t.name,
                    f"{t.at_once_ms:.1f}",
                    f"{t.in_turns_ms:.1f}",
                    ", ".join(f"{tier} {seconds:.1f}" for tier, seconds in t.tiers.items() if seconds),
                    "" if t.theta_rad is None else f"{t.theta_rad:.0e}",
                ]
                for t in found.trials
            ],
        ),
        table(
            ["an hour of bench", "growth of memory, MB"],
            [[name, f"{mb:.1f}"] for name, mb in found.memory_mb.items()],
        ),
        table(
            [
                "first use of the plant",
                "wall, s",
                "CPU, s",
                "of which settings alone, s",
                "numba loaded for settings",
            ],
            [
                [
                    name,
                    f"{u.wall_s:.1f}",
                    f"{u.cpu_s:.1f}",
                    f"{u.settings_s:.2f}",
                    "yes" if u.numba_for_settings else "no",
                ]
                for name, u in found.first_uses.items()
            ],
        ),
        "## Stress: contact stiffness by damping",
        "Cells: contacts made, error of theta in rad, of events in s, against the reference; asked are"
        f" {THETA_BOUND_RAD:g} and {EVENT_BOUND_S:g}. Met in {sum(c.met for c in found.cells)} of"
        f" {len(found.cells)} cells.",
        *(
            f"Loop {'closed' if closed else 'open'}:\n\n{_stress_table(found.cells, closed)}"
            for closed in sorted({c.closed for c in found.cells}, reverse=True)
        ),
        "## Is the reference right?",
        f"Its difference from scipy's {CROSS_CHECK[0]} at {CROSS_CHECK[1]:g} with restarts at events and steps of at"
        f" most {CROSS_CHECK[2] * 1e3:g} ms. The last column is the scene's own sensitivity: how many times a"
        " displacement of the surface returns in the finger's movement; errors of every solver grow likewise.",
        table(
            ["scene", "events", "theta, rad", "events, s", "missed/invented", "growth"],
            [
                [
                    f"{c.scene}, {'closed' if c.closed else 'open'}",
                    c.events,
                    f"{c.scipy.theta_rad:.0e}",
                    f"{c.scipy.event_s:.0e}",
                    f"{c.scipy.missed}/{c.scipy.invented}",
                    _two(c.growth),
                ]
                for c in found.checks
            ],
        ),
        "## Every point",
        f"scipy: longest step {MAX_STEP_S * 1e3:g} ms, compiled right-hand side. Last column: events missed/invented.",
        *(
            f"### {scene}, loop {'closed' if closed else 'open'}\n\n"
            + table(
                [
                    "solver",
                    "step or tolerance",
                    "us/s",
                    "x real time",
                    "theta, rad",
                    "events, s",
                    "events lost",
                ],
                list(_point_rows(found.points, scene, closed)),
            )
            for scene, closed in scenes
        ),
    ]
    return "\n\n".join(parts) + "\n"
