"""What every solver is given and what it gives back: scenes, trajectories, and the error of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.mock.physics.finger import FingerSettings

Floats = NDArray[np.float64]

OUTPUT_HZ = 1000.0
"""Rate of the output that every solver has to give: the sensor board's."""

KINDS = ("made", "lost", "comparator_up", "comparator_down", "drive_up", "drive_down")
"""Events: contact made and lost, edges of the comparator and of the drive. The index is the solvers' code for them."""

MADE, LOST, COMPARATOR_UP, COMPARATOR_DOWN, DRIVE_UP, DRIVE_DOWN = range(len(KINDS))

MATCH_S = 2e-3
"""An event further than this from the reference's is another event: a sixteenth of a period of 28 Hz."""

OPEN_LOOP_HZ = 28.0
"""Frequency of the drive without the loop: the free resonance of the paper."""

Motion = tuple[tuple[float, float, float, float], ...]
"""The probe's plan: (start in s, position in m, velocity in m/s, acceleration in m/s^2), each until the next begins."""


@dataclass(frozen=True)
class Scene:
    """One problem: from rest, with the excitation switched on at t = 0, without noise, contact at location f.

    Attributes:
        name: Of the scene.
        gap_m: Distance of the probe from the finger at rest.
        motion: The probe's plan; its corners lie on the output's grid, so that no method stumbles over them.
        duration_s: Of the scene.
        closed: With the phase-locked loop; otherwise the drive runs at `OPEN_LOOP_HZ`.
        changes: Settings of the finger that differ from their defaults.
    """

    name: str
    gap_m: float
    motion: Motion
    duration_s: float
    closed: bool = True
    changes: Mapping[str, float] = field(default_factory=dict)

    @property
    def settings(self) -> FingerSettings:
        """Settings of the plant: no noise, and for the open loop an oscillator that does not listen."""
        # the settings want a range above zero: this one changes no bit of the frequency
        loop = {} if self.closed else {"oscillator_lowest_hz": OPEN_LOOP_HZ, "oscillator_range_hz": 1e-300}
        return FingerSettings.model_validate({"noise_scale": 0.0, **loop, **self.changes})

    @property
    def times_s(self) -> Floats:
        """The output's grid without t = 0, shape (n,)."""
        return np.arange(1, round(self.duration_s * OUTPUT_HZ) + 1) / OUTPUT_HZ


@dataclass(frozen=True)
class Trajectory:
    """What a solver made of a scene.

    Attributes:
        theta_rad: Angle of the distal link on the scene's grid, shape (n,).
        events: Times in s of every kind of event that the solver gives, ascending.
    """

    theta_rad: Floats
    events: Mapping[str, Floats]

    @classmethod
    def from_codes(cls, theta_rad: Floats, times_s: Floats, codes: NDArray[np.int64]) -> Trajectory:
        """From one list of events and the codes of their kinds (places in `KINDS`), shapes (n,) and (m,)."""
        return cls(theta_rad, {kind: times_s[codes == code] for code, kind in enumerate(KINDS)})


class Solver(NamedTuple):
    """A scene, ready to be solved."""

    run: Callable[[], object]
    """Solve it from its start: what is timed."""
    result: Callable[[], Trajectory]
    """What a run makes of it."""
    begin: Callable[[], object] = lambda: None
    """What has to be done before every run and is not timed."""


class Difference(NamedTuple):
    """How far a trajectory is from a reference."""

    theta_rad: float
    """Largest difference on the grid."""
    event_s: float
    """Largest difference of an event that both have."""
    missed: int
    """Events of the reference that the trajectory has not."""
    invented: int
    """Events of the trajectory that the reference has not."""


def matched(reference: Floats, found: Floats) -> tuple[Floats, int, int]:
    """Differences of events that belong together, and how many of either side have no partner.

    Equal numbers are compared in order, as long as no pair is further apart than `MATCH_S`. Otherwise two events
    belong together when each is the other's nearest and they are no further apart than that.
    """
    if reference.size == found.size and np.all(np.abs(reference - found) <= MATCH_S):
        return np.abs(found - reference), 0, 0
    if reference.size == 0 or found.size == 0:
        return np.empty(0), reference.size, found.size
    distance = np.abs(reference[:, None] - found[None, :])
    nearest, back = distance.argmin(axis=1), distance.argmin(axis=0)
    own = np.arange(reference.size)
    pairs = (back[nearest] == own) & (distance[own, nearest] <= MATCH_S)
    return distance[own, nearest][pairs], int(np.sum(~pairs)), found.size - int(np.sum(pairs))


def difference(reference: Trajectory, found: Trajectory, kinds: Sequence[str] = KINDS) -> Difference:
    """Compare a trajectory with a reference, in the kinds of events that it gives."""
    theta_rad = float(np.max(np.abs(reference.theta_rad - found.theta_rad)))
    event_s, missed, invented = 0.0, 0, 0
    for kind in kinds:
        if kind in found.events:
            errors, without, beyond = matched(reference.events[kind], found.events[kind])
            event_s = max(event_s, float(errors.max(initial=0.0)))
            missed += without
            invented += beyond
    return Difference(theta_rad if math.isfinite(theta_rad) else math.inf, event_s, missed, invented)


FREE: Motion = ((0.0, 0.0, 0.0, 0.0),)
"""The probe stays where it is."""

APPROACH: Motion = ((0.0, 0.0, 0.0, 0.0), (0.43, 0.0, 0.004843, 0.0))
"""After 0.43 s, in which the loop locks, at 4.843 mm/s (Table I, location f): it bounces from the first touch on."""

PRESS: Motion = ((0.0, 0.0, 0.1, 0.0), (0.22, 0.022, 0.0, 0.0))
"""22 mm at 0.1 m/s, then at rest: the finger stays pressed and rings with the pad."""


DURATION_S = 1.99
"""Of a scene. Neither its end nor a corner of the probe's plan is an edge of the open loop's drive."""


def scenes(*, closed: bool, duration_s: float = DURATION_S) -> tuple[Scene, ...]:
    """The three scenes of the comparison."""
    return (
        Scene("free", 5e-3, FREE, duration_s, closed),
        Scene("bouncing", 1e-3, APPROACH, duration_s, closed),
        Scene("full contact", 1e-3, PRESS, duration_s, closed),
    )
