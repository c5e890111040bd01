"""The controller on its ports: a client that breaks a rule is dropped with a reason, and the others are served."""

import math
import random
import select
import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from simulator.devices.ur_controller import rtde
from simulator.devices.ur_controller.controller import Runtime, Safety, UrController, UrControllerSettings
from simulator.devices.ur_controller.rtde import PackageKind
from simulator.devices.ur_controller.server import (
    DASHBOARD_PORT,
    HOSTS,
    RTDE_PORT,
    UNREAD_BYTES,
    UrServer,
)
from simulator.devices.ur_controller.session import RtdeSession
from tests.simulator.devices.ur_desk import Desk, desk

PATIENCE_S = 10.0
"""Loopback takes microseconds; a busy machine only takes its time."""

GREETING = b"Connected: Universal Robots Dashboard Server\n"


class Bench:
    def __init__(self) -> None:
        self.server = UrServer(UrController(UrControllerSettings()))
        self.server.listen(HOSTS)
        self.clients: list[socket.socket] = []
        self.now_s = self.server.next_s

    def client(self, port: int) -> socket.socket:
        client = socket.create_connection((self.server.host, port), timeout=PATIENCE_S)
        self.clients.append(client)
        self.turn()
        return client

    def turn(self, steps: int = 0) -> None:
        """Handle what has come, and let cycles pass."""
        self.now_s += steps * 0.002
        self.server.turn(PATIENCE_S if not steps else 0.0, self.now_s - 1e-4)

    def serves(self) -> bool:
        """Whether a new client of the dashboard is answered."""
        client = self.client(DASHBOARD_PORT)
        client.sendall(b"robotmode\n")
        self.turn()
        lines = client.makefile("rb")
        return lines.readline() == GREETING and lines.readline() == b"Robotmode: RUNNING\n"

    @property
    def log(self) -> str:
        return " | ".join(self.server.controller.log)


@pytest.fixture
def bench() -> Iterator[Bench]:
    one = Bench()
    yield one
    for client in one.clients:
        client.close()
    one.server.unplug()


def is_gone(client: socket.socket) -> bool:
    try:
        while client.recv(65536):
            pass
    except ConnectionResetError:
        pass
    return True


def outputs(names: bytes, rate_hz: float = 500.0) -> bytes:
    return rtde.encode(PackageKind.OUTPUTS, struct.pack(">d", rate_hz) + names)


@pytest.mark.parametrize(
    ("port", "data", "reason"),
    [
        (RTDE_PORT, b"\x00\x02\x56", "a package of 2 bytes"),
        (RTDE_PORT, b"\x00\x04\x4f\x00", "without a rate"),
        (DASHBOARD_PORT, b"x" * 2000, "a line of more than 1024 bytes"),
    ],
)
def test_a_client_that_breaks_the_protocol_is_dropped_with_a_reason(
    bench: Bench, port: int, data: bytes, reason: str
) -> None:
    client = bench.client(port)
    client.sendall(data)
    while reason not in bench.log:
        bench.turn()
    assert is_gone(client)
    assert bench.serves()


def test_a_client_that_never_reads_is_dropped_and_holds_little(bench: Bench) -> None:
    client = bench.client(RTDE_PORT)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.sendall(outputs(b",".join([b"target_q"] * 1000)) + rtde.encode(PackageKind.START))
    bench.turn()
    held = 0
    for _ in range(1000):
        bench.turn(steps=1)
        held = max([held, *map(len, bench.server._clients.unsent.values())])
        if "it does not read" in bench.log:
            break
    assert "it does not read" in bench.log
    assert held <= UNREAD_BYTES + 65536
    assert bench.serves()


def test_a_defect_costs_the_client_that_found_it_alone(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(session: RtdeSession, data: bytes) -> bytes:
        raise KeyError("a defect")

    monkeypatch.setattr(RtdeSession, "feed", broken)
    client = bench.client(RTDE_PORT)
    client.sendall(b"\x00\x03\x76")
    bench.turn()
    assert is_gone(client)
    assert "a client was dropped: KeyError: 'a defect'" in bench.log
    assert "a defect" in capsys.readouterr().err
    assert bench.serves()


def test_what_a_client_leaves_unread_is_sent_when_it_reads(bench: Bench) -> None:
    client = bench.client(RTDE_PORT)
    client.sendall(rtde.encode(PackageKind.CONTROLLER) * 10_000)
    answers = b""
    while len(answers) < 10_000 * 19:
        bench.turn(steps=1)
        if select.select([client], [], [], 0.0)[0]:
            answers += client.recv(65536)
    assert answers == rtde.version_reply([5, 11, 1, 108318]) * 10_000


HOSTILE = (0.0, 1e-310, 1e308, -1e308, math.nan, math.inf, -math.inf, -1.0, 100.0)
INTEGERS = (0, 1, 2, 7, -1, 2**31 - 1, -(2**31))
COMMANDS = (*range(75), 254, 255, -1)


def command(one: Desk, dice: random.Random) -> None:
    """A pose or joints, of whose numbers a few are hostile."""
    likely = [*one.controller.arm.pose.tolist(), *one.controller.arm.joints_rad.tolist(), 0.1, 0.5]
    numbers = likely[:6] if dice.random() < 0.5 else likely[6:12]
    numbers += [dice.choice(likely) for _ in range(12)]
    for place in range(len(numbers)):
        if dice.random() < 0.2:
            numbers[place] = dice.choice(HOSTILE)
    flags = [dice.choice(INTEGERS) for _ in range(7)]
    one.write(dice.choice(COMMANDS), numbers, flags=flags)


@pytest.mark.parametrize("seed", range(4))
def test_no_command_ends_the_controller_or_takes_its_arm_to_nowhere(seed: int) -> None:
    dice = random.Random(seed)
    one = desk(plane_m=0.17, unlock_s=0.0)
    controller = one.controller
    with np.errstate(all="ignore"):
        for _ in range(60):
            command(one, dice)
            one.run(dice.choice((1, 3, 20)))
            one.write(0)
            one.run(2)
            assert np.isfinite(controller.arm.joints_rad).all(), one.log
            assert np.isfinite(controller.arm.twist).all(), one.log
            if controller.safety is not Safety.NORMAL:
                controller.unlock()
            if controller.runtime is Runtime.STOPPED:
                controller.start_program(0)
