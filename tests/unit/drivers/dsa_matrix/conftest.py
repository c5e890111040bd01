"""The matrices' driver on emulated matrices, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from drivers.dsa_matrix.driver import DsaMatrixSettings
from simulator.devices.dsa_matrix import EmulatedDsaMatrix, EmulatedDsaMatrixSettings
from simulator.physics.fingertip_settings import Matrix
from tests.unit.drivers.dsa_matrix.dsa_bench import Bench, Host, Ramp

BEGIN_S = 5000.0
"""Monotonic time at which the bench begins: the host has been up for a while."""


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """`make_bench(matrices=[…], emulated={…}, …driver's settings)`; not yet open."""

    def made(
        matrices: Sequence[Matrix] = (Matrix(14, 5, 0.0034),),
        emulated: dict[str, Any] | None = None,
        **driver: Any,
    ) -> Bench:
        source = Ramp(matrices)
        host = Host(EmulatedDsaMatrix(EmulatedDsaMatrixSettings(**(emulated or {})), source), BEGIN_S)
        return Bench(host, source, DsaMatrixSettings(port="/dev/dsa", **driver))

    return made


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """Open matrices, 70 cells, 50 raw frames a second."""
    made = make_bench(frame_hz=50, rle=False)
    made.driver.open()
    return made
