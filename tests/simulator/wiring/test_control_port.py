"""Strangers at the emulator's ports: requests that are none, hosts that reset or never read; for all that serve."""

import json
import select
import socket
import struct
from collections.abc import Iterator
from typing import Any

import pytest

from simulator.wiring.emulator import CLIENTS, LINE_BYTES, ControlPort, Request
from simulator.wiring.far_ends import UNREAD_BYTES, TcpLine

PATIENCE_S = 10.0
"""Loopback takes microseconds; a busy machine only takes its time."""

RESET_AT_CLOSE = struct.pack("ii", 1, 0)


class Desk:
    """A port whose plant breaks at trial 13."""

    def __init__(self) -> None:
        self.done: list[Request] = []
        self.port = ControlPort(self._answer)

    def _answer(self, request: Request) -> dict[str, Any]:
        if request.trial == 13:
            raise RuntimeError("the plant broke")
        self.done.append(request)
        return {"account": {"done": len(self.done)}}

    def client(self) -> socket.socket:
        where = self.port.endpoint
        client = socket.create_connection((where["host"], where["port"]), timeout=PATIENCE_S)
        self.serve()
        return client

    def serve(self) -> None:
        """One turn, as soon as there is something to do."""
        ready, _, _ = select.select(self.port.sockets, [], [], PATIENCE_S)
        assert ready, "nothing came"
        self.port.attend(ready)

    def ask(self, client: socket.socket, line: bytes) -> dict[str, Any]:
        client.sendall(line + b"\n")
        while not select.select([client], [], [], 0.0)[0]:
            self.serve()
        answer: dict[str, Any] = json.loads(client.makefile("rb").readline())
        return answer


@pytest.fixture
def desk() -> Iterator[Desk]:
    one = Desk()
    yield one
    one.port.close()


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"stop!", "JSON"),
        (b"\xff\xfe", "JSON"),
        (b"[]", "object"),
        (b'{"trial":' + b"[" * 5000, "JSON"),
        (b'{"trial": 1}', "seed, factors, plant"),
        (b'{"trial": "1", "seed": 0, "factors": {}, "plant": {}}', "trial"),
        (b'{"trial": -1, "seed": 0, "factors": {}, "plant": {}}', "trial"),
        (b'{"fault": {"device": "stage", "kind": "explode", "at_s": 0}}', "fault.kind"),
        (b'{"fault": {"device": "stage", "kind": "stall", "at_s": NaN}}', "fault.at_s"),
        (b'{"coffee": true}', "coffee"),
        (b'{"trial": 13, "seed": 0, "factors": {}, "plant": {}}', "the plant broke"),
    ],
)
def test_a_request_that_is_none_is_refused_with_a_reason_and_the_next_one_is_answered(
    desk: Desk, line: bytes, reason: str
) -> None:
    client = desk.client()
    assert reason in desk.ask(client, line)["refused"]
    assert not desk.done
    assert desk.ask(client, b"{}") == {"account": {"done": 1}}
    client.close()


def test_a_trial_arrives_whole_in_however_many_pieces_it_comes(desk: Desk) -> None:
    client = desk.client()
    line = b'{"trial": 2, "seed": 7, "factors": {"location": "a"}, "plant": {"gain": 1.5}}\n{}\n'
    for k in range(0, len(line), 20):
        client.sendall(line[k : k + 20])
        desk.serve()
    first, second = desk.done
    assert (first.trial, first.seed, first.factors, first.plant) == (2, 7, {"location": "a"}, {"gain": 1.5})
    assert second.trial is None
    client.close()


def test_a_client_whose_line_has_no_end_is_dropped_at_the_limit(desk: Desk) -> None:
    client, other = desk.client(), desk.client()
    sent = 0
    client.setblocking(False)
    while len(desk.port.sockets) == 3:
        sent += client.send(b"x" * 65536)
        desk.serve()
    assert LINE_BYTES <= sent < 2 * LINE_BYTES + (1 << 23)
    assert desk.ask(other, b"{}") == {"account": {"done": 1}}
    client.close()
    other.close()


def test_a_client_that_is_reset_with_answers_pending_is_dropped(desk: Desk) -> None:
    client, other = desk.client(), desk.client()
    client.sendall(b"{}\n" * 100)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_CLOSE)
    client.close()
    while len(desk.port.sockets) == 3:
        desk.serve()
    assert "account" in desk.ask(other, b"{}")
    other.close()


def test_a_client_that_never_reads_is_dropped(desk: Desk) -> None:
    client = desk.client()
    client.setblocking(False)
    while len(desk.port.sockets) == 2:
        client.send(b"{}\n" * 1000)
        desk.serve()
    client.close()


def test_clients_beyond_the_last_place_are_hung_up_on(desk: Desk) -> None:
    clients = [desk.client() for _ in range(CLIENTS)]
    late = desk.client()
    assert late.recv(1) == b""
    assert "account" in desk.ask(clients[0], b"{}")
    clients.pop().close()
    desk.serve()
    clients.append(desk.client())
    assert "account" in desk.ask(clients[-1], b"{}"), "a place that was left is free"
    for one in [*clients, late]:
        one.close()


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
