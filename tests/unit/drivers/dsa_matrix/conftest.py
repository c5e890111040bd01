"""The matrices' driver on emulated matrices, in virtual time."""

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from simulator.physics.fingertip_settings import Matrix
from tests.unit.drivers.dsa_matrix.dsa_bench import Bench, Ramp


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
