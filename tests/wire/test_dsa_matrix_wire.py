"""The real matrices' driver with real pyserial on a pty, an emulated controller at its far end."""

import numpy as np
import pytest

from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from simulator.devices.dsa_matrix import EmulatedDsaMatrix
from simulator.physics.fingertip_settings import Matrix
from tests.contracts.matrix_suite import TEXELS, MatrixBench
from tests.steady import SteadyTexels
from tests.wire.conftest import Serve, Wired

PATIENT = {"reply_timeout_s": 0.5, "silence_timeout_s": 3.0, "power_up_s": 2.0}
"""The machine may be busy with other tests."""


def test_raw_frames_of_70_cells_fill_the_line_75_times_a_second(serve: Serve) -> None:
    cells = SteadyTexels([Matrix(14, 5, 0.0034)], np.arange(70) * 0.05)
    wired = Wired(serve, EmulatedDsaMatrix(cells, 115_200))
    driver = DsaMatrix(
        "dsa", DsaMatrixSettings(port=wired.port, rle=False, frame_hz=75, **PATIENT), wired.clock
    )
    bench = MatrixBench(driver, wired.clock)
    try:
        assert bench.info.details["raw_limit_hz"] == pytest.approx(75.3, abs=0.05)
        bench.listen(TEXELS)
        bench.turn(1.0)
        assert sum(map(len, bench.blocks)) > 50
        assert bench.blocks[-1].values[-1, 69] == 3450
    finally:
        driver.close()
