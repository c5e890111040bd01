"""Run time against error: every solver on every scene, side by side in one process."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

from benchmarks.physics import mujoco_rival, ours, references, rivals, scipy_rivals
from benchmarks.physics.model import DURATION_S, Difference, Scene, Solver, Trajectory, difference, scenes
from benchmarks.physics.timing import Work, side_by_side_s
from drivers.mock.physics.finger import FingerPlant

EXACT = "exact pieces"
"""Our tier."""

RK4, ORDER_8, _, EULER = rivals.METHODS

CROSS_CHECK = ("DOP853", 3e-14, 1e-4)
"""What the reference is checked with: one of scipy's at its smallest tolerance, in steps (s) that see every touch."""

NUDGE = 1e-9
"""Relative change of the gap by which a scene's sensitivity is measured."""


class Point(NamedTuple):
    """One solver at one setting on one scene."""

    scene: str
    closed: bool
    solver: str
    setting: str
    us_per_s: float
    """CPU time per simulated second."""
    off: Difference

    @property
    def whole(self) -> bool:
        """Whether it has every event of the reference and no other."""
        return self.off.missed == 0 and self.off.invented == 0

    @property
    def error(self) -> float:
        """What is compared: the larger of the error of events in s and of theta in rad."""
        return max(self.off.event_s, self.off.theta_rad)


class Check(NamedTuple):
    """A reference, and how far scipy is from it."""

    scene: str
    closed: bool
    events: int
    scipy: Difference
    growth: float
    """How many times theta's movement (at the contact, in m) exceeds a displacement of the surface that causes it."""


def _steps(substeps: int) -> str:
    return f"{1e3 / substeps:g} us"


def _compiled(scene: Scene) -> Iterator[tuple[str, str, Solver]]:
    for method in rivals.METHODS:
        every = (1, 2, 4) if method == ORDER_8 else (1, 2, 4, 8, 16, 32, 64, 128)
        for substeps in every if method in rivals.LOCATED else (1, 4, 16, 64, 256, 1024):
            yield method, _steps(substeps), rivals.prepared(scene, method, substeps)


def _others(scene: Scene, closed: bool, quick: bool) -> Iterator[tuple[str, str, Solver]]:
    for method in scipy_rivals.METHODS:
        if quick and method != "DOP853":
            continue
        for tolerance in (1e-6, 1e-9) if method == "Radau" or quick else (1e-6, 1e-9, 1e-12):
            yield f"scipy {method}", f"{tolerance:g}", scipy_rivals.prepared(scene, method, tolerance)
    for method in mujoco_rival.METHODS:
        most = 100 if method == "RK4" else 1000
        for substeps in (1, 10, 100, 1000):
            if substeps <= (10 if quick else most if closed else 100):
                yield f"MuJoCo {method}", _steps(substeps), mujoco_rival.prepared(scene, method, substeps)


def _exact(scene: Scene) -> tuple[str, str, Solver]:
    """The plant: timed with 1 kHz output; all events, and theta on the grid, come from a run that asks for them."""
    plant, times_s = FingerPlant(scene.settings), scene.times_s
    run, begin = partial(ours.read, plant, scene, times_s), partial(ours.begin, plant, scene)
    return EXACT, "", Solver(run, partial(ours.solve, scene), begin)


def _check(scene: Scene, closed: bool, reference: Trajectory) -> Check:
    events = sum(times.size for times in reference.events.values())
    nudged = references.solve(dataclasses.replace(scene, gap_m=scene.gap_m * (1.0 + NUDGE)))
    moved_m = difference(reference, nudged).theta_rad * scene.parameters.arm
    checked = difference(reference, scipy_rivals.solve(scene, *CROSS_CHECK))
    return Check(scene.name, closed, events, checked, moved_m / (scene.gap_m * NUDGE))


def compare(*, quick: bool = False) -> Iterator[Point | Check]:
    """Solve and time everything; quick: closed loop alone, one second, no Radau, few small steps."""
    for closed in (True,) if quick else (True, False):
        for scene in scenes(closed=closed, duration_s=1.2 if quick else DURATION_S):
            reference = references.solve(scene)
            if not quick:
                yield _check(scene, closed, reference)
            # what is fast is timed in turns; the others, too slow for that, one by one
            alone = [[other] for other in _others(scene, closed, quick)]
            for solvers in ([_exact(scene), *_compiled(scene)], *alone):
                taken_s = side_by_side_s([Work(solver.run, solver.begin) for _, _, solver in solvers])
                for (name, setting, solver), run_s in zip(solvers, taken_s, strict=True):
                    us_per_s = run_s / scene.duration_s * 1e6
                    off = difference(reference, solver.result())
                    yield Point(scene.name, closed, name, setting, us_per_s, off)


def cost_at(points: Sequence[Point], error: float, of: Callable[[Point], float] = lambda p: p.error) -> float:
    """What a solver costs at an error: on the straight line, in logarithms, between its nearest settings.

    Args:
        points: Of one solver on one scene.
        error: In s for events and in rad for theta, whichever is larger, or what `of` takes.
        of: The error of a point.

    Returns:
        CPU time per simulated second in us; that of its cheapest setting where even that is better; infinity where none
        of its settings is good enough with every event found.
    """
    good = sorted((p for p in points if p.whole and math.isfinite(of(p))), key=lambda p: p.us_per_s)
    enough = [p for p in good if of(p) <= error]
    if not enough:
        return math.inf
    best = enough[0]
    worse = [p for p in good if p.us_per_s < best.us_per_s]
    if not worse:
        return best.us_per_s
    near = worse[-1]
    share = math.log(of(near) / error) / math.log(of(near) / of(best))
    return near.us_per_s * math.pow(best.us_per_s / near.us_per_s, share)
