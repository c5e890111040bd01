"""Run time against error of the finger, beside its strongest rivals: `python -m benchmarks physics`.

The reference is the tests' (`tests/stability/finger_oracles.py`: eigenvectors to 40 digits, nothing of the plant's).
results/physics.md keeps an earlier run with more rivals, among them scipy's and MuJoCo.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.physics.dynamics import constants, motion_table
from benchmarks.physics.located import located
from benchmarks.physics.model import (
    DURATION_S,
    KINDS,
    Difference,
    Scene,
    Solver,
    Trajectory,
    difference,
    scenes,
)
from benchmarks.physics.timing import Work, side_by_side_s
from benchmarks.results import save
from drivers.mock.physics.finger import FingerPlant
from tests.stability.finger_oracles import modal

EXACT, RK4, ORDER_8 = "exact pieces", "RK4, events located", "order 8, events located"

ORDERS = {RK4: 4, ORDER_8: 8}

EVENTS_PER_S = 4000
"""Room for events; what needs more has gone astray."""


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


def reference(scene: Scene) -> Trajectory:
    """theta on the grid and all events, to 40 digits."""
    switches, theta_rad = modal(
        scene.settings,
        pieces=scene.motion,
        gap_m=scene.gap_m,
        until_s=scene.duration_s,
        samples_s=scene.times_s.tolist(),
    )
    return _trajectory(theta_rad, switches)


def _trajectory(theta_rad: Sequence[float], switches: Sequence[tuple[float, str]]) -> Trajectory:
    events = {kind: np.array([t for t, name in switches if name == kind]) for kind in KINDS}
    return Trajectory(np.array(theta_rad), events)


def exact(scene: Scene) -> Solver:
    """The plant through the bench's seam, timed with 1 kHz output, periods and contacts; events and theta come from
    a run that asks for them."""
    plant, times_s = FingerPlant(scene.settings), scene.times_s

    def begin() -> None:
        plant.begin(key=(0, 0), gap_m=scene.gap_m)
        plant.excite(True)
        plant.move_probe(scene.motion)

    def run() -> None:
        plant.advance(scene.duration_s, frozenset({"accelerometer", "period"}))
        plant.periods()
        plant.contacts()
        plant.sample("accelerometer", times_s)

    def result() -> Trajectory:
        begin()
        theta_rad = []
        for t in times_s:
            plant.advance(float(t), frozenset({"switches"}))
            theta_rad.append(plant.theta_rad)
        return _trajectory(theta_rad, plant.switches())

    return Solver(run, result, begin)


def compiled_rival(scene: Scene, method: str, substeps: int) -> Solver:
    """A compiled method that locates events, with steps of 1 ms / `substeps`.

    Raises:
        ArithmeticError: when its result is asked for and it went astray: more events than can be.
    """
    c, motion, outputs = constants(scene), motion_table(scene.motion), scene.times_s.size
    room = int(EVENTS_PER_S * scene.duration_s) + 64
    theta, times, codes = np.empty(outputs), np.empty(room), np.empty(room, dtype=np.int64)
    counted = 0

    def run() -> None:
        nonlocal counted
        counted = located(c, motion, outputs, substeps, ORDERS[method], theta, times, codes)

    def result() -> Trajectory:
        if counted < 0:
            raise ArithmeticError(f"{method} at {1e-3 / substeps:g} s: more events than can be")
        return Trajectory.from_codes(theta.copy(), times[:counted], codes[:counted])

    return Solver(run, result)


def solvers(scene: Scene) -> Iterator[tuple[str, str, Solver]]:
    """Each with its name and its setting."""
    yield EXACT, "", exact(scene)
    for method, finest in ((RK4, 7), (ORDER_8, 2)):
        for substeps in (2**k for k in range(finest + 1)):
            yield method, f"{1e3 / substeps:g} us", compiled_rival(scene, method, substeps)


def compare(*, quick: bool = False) -> Iterator[Point]:
    """Solve and time everything; quick: closed loop alone, 1.2 s."""
    for closed in (True,) if quick else (True, False):
        for scene in scenes(closed=closed, duration_s=1.2 if quick else DURATION_S):
            truth = reference(scene)
            every = list(solvers(scene))
            taken_s = side_by_side_s([Work(solver.run, solver.begin) for _, _, solver in every])
            for (name, setting, solver), run_s in zip(every, taken_s, strict=True):
                off = difference(truth, solver.result())
                yield Point(scene.name, closed, name, setting, run_s / scene.duration_s * 1e6, off)


def cost_at(points: Sequence[Point], error: float) -> float:
    """What a solver costs at an error: on the straight line, in logarithms, between its nearest settings.

    Args:
        points: Of one solver on one scene.
        error: In s for events and in rad for theta, whichever is larger.

    Returns:
        CPU time per simulated second in us; that of its cheapest setting where even that is better; infinity where none
        of its settings is good enough with every event found.
    """
    good = sorted((p for p in points if p.whole and math.isfinite(p.error)), key=lambda p: p.us_per_s)
    best = next((p for p in good if p.error <= error), None)
    if best is None:
        return math.inf
    worse = [p for p in good if p.us_per_s < best.us_per_s]
    if not worse:
        return best.us_per_s
    near = worse[-1]
    share = math.log(near.error / error) / math.log(near.error / best.error)
    return near.us_per_s * math.pow(best.us_per_s / near.us_per_s, share)


def ratios(points: Sequence[Point]) -> list[dict[str, Any]]:
    """How many times longer than the exact pieces the rivals take at equal error, a row a scene."""
    rows = []
    for scene, closed in dict.fromkeys((p.scene, p.closed) for p in points):
        here = [p for p in points if (p.scene, p.closed) == (scene, closed)]
        (ours,) = [p for p in here if p.solver == EXACT]
        row = {"scene": scene, "closed": closed, "exact_us_per_s": ours.us_per_s, "error": ours.error}
        for solver, error in ((RK4, 1e-9), (RK4, 1e-12), (ORDER_8, 1e-12)):
            cost = cost_at([p for p in here if p.solver == solver], error)
            row[f"{solver} at {error:g}"] = cost / ours.us_per_s
        rows.append(row)
    return rows


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    points = []
    for p in compare(quick=quick):
        points.append(p)
        lost = "" if p.whole else f"{p.off.missed} missed, {p.off.invented} invented"
        print(
            f"{p.scene:13} {p.solver:24} {p.setting:>10} {p.us_per_s:12,.0f} us/s  {p.error:.0e} {lost}",
            flush=True,
        )
    rows = [{**p._asdict(), "off": p.off._asdict()} for p in points]
    save("physics", {"ratios": ratios(points), "points": rows}, quick=quick)


if __name__ == "__main__":
    main("--quick" in sys.argv)
