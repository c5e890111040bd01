"""Where emulated devices meet the host: what a fault does to a line and to a controller, and when."""

import math
import os
import socket

import pytest

from drivers.core.clock import WallClock
from simulator.devices.faults import Fault, FaultSchedule
from simulator.devices.ur_controller.controller import Runtime, Safety, UrController, UrControllerSettings
from simulator.devices.ur_controller.server import DASHBOARD_PORT, UrServer
from simulator.wiring.far_ends import Line

NOW_S = 100.0
"""The emulator has been up for a while: faults count from the trial's beginning all the same."""


class Talker:
    """Sends a message at every step; remembers what was done to it."""

    def __init__(self) -> None:
        self.received = b""
        self.broken: list[tuple[str, float]] = []

    def receive(self, data: bytes, t_s: float) -> bytes:
        self.received += data
        return b""

    def step(self, t_s: float) -> bytes:
        return b"abcdefgh"

    def inject(self, kind: str, t_s: float) -> None:
        self.broken.append((kind, t_s))
        raise ValueError("it cannot")


class Host:
    """The near end of a line."""

    def __init__(self, *faults: Fault) -> None:
        self.device = Talker()
        self.line = Line(self.device)
        self.line.open(FaultSchedule(faults), WallClock())
        self.port = os.open(self.line.endpoint["port"], os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)

    def at(self, trial_s: float) -> bytes:
        """What comes in one exchange."""
        self.line.exchange(self.line.waited(), NOW_S, trial_s)
        try:
            return os.read(self.port, 100)
        except BlockingIOError:
            return b""

    def close(self) -> None:
        os.close(self.port)
        self.line.unplug()


@pytest.fixture
def host():
    hosts: list[Host] = []

    def make(*faults: Fault) -> Host:
        hosts.append(Host(*faults))
        return hosts[-1]

    yield make
    for one in hosts:
        one.close()


def test_a_line_is_in_use_while_bytes_pass_it_and_a_controller_while_it_has_a_client(host):
    one, network = (
        host(Fault(device="d", kind="silent", at_s=5.0)),
        UrServer(UrController(UrControllerSettings())),
    )
    assert one.line.exchange([], NOW_S, 0.0) and not one.line.exchange([], NOW_S, 6.0)
    os.write(one.port, b"?")
    assert one.line.exchange(one.line.waited(), NOW_S, 7.0)
    network.open(FaultSchedule(), WallClock())
    try:
        assert not network.exchange([], NOW_S, 0.0) and network.due_s() == math.inf
        with socket.create_connection((network.endpoint["host"], DASHBOARD_PORT)):
            network.exchange([], NOW_S, 0.0)
            assert network.exchange([], NOW_S, 0.0) and network.due_s() < math.inf
    finally:
        network.unplug()


def test_a_timed_fault_counts_from_the_beginning_of_the_trial(host):
    one = host(Fault(device="d", kind="silent", at_s=5.0, for_s=1.0))
    assert [one.at(trial_s) for trial_s in (4.9, 5.0, 5.9, 6.0)] == [b"abcdefgh", b"", b"", b"abcdefgh"]


def test_a_device_breaks_on_its_own_clock_and_one_that_cannot_does_not(host):
    one = host(Fault(device="d", kind="stall", at_s=2.0))
    one.at(1.9)
    assert one.device.broken == []
    assert one.at(2.1) == b"abcdefgh"
    assert one.device.broken == [("stall", NOW_S)]


def test_bytes_are_lost_or_altered_on_the_wire(host):
    assert host(Fault(device="d", kind="lose", at_s=0.0)).at(1.0) == b""
    spoilt = host(Fault(device="d", kind="corrupt", at_s=0.0)).at(1.0)
    assert spoilt == b"abct" + b"efgh", "one bit of every seventh byte"


def test_a_pulled_plug_leaves_nothing_to_wait_for(host):
    one = host(Fault(device="d", kind="unplug", at_s=1.0))
    assert one.at(0.5)
    one.line.exchange(one.line.waited(), NOW_S, 1.0)
    assert one.line.waited() == []
    with pytest.raises(OSError, match=r"Input/output error|I/O"):
        os.write(one.port, b"x")


@pytest.fixture
def network():
    made: list[UrServer] = []

    def make(*faults: Fault) -> UrServer:
        made.append(UrServer(UrController(UrControllerSettings())))
        made[-1].open(FaultSchedule(faults), WallClock())
        return made[-1]

    yield make
    for one in made:
        one.unplug()


def test_two_controllers_find_two_addresses(network):
    first, second = network(), network()
    assert first.endpoint["host"] != second.endpoint["host"]
    with socket.create_connection((second.endpoint["host"], DASHBOARD_PORT), 1.0) as client:
        second.exchange((), NOW_S, 0.0)
        assert client.recv(100).startswith(b"Connected: Universal Robots")


def test_a_silent_controller_sends_and_receives_nothing_for_a_while(network):
    server = network(Fault(device="arm", kind="silent", at_s=1.0, for_s=1.0))
    seen = []
    for trial_s in (0.5, 1.5, 2.5):
        server.exchange((), NOW_S, trial_s)
        seen.append((server.streams, server.deaf))
    assert seen == [(True, False), (False, True), (True, False)]


def test_a_stall_is_a_protective_stop(network):
    server = network(Fault(device="arm", kind="stall", at_s=1.0))
    server.controller.start_program(0)
    server.exchange((), NOW_S, 0.9)
    assert server.controller.runtime is Runtime.PLAYING
    server.exchange((), NOW_S, 1.0)
    assert (server.controller.safety, server.controller.runtime) == (Safety.PROTECTIVE_STOP, Runtime.STOPPED)


def test_a_refusal_is_local_control(network):
    server = network(Fault(device="arm", kind="refuse", at_s=1.0))
    server.controller.start_program(0)
    server.exchange((), NOW_S, 1.0)
    assert (server.controller.remote, server.controller.runtime) == (False, Runtime.STOPPED)


def test_a_controller_without_a_plug_answers_no_client(network):
    server = network(Fault(device="arm", kind="unplug", at_s=0.0))
    host = server.endpoint["host"]
    server.exchange((), NOW_S, 0.0)
    assert server.waited() == []
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((host, DASHBOARD_PORT), 1.0)
