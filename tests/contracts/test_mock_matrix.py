"""The mock matrices keep the matrices' promises, in virtual time; their faults."""

from typing import Any

import pytest

from drivers.core.clock import VirtualClock
from drivers.core.messages import Failed, Lost, Saturated, Status
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.dsa_matrix import MockDsaMatrix, MockDsaMatrixSettings
from tests.contracts.matrix_suite import TEXELS, MatrixBench, MatrixContract, steady


def opened(*faults: dict[str, Any]) -> MatrixBench:
    clock = VirtualClock()
    schedule = FaultSchedule([Fault(device="dsa", **fault) for fault in faults])
    scene = steady()
    return MatrixBench(MockDsaMatrix("dsa", MockDsaMatrixSettings(), clock, scene, schedule), clock)


@pytest.fixture
def bench() -> MatrixBench:
    return opened()


class TestMockMatrix(MatrixContract):
    pass


def test_the_mock_matrices_lose_nothing(bench: MatrixBench) -> None:
    bench.listen(TEXELS)
    bench.turn(2.0)
    assert sum(map(len, bench.blocks)) == 200
    assert bench.of(Lost) == []


@pytest.mark.parametrize(("kind", "status"), [("unplug", Failed), ("lose", Lost), ("full_scale", Saturated)])
def test_faults_are_reported(kind: str, status: type[Status]) -> None:
    bench = opened({"kind": kind, "at_s": 0.1, "for_s": 0.1})
    bench.listen(TEXELS)
    bench.turn(0.3)
    assert bench.of(status)
