"""What a sensor feels where nothing ever changes: the simplest sources of emulated devices."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.physics import finger_scene as scene
from simulator.physics.finger import FingerPlant
from simulator.physics.fingertip_settings import Matrix


class SteadyForces:
    """Forces that never change: the simplest source.

    Args:
        forces_n: By finger; none where none is given.
    """

    def __init__(self, forces_n: Mapping[int, float]) -> None:
        self._forces_n = dict(forces_n)

    def advance(self, t_s: float) -> None:
        """Nothing changes."""

    def forces_n(self, finger: int, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same at all times."""
        return np.full(len(times_s), self._forces_n.get(finger, 0.0))


class SteadyTexels:
    """Texels that never change: the simplest source.

    Args:
        matrices: What is connected.
        texels_v: What they read, shape (cells,).
    """

    def __init__(self, matrices: Sequence[Matrix], texels_v: NDArray[np.float64]) -> None:
        self._matrices = tuple(matrices)
        self._texels_v = texels_v

    def matrices(self) -> Sequence[Matrix]:
        """As they were given."""
        return self._matrices

    def advance(self, t_s: float) -> None:
        """Nothing changes."""

    def texels_v(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same at all times."""
        return np.tile(self._texels_v, (len(times_s), 1))


def energy_j(plant: FingerPlant) -> float:
    """Mechanical energy of a finger now, the contact's spring left out."""
    x, s = plant.state(), plant.settings
    kinetic = s.inertia_kg_m2 * x[scene.OMEGA] ** 2 + s.base_inertia_kg_m2 * x[scene.BASE_RATE] ** 2
    bent = plant.finger.joint * (x[scene.THETA] - x[scene.BASE]) ** 2
    return float(0.5 * (kinetic + bent + s.base_n_m_rad * x[scene.BASE] ** 2))
