"""The serial link on ptys: what comes, what goes, and every way in which a port can be missing."""

import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest
import serial
import serial.rfc2217

from drivers.core.clock import WallClock
from drivers.core.errors import PortError
from drivers.core.links import SerialLink, SerialPort, open_serial
from drivers.zaber_stage.driver import ZaberStage
from drivers.zaber_stage.mounting import ZaberStageSettings
from tests.refusals import refused
from tests.unit.drivers.zaber_stage.stage_bench import Wire
from tests.wire.open_ends import OpenEnd, eventually


@pytest.fixture
def pty() -> Iterator[OpenEnd]:
    opened = OpenEnd()
    yield opened
    opened.hang_up()


@pytest.fixture
def link(pty: OpenEnd) -> Iterator[SerialLink]:
    opened = open_serial("stage", SerialPort(port=pty.path), WallClock())
    yield opened
    opened.close()


def test_bytes_arrive_whole_and_with_the_time_of_their_arrival(pty: OpenEnd, link: SerialLink) -> None:
    before_s = time.monotonic()
    os.write(pty.master, bytes(range(256)))
    got: list[tuple[float, bytes]] = []

    def whole() -> bool:
        got.extend(link.receive())
        return sum(len(data) for _, data in got) == 256

    assert eventually(whole)
    assert b"".join(data for _, data in got) == bytes(range(256))
    assert all(before_s <= arrival_s <= time.monotonic() for arrival_s, _ in got)
    assert link.receive() == []


def test_what_is_sent_is_on_the_wire_and_the_time_of_it_is_given(pty: OpenEnd, link: SerialLink) -> None:
    before_s = time.monotonic()
    sent_s = link.send(b"stop\n")
    assert os.read(pty.master, 100) == b"stop\n"
    assert sent_s is not None
    assert before_s <= sent_s <= time.monotonic()


def test_a_port_that_is_taken_away_is_a_fault_and_no_exception(pty: OpenEnd, link: SerialLink) -> None:
    pty.hang_up()
    assert eventually(lambda: link.fault is not None)
    assert "taken away" in str(link.fault)
    assert link.send(b"stop\n") is None
    assert link.receive() == []


def test_a_port_that_takes_no_more_bytes_is_a_fault_and_does_not_hold_the_caller(link: SerialLink) -> None:
    for _ in range(10_000):
        if link.send(b"x" * 40) is None:
            break
    assert "takes no more bytes" in str(link.fault)


def test_closing_twice_is_allowed_and_ends_the_thread(pty: OpenEnd) -> None:
    link = open_serial("stage", SerialPort(port=pty.path), WallClock())
    link.close()
    link.close()
    assert not link._reader.is_alive()
    assert link.send(b"x") is None


def test_a_port_that_is_absent_says_where_to_look() -> None:
    with pytest.raises(PortError, match=r"^stage: /dev/ttyNONE does not exist .*ls /dev/serial/by-id$"):
        open_serial("stage", SerialPort(port="/dev/ttyNONE"), WallClock())


def test_a_port_that_another_program_holds_says_how_to_find_it(pty: OpenEnd, link: SerialLink) -> None:
    with pytest.raises(PortError, match=f"held by another program .*fuser -v {pty.path}$"):
        open_serial("stage", SerialPort(port=pty.path), WallClock())


@pytest.mark.parametrize("path", ["/dev/null", "/", __file__])
def test_what_is_no_serial_port_is_called_so(path: str) -> None:
    with pytest.raises(PortError, match="is no serial port"):
        open_serial("stage", SerialPort(port=path), WallClock())


class Far:
    """A serial server on this machine: one connection, and what it does with it."""

    def __init__(self, serves: Callable[[socket.socket], None]) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.where = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._serves = serves
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        with self._server.accept()[0] as connection:
            self._serves(connection)

    def end(self) -> None:
        self._thread.join(10.0)
        self._server.close()


def echoed_by_rfc2217(connection: socket.socket) -> None:
    """pyserial's own server of RFC 2217 before a line that is looped back."""
    line = serial.serial_for_url("loop://", timeout=0)
    server = serial.rfc2217.PortManager(line, connection_of(connection))
    connection.settimeout(0.01)
    while True:
        try:
            data = connection.recv(4096)
            if not data:
                break
            line.write(b"".join(server.filter(data)))
        except TimeoutError:
            pass
        except OSError:
            break
        connection.sendall(b"".join(server.escape(line.read(line.in_waiting))))
    line.close()


def connection_of(connection: socket.socket) -> Any:
    return SimpleNamespace(write=connection.sendall)


def test_bytes_of_all_values_pass_a_serial_server_of_rfc_2217() -> None:
    far = Far(echoed_by_rfc2217)
    link = open_serial("board", SerialPort(port=f"rfc2217://{far.where}", dtr=False), WallClock())
    got = b""

    def whole() -> bool:
        nonlocal got
        got += b"".join(data for _, data in link.receive())
        return len(got) == 256

    assert link.send(bytes(range(256))) is not None
    assert eventually(whole)
    assert got == bytes(range(256))
    link.close()
    link.close()
    far.end()


# pyserial's own: where the far end is gone already, its `close` forgets the socket, and leaves it to the collector
@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")
def test_a_stage_behind_a_serial_server_of_bare_bytes_is_opened_and_its_end_is_noticed() -> None:
    wire = Wire(homed=True)
    going = threading.Event()
    going.set()

    def stage(connection: socket.socket) -> None:
        connection.settimeout(0.01)
        while going.is_set():
            with suppress(TimeoutError):
                connection.sendall(wire.receive(connection.recv(4096), time.monotonic()))

    far = Far(stage)
    settings = ZaberStageSettings(port=f"socket://{far.where}", retry_s=1.0, reply_timeout_s=5.0)
    device = ZaberStage("stage", settings, WallClock())
    assert device.open().serial == "40001"
    going.clear()
    far.end()
    statuses: list[Any] = []
    assert eventually(lambda: bool(statuses.extend(device.poll()) or statuses))
    assert "taken away" in statuses[0].reason
    device.close()


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
def test_a_serial_server_that_is_not_there_is_a_port_error(scheme: str) -> None:
    with refused(PortError, "stage", f"{scheme}://127.0.0.1:1", "refused", "its server"):
        open_serial("stage", SerialPort(port=f"{scheme}://127.0.0.1:1"), WallClock())


def test_a_connection_that_the_server_has_reset_is_closed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        where = SerialPort(port=f"socket://127.0.0.1:{server.getsockname()[1]}")
        link = open_serial("gripper", where, WallClock())
        far, _ = server.accept()
        far.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        far.close()
    assert eventually(lambda: link.send(b"?") is None)
    connected: Any = vars(link._port)["_socket"]
    link.close()
    assert "taken away" in str(link.fault)
    assert connected.fileno() == -1
