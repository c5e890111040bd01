"""A force sensor's box and a Robotiq gripper on lines: real drivers, emulated far ends."""

import socket
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import WallClock
from drivers.core.messages import Failed, Gripped, Listen, Lost, Tare
from drivers.robotiq.driver import Robotiq
from drivers.robotiq.settings import RobotiqSettings
from drivers.udp_force.driver import UdpForce, UdpForceSettings
from simulator.devices.robotiq import EmulatedRobotiq
from simulator.devices.udp_force import EmulatedUdpForce
from simulator.wiring.far_ends import UdpLine
from tests.contracts.crank import Crank
from tests.contracts.gripper_suite import CLOSED_M, GRIP, GripperBench, calibrated_jaws
from tests.contracts.test_a_new_sensor import Weighed
from tests.wire.conftest import Serve


def test_a_push_on_the_tool_is_read(serve: Serve) -> None:
    given: dict[str, Any] = {"normal": "-z"}
    line = UdpLine(EmulatedUdpForce(UdpForceSettings(host="-", **given), Weighed()))
    where = dict(line.endpoint)
    line.endpoint = {**where, "port": where["host"]}  # the bench knows its far ends by their ports
    serve.wire(line)
    crank = Crank(UdpForce("ft", UdpForceSettings(**given | where), serve.clock), serve.clock)
    crank.listen("ft.force", "ft.normal")
    crank.turn(2.0)
    assert not crank.of(Lost)
    times_s = crank.times("ft.normal")
    assert len(times_s) == pytest.approx(2000, rel=0.02)
    # in the first second the line under the arrivals settles
    assert np.diff(times_s)[1100:] == pytest.approx(1e-3, abs=2e-4)
    assert crank.blocks_of("ft.normal")[-1].physical[-1] == pytest.approx([1.5])
    assert crank.blocks_of("ft.force")[-1].physical[-1][2] == pytest.approx(-1.5)
    crank.device.apply(Tare("ft", "ft.normal"))
    crank.turn(0.2)
    assert crank.blocks_of("ft.normal")[-1].physical[-1] == pytest.approx([0.0])
    crank.device.close()


def test_an_object_is_gripped_over_tcp_and_a_server_that_hangs_up_is_a_failure() -> None:
    drive, lock, over = calibrated_jaws(), threading.Lock(), threading.Event()
    widths = {"closed_width_m": CLOSED_M, "open_width_m": 0.068}
    twin = EmulatedRobotiq(RobotiqSettings(port="-", **widths), SimpleNamespace(jaws=drive))
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with server.accept()[0] as connection:
            connection.settimeout(0.01)
            while not over.is_set():
                try:
                    data = connection.recv(4096)
                except TimeoutError:
                    continue
                with lock:
                    answer = twin.receive(data, time.monotonic())
                connection.sendall(answer)

    thread = threading.Thread(target=serve)
    thread.start()
    where = f"socket://127.0.0.1:{server.getsockname()[1]}"
    settings = RobotiqSettings(port=where, reply_timeout_s=10.0, **widths)  # the machine may be busy

    def change(scene: object) -> None:
        with lock:
            scene(drive)

    bench = GripperBench(Robotiq("gripper", settings, WallClock()), WallClock(), change)
    bench.place("mug")
    bench.device.apply(Listen("gripper", frozenset({"gripper.width"})))
    bench.device.apply(GRIP)
    gripped = bench.until(Gripped)
    assert gripped.object
    assert abs(gripped.width_m - 0.039) < 0.3e-3
    assert bench.blocks_of("gripper.width")
    over.set()
    thread.join(10.0)
    assert "taken away" in bench.until(Failed).reason
    bench.device.close()
    server.close()
