"""The driver of analog inputs on its emulated twin, in virtual time."""

from typing import Any

import numpy as np
import pytest

from controller.limits import GuardSettings
from drivers.core.clock import VirtualClock
from drivers.core.messages import Saturated
from drivers.ni_daq.settings import NiDaqSettings
from simulator.devices.faults import FaultSchedule
from simulator.mocks.ni_daq import MockNiDaq
from simulator.physics.bench import StreamSpec
from tests.contracts.crank import Crank

STREAMS: dict[str, Any] = {
    "force": {"inputs": ("ai0", "ai1"), "unit": "N", "scale": -2.0, "offset": 0.5, "shows": ("one", "two")},
    "turns": {"inputs": ("ctr0",), "unit": "N", "counts": "edges", "shows": ("many",)},
}


class Waves:
    """A bench whose streams rise and fall once a second: to 1 N, to 18 N, to 1000 N."""

    origin_s = 0.0

    def streams(self) -> list[StreamSpec]:
        return [StreamSpec(name, (name,), "N", 1.0, 1000.0) for name in ("one", "two", "many")]

    def read(self, key: str, sources: frozenset[str]) -> None:
        pass

    def advance(self, t_s: float) -> None:
        pass

    def sample(self, source: str, times_s: Any) -> Any:
        most = {"one": 1.0, "two": 18.0, "many": 1000.0}[source]
        return most * np.sin(2.0 * np.pi * times_s)


def daq(range_v: float) -> Crank:
    settings = NiDaqSettings(port="mock", rate_hz=1000.0, range_v=range_v, streams=STREAMS)
    clock, bench = VirtualClock(), Waves()
    return Crank(MockNiDaq("daq", settings, clock, bench, FaultSchedule(())), clock)


def test_an_input_at_the_end_of_the_range_that_was_taken_is_saturated_once_an_excursion() -> None:
    crank = daq(range_v=3.0)
    assert crank.info.details["range_v"] == (-5.0, 5.0), "the next wider one that it has"
    crank.listen("daq.force", "daq.turns")
    crank.turn(2.0)
    found = crank.of(Saturated)
    assert {each.stream for each in found} == {"daq.force"}
    # 99 % of 5 V, at 0.5 V of offset, are 10.9 N, and -8.9 N at the other end
    begins_s = [np.arcsin(10.9 / 18.0) / (2.0 * np.pi), 0.5 + np.arcsin(8.9 / 18.0) / (2.0 * np.pi)]
    assert [each.t_s for each in found] == pytest.approx(
        [*begins_s, *(1.0 + begin_s for begin_s in begins_s)], abs=0.005
    )
    assert [each.value for each in found] == pytest.approx([10.9, -8.9] * 2, abs=0.2)
    # listened to anew, a stream that is still at the end is reported again
    crank.turn(0.25)
    crank.take(Saturated)
    crank.listen()
    crank.listen("daq.force")
    crank.turn(0.02)
    assert len(crank.of(Saturated)) == 1


def test_nothing_is_saturated_inside_the_range() -> None:
    crank = daq(range_v=10.0)
    crank.listen("daq.force", "daq.turns")
    crank.turn(2.0)
    assert crank.of(Saturated) == []


@pytest.mark.parametrize(("force_n", "keys"), [(10.9, []), (11.0, ["force_n"])])
@pytest.mark.parametrize("stream", ["daq.force", "daq.turns", "other.force", "none"])
def test_a_force_limit_beyond_the_range_of_its_input_would_never_act(
    stream: str, force_n: float, keys: list[str]
) -> None:
    """5 V and 0.5 V of offset are 11 N at 2 N/V."""
    settings = NiDaqSettings(port="Dev1", rate_hz=1000.0, range_v=5.0, streams=STREAMS)
    limits = GuardSettings(
        travel_m=0.01, force_stream=None if stream == "none" else stream, force_n=force_n, retreat_n=12.0
    )
    found = [*settings.mismatches(("devices", "daq"), {("limits",): limits})]
    expected = [*keys, "retreat_n"] if stream == "daq.force" else []
    assert [each.key for each in found] == expected
    assert all("ends at 11 N" in each.mistake for each in found)
