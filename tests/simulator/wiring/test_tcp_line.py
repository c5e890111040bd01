"""A device on the network: a host that resets, leaves or never reads costs nothing but its own connection."""

import select
import socket
import struct
from collections.abc import Iterator

import pytest

from simulator.wiring.far_ends import UNREAD_BYTES, TcpLine

PATIENCE_S = 10.0
"""Loopback takes microseconds; a busy machine only takes its time."""

RESET_AT_CLOSE = struct.pack("ii", 1, 0)


class Echo:
    """Answers each byte with a hundred, and streams nothing."""

    def __init__(self) -> None:
        self.lossy = False
        self.hung_up = 0

    def receive(self, data: bytes, t_s: float) -> bytes:
        return data * 100

    def step(self, t_s: float) -> bytes:
        return b""

    def hang_up(self, t_s: float) -> None:
        self.hung_up += 1

    def inject(self, kind: str, t_s: float) -> None:
        raise ValueError(kind)


class Bench:
    def __init__(self) -> None:
        self.device = Echo()
        self.line = TcpLine(self.device)

    def host(self) -> socket.socket:
        address, port = self.line.endpoint["port"].removeprefix("tcp:").split(":")
        host = socket.create_connection((address, int(port)), timeout=PATIENCE_S)
        self.turn()
        return host

    def turn(self) -> None:
        ready, _, _ = select.select(self.line.waited(), [], [], PATIENCE_S)
        self.line.exchange(ready, 0.0, 0.0)


@pytest.fixture
def bench() -> Iterator[Bench]:
    one = Bench()
    yield one
    one.line.unplug()


def test_a_host_that_resets_its_connection_leaves_the_line_to_the_next(bench: Bench) -> None:
    host = bench.host()
    host.sendall(b"hello")
    host.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_CLOSE)
    host.close()
    assert bench.line.unread() is False
    while not bench.device.hung_up:
        bench.turn()
    with bench.host() as other:
        other.sendall(b"x")
        bench.turn()
        assert other.recv(100) == b"x" * 100


def test_a_host_that_asks_and_never_reads_is_hung_up_on(bench: Bench) -> None:
    host = bench.host()
    host.setblocking(False)
    held = 0
    while not bench.device.hung_up:
        host.send(b"y" * 4096)
        bench.turn()
        held = max(held, sum(map(len, bench.line._clients.unsent.values())))
    assert held < UNREAD_BYTES + 200 * 4096
    host.close()
    with bench.host() as other:
        other.sendall(b"x")
        bench.turn()
        assert other.recv(100) == b"x" * 100
