"""The force sensor's box over loopback: real datagrams, the twin's clock."""

from typing import Any

import numpy as np
import pytest

from drivers.core.messages import Failed, Lost, Tare
from drivers.udp_force.driver import UdpForce, UdpForceSettings
from simulator.devices.faults import Fault, FaultSchedule
from simulator.devices.udp_force import EmulatedUdpForce
from simulator.wiring.far_ends import UdpLine
from tests.contracts.crank import Crank
from tests.contracts.test_a_new_sensor import Weighed
from tests.wire.conftest import Serve


def opened(serve: Serve, *faults: Fault, **given: Any) -> Crank:
    line = UdpLine(EmulatedUdpForce(given, Weighed()))
    where = dict(line.endpoint)
    line.endpoint = {**where, "port": where["host"]}  # the bench knows its far ends by their ports
    serve.wire(line, FaultSchedule(faults))
    settings = UdpForceSettings(**given | where)
    return Crank(UdpForce("ft", settings, serve.clock), serve.clock)


@pytest.mark.parametrize("normal", ["-z", "+x"])
def test_a_push_on_the_tool_is_read_through_a_wrap_of_its_clock(serve: Serve, normal: str) -> None:
    crank = opened(serve, normal=normal)
    crank.listen("ft.force", "ft.normal")
    crank.turn(6.0)
    assert not crank.of(Lost)
    times_s = np.concatenate([block.times for block in crank.blocks_of("ft.normal")])
    assert len(times_s) == pytest.approx(6000, rel=0.02)
    # in the first second the line under the arrivals settles
    assert np.diff(times_s)[1100:] == pytest.approx(1e-3, abs=2e-4)
    assert crank.blocks_of("ft.normal")[-1].physical[-1] == pytest.approx([1.5])
    axis = "xyz".index(normal[1])
    pushed = 1.5 if normal[0] == "+" else -1.5
    assert crank.blocks_of("ft.force")[-1].physical[-1][axis] == pytest.approx(pushed)
    crank.device.apply(Tare("ft", "ft.normal"))
    crank.turn(0.2)
    assert crank.blocks_of("ft.normal")[-1].physical[-1] == pytest.approx([0.0])
    crank.device.close()


def test_lost_datagrams_are_counted_and_silence_ends_it(serve: Serve) -> None:
    faults = (
        Fault(device="ft", kind="lose", at_s=1.0, for_s=0.1),
        Fault(device="ft", kind="unplug", at_s=2.0),
    )
    crank = opened(serve, *faults)
    crank.listen("ft.normal")
    crank.turn(3.0)
    assert sum(lost.samples for lost in crank.of(Lost)) == pytest.approx(100, abs=10)
    (failed,) = crank.of(Failed)
    assert "no record" in failed.reason
    crank.device.close()
