"""The matrices' driver on emulated matrices, in virtual time: a link without a port."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from simulator.devices.dsa_matrix import EmulatedDsaMatrix
from simulator.physics.fingertip_settings import Matrix
from tests.contracts.matrix_suite import MatrixBench
from tests.steady import SteadyTexels
from tests.unit.drivers.far_end import FarClock, FarEnd


class Ramp(SteadyTexels):
    """Each cell reads its number in millivolts; the first reads host time, 10 ms a count."""

    def __init__(self, matrices: Sequence[Matrix]) -> None:
        super().__init__(matrices, np.arange(sum(matrix.rows * matrix.columns for matrix in matrices)) * 1e-3)

    def texels_v(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        texels_v = super().texels_v(times_s)
        texels_v[:, 0] = times_s % 40.0 * 0.1
        return texels_v


class Bench(MatrixBench):
    """Driver, emulated matrices, what they feel; closed."""

    def __init__(self, source: Any, emulated: dict[str, Any] | None = None, **driver: Any) -> None:
        self.source = source
        self.far = FarEnd(EmulatedDsaMatrix(source, 115_200, **(emulated or {})))
        self.far.device.step(self.far.t_s)
        clock = FarClock(self.far)
        settings = DsaMatrixSettings(port="/dev/dsa", **driver)
        super().__init__(DsaMatrix("dsa", settings, clock, self.far.connect), clock, opens=False)

    def frames(self) -> int:
        return sum(map(len, self.blocks))


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """`make_bench(matrices=[…], emulated={…}, …driver's settings)`; not yet open."""

    def made(matrices: Sequence[Matrix] = (Matrix(14, 5, 0.0034),), **settings: Any) -> Bench:
        return Bench(Ramp(matrices), **settings)

    return made


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """Open matrices, 70 cells, 50 raw frames a second."""
    made = make_bench(frame_hz=50, rle=False)
    made.device.open()
    return made
