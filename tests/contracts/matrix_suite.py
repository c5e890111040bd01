"""What tactile matrices promise: run for the mock driver and, on an emulated controller, for the real one."""

from itertools import pairwise

import numpy as np
import pytest

from drivers.core.messages import Excite, Listen, Lost, Saturated
from simulator.physics.fingertip_settings import Matrix
from tests.contracts.crank import Crank
from tests.contracts.sensor_suite import SensorContract
from tests.steady import SteadyTexels

SHAPES = (Matrix(2, 3, 0.0034), Matrix(1, 2, 0.0034))

TEXELS_V = np.array([0.0, 0.25, 1.5, 4.0, 0.0, 0.001, 5.0, 0.0])
"""What each cell reads; the seventh is beyond its end."""

TEXELS = "dsa.taxels"


def steady() -> SteadyTexels:
    return SteadyTexels(SHAPES, TEXELS_V)


class MatrixBench(Crank):
    """Matrices called `dsa`."""


class MatrixContract(SensorContract):
    """Subclasses give a fixture `bench` whose texels are `steady()`."""

    stream = TEXELS
    senseless = (Excite("dsa", True), Listen("dsa", frozenset({"dsa.force"})))

    def test_each_cell_of_each_matrix_is_a_channel(self, bench: MatrixBench) -> None:
        info = bench.info.streams[TEXELS]
        assert info.channels == (
            *("m0.r0.c0", "m0.r0.c1", "m0.r0.c2", "m0.r1.c0", "m0.r1.c1", "m0.r1.c2"),
            *("m1.r0.c0", "m1.r0.c1"),
        )
        assert (info.unit, info.scale) == ("V", 1e-3)

    def test_the_texels_are_read(self, bench: MatrixBench) -> None:
        bench.listen(TEXELS)
        bench.turn(0.4)
        assert sum(map(len, bench.blocks)) > 20
        expected = np.array([0.0, 0.25, 1.5, 4.0, 0.0, 0.001, 4.095, 0.0])
        for block in bench.blocks:
            assert block.physical == pytest.approx(np.tile(expected, (len(block), 1)))
            assert np.issubdtype(block.values.dtype, np.integer)
            assert block.device_t0_s is not None
            assert block.arrival_s is not None

    def test_blocks_follow_one_another_and_what_is_missing_is_reported(self, bench: MatrixBench) -> None:
        bench.listen(TEXELS)
        bench.turn(0.5)
        gaps = sum(after.seq - before.seq - len(before) for before, after in pairwise(bench.blocks))
        assert gaps == sum(lost.samples for lost in bench.of(Lost))
        assert all(after.t0_s > before.t0_s for before, after in pairwise(bench.blocks))

    def test_a_texel_at_its_end_is_reported_once(self, bench: MatrixBench) -> None:
        bench.listen(TEXELS)
        bench.turn(0.3)
        (saturated,) = bench.of(Saturated)
        assert (saturated.stream, saturated.value) == (TEXELS, pytest.approx(4.095))
