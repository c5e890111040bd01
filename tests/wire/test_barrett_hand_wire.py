"""The real hand driver with real python-can: slcan on a pty, an emulated hand at its far end."""

from collections.abc import Iterator
from typing import Any

import pytest

from drivers.barrett_hand.driver import BarrettHand, BarrettHandSettings
from drivers.barrett_hand.strain import FingerStrainSettings
from drivers.core.errors import SilentError
from simulator.devices.barrett_hand import EmulatedBarrettHand
from simulator.devices.slcan import EmulatedSlcan
from tests.contracts.hand_suite import FORCES_N, HandBench, HandContract
from tests.steady import SteadyForces
from tests.wire.conftest import Serve, Wired


class Wire(Wired):
    """A hand behind an adapter on a pty, and its driver."""

    def __init__(self, serve: Serve, **settings: Any) -> None:
        super().__init__(
            serve, EmulatedSlcan(EmulatedBarrettHand(FingerStrainSettings(), SteadyForces(FORCES_N)))
        )
        # No answer is late on a bench whose time waits for its threads, but a wire takes its time.
        patient = {"poll_hz": 200.0, "answer_timeout_s": 0.2, "silence_timeout_s": 2.0}
        given = BarrettHandSettings(port=self.port, **patient | settings)
        self.driver = BarrettHand("hand", given, self.clock)


@pytest.fixture
def wire(serve: Any) -> Iterator[Wire]:
    made = Wire(serve)
    yield made
    made.driver.close()


@pytest.fixture
def bench(wire: Wire) -> HandBench:
    return HandBench(wire.driver, wire.clock)


class TestWireHand(HandContract):
    pass


def test_open_reads_every_finger(bench: HandBench) -> None:
    readings = bench.info.details["readings_counts"]
    assert bench.info.details["woken"] == (11, 12, 13)
    bench.device.close()
    assert bench.device.open().details["woken"] == (), "it is awake"
    # 2 kg over 2048 counts: 1 N is 104.4 of them.
    assert readings == {11: 2104, 12: 1791, 13: 3880}


def test_a_finger_that_is_not_there_is_named(serve: Any) -> None:
    wire = Wire(serve, fingers=(11, 15), answer_timeout_s=0.05)
    with pytest.raises(SilentError, match=r"^hand: no answer in 2 s while asking finger 15"):
        wire.driver.open()
