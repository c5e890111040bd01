"""The plant itself, through the seam that the bench uses."""

from __future__ import annotations

import numpy as np

from benchmarks.physics.model import KINDS, Floats, Scene, Trajectory
from benchmarks.physics.timing import cpu_s
from drivers.mock.physics.finger import FingerPlant, FingerSettings

READ = frozenset({"accelerometer", "period"})
"""Channels that are read in what is timed."""


def begin(plant: FingerPlant, scene: Scene) -> None:
    """Put a plant to the scene's start."""
    plant.begin(key=(0, 0), gap_m=scene.gap_m)
    plant.excite(True)
    plant.move_probe(scene.motion)


def read(plant: FingerPlant, scene: Scene, times_s: Floats) -> Floats:
    """What is timed: the whole scene with 1 kHz output, the drive's periods and the contacts.

    Args:
        plant: At the scene's start.
        scene: The scene.
        times_s: The output's grid, shape (n,).

    Returns:
        The accelerometer on the grid, shape (n,).
    """
    plant.advance(scene.duration_s, READ)
    plant.periods()
    plant.contacts()
    return plant.sample("accelerometer", times_s)


def taken_s(scene: Scene, settings: FingerSettings | None = None) -> float:
    """CPU time of `read`, in s."""
    plant, times_s = FingerPlant(settings or scene.settings), scene.times_s
    return cpu_s(lambda: read(plant, scene, times_s), before=lambda: begin(plant, scene))


def set_up_s(scene: Scene) -> float:
    """CPU time of `begin`, in s."""
    plant = FingerPlant(scene.settings)
    return cpu_s(lambda: begin(plant, scene))


def solve(scene: Scene) -> Trajectory:
    """theta on the grid and all events."""
    plant, theta_rad = FingerPlant(scene.settings), []
    begin(plant, scene)
    for t in scene.times_s:
        plant.advance(float(t), frozenset({"switches"}))
        theta_rad.append(plant.theta_rad)
    switches = plant.switches()
    return Trajectory(
        np.array(theta_rad), {kind: np.array([t for t, name in switches if name == kind]) for kind in KINDS}
    )
