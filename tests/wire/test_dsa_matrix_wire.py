"""The real matrices' driver with real pyserial on a pty, an emulated controller at its far end."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from simulator.devices.dsa_matrix import EmulatedDsaMatrix, EmulatedDsaMatrixSettings
from simulator.physics.fingertip_settings import Matrix
from tests.contracts.matrix_suite import TEXELS, MatrixBench, MatrixContract, steady
from tests.steady import SteadyTexels
from tests.wire.conftest import Serve, Wired

PATIENT = {"reply_timeout_s": 0.5, "silence_timeout_s": 3.0, "power_up_s": 2.0}
"""The machine may be busy with other tests."""


class Wire(Wired):
    """Matrices on a pty, and their driver."""

    def __init__(self, serve: Serve, source: Any, **settings: Any) -> None:
        super().__init__(serve, EmulatedDsaMatrix(EmulatedDsaMatrixSettings(), source))
        given = DsaMatrixSettings(port=self.port, **PATIENT | settings)
        self.driver = DsaMatrix("dsa", given, self.clock)


@pytest.fixture
def wire(serve: Any) -> Iterator[Wire]:
    made = Wire(serve, steady())
    yield made
    made.driver.close()


@pytest.fixture
def bench(wire: Wire) -> MatrixBench:
    return MatrixBench(wire.driver, wire.clock)


class TestWireMatrix(MatrixContract):
    pass


def test_raw_frames_of_70_cells_fill_the_line_75_times_a_second(serve: Any) -> None:
    cells = SteadyTexels([Matrix(14, 5, 0.0034)], np.arange(70) * 0.05)
    wire = Wire(serve, cells, rle=False, frame_hz=75)
    bench = MatrixBench(wire.driver, wire.clock)
    try:
        assert bench.info.details["raw_limit_hz"] == pytest.approx(75.3, abs=0.05)
        bench.listen(TEXELS)
        bench.turn(1.0)
        assert sum(map(len, bench.blocks)) > 50
        assert bench.blocks[-1].values[-1, 69] == 3450
    finally:
        wire.driver.close()
