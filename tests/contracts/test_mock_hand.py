"""The mock hand keeps the hands' promises, in virtual time; its faults."""

from typing import Any

import pytest

from drivers.core.clock import VirtualClock
from drivers.core.messages import Failed, Lost, Saturated, Status
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.barrett_hand import MockBarrettHand, MockBarrettHandSettings
from tests.contracts.hand_suite import F1, FORCES_N, HandBench, HandContract
from tests.steady import SteadyForces


def opened(*faults: dict[str, Any]) -> HandBench:
    clock = VirtualClock()
    schedule = FaultSchedule([Fault(device="hand", **fault) for fault in faults])
    return HandBench(
        MockBarrettHand("hand", MockBarrettHandSettings(), clock, SteadyForces(FORCES_N), schedule), clock
    )


@pytest.fixture
def bench() -> HandBench:
    return opened()


class TestMockHand(HandContract):
    pass


def test_the_mock_hand_loses_nothing(bench: HandBench) -> None:
    bench.listen(F1)
    bench.turn(1.0)
    assert sum(map(len, bench.blocks_of(F1))) == 1000
    assert bench.statuses == []


@pytest.mark.parametrize(
    ("kind", "status"), [("unplug", Failed), ("lose", Lost), ("corrupt", Lost), ("full_scale", Saturated)]
)
def test_faults_are_reported(kind: str, status: type[Status]) -> None:
    bench = opened({"kind": kind, "at_s": 0.1, "for_s": 0.1})
    bench.listen(F1)
    bench.turn(0.3)
    assert {type(one) for one in bench.statuses} == {status}


def test_a_silent_hand_says_nothing() -> None:
    bench = opened({"kind": "silent", "at_s": 0.0})
    bench.listen(F1)
    bench.turn(0.3)
    assert bench.blocks == []
    assert bench.statuses == []
