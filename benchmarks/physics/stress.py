"""The stress sweep: contact stiffness 1e2 to 1e9 N/m by damping 0 to 1e6 N s/m, every event and theta by the reference.

The long twin of tests/stability. Scenes are short: a probe at 20 mm/s meets the finger after 5 ms.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from benchmarks.physics import ours, references
from benchmarks.physics.model import Difference, Motion, Scene, difference

STIFFNESSES_N_M = (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)

DAMPINGS_N_S_M = (0.0, 1e-2, 1.0, 1e2, 1e4, 1e6)

GAP_M = 1e-4

APPROACH: Motion = ((0.0, 0.0, 0.02, 0.0),)

DURATION_S = 0.1

EVENT_BOUND_S, THETA_BOUND_RAD = 1e-12, 1e-13
"""What is asked of every cell."""


class Cell(NamedTuple):
    """One scene of the sweep and how the plant did."""

    stiffness_n_m: float
    damping_n_s_m: float
    closed: bool
    events: int
    """Contacts made and lost, and edges, in the reference."""
    contacts: int
    """Contacts made."""
    off: Difference

    @property
    def met(self) -> bool:
        """Whether the bounds hold."""
        exact = self.off.missed == 0 and self.off.invented == 0
        return exact and self.off.event_s <= EVENT_BOUND_S and self.off.theta_rad <= THETA_BOUND_RAD


def scene(stiffness_n_m: float, damping_n_s_m: float, *, closed: bool) -> Scene:
    """One scene of the sweep."""
    name = f"{stiffness_n_m:g} N/m, {damping_n_s_m:g} N s/m"
    changes = {"pad_n_m": stiffness_n_m, "contact_n_s_m": damping_n_s_m}
    return Scene(name, GAP_M, APPROACH, DURATION_S, closed, changes)


def cell(stiffness_n_m: float, damping_n_s_m: float, *, closed: bool) -> Cell:
    """Solve one scene by the plant and by the reference."""
    problem = scene(stiffness_n_m, damping_n_s_m, closed=closed)
    reference = references.solve(problem)
    return Cell(
        stiffness_n_m,
        damping_n_s_m,
        closed,
        sum(times.size for times in reference.events.values()),
        reference.events["made"].size,
        difference(reference, ours.solve(problem)),
    )


def sweep(*, quick: bool = False) -> Iterator[Cell]:
    """Every cell, closed and open loop; quick: the corners and the middle, closed."""
    every = 3 if quick else 1
    for closed in (True,) if quick else (True, False):
        for stiffness in STIFFNESSES_N_M[::every]:
            for damping in DAMPINGS_N_S_M[::every]:
                yield cell(stiffness, damping, closed=closed)
