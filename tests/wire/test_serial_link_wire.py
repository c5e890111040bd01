"""The serial link on ptys: what comes, what goes, and every way in which a port can be missing."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from drivers.core.clock import WallClock
from drivers.core.errors import PortError
from drivers.core.links import SerialLink, SerialPort, open_serial


class Pty:
    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)

    def hang_up(self) -> None:
        for descriptor in (self.master, self.slave):
            if descriptor >= 0:
                os.close(descriptor)
        self.master = self.slave = -1


@pytest.fixture
def pty() -> Iterator[Pty]:
    opened = Pty()
    yield opened
    opened.hang_up()


@pytest.fixture
def link(pty: Pty) -> Iterator[SerialLink]:
    opened = open_serial("stage", SerialPort(port=pty.path), WallClock())
    yield opened
    opened.close()


def eventually(condition: Callable[[], bool]) -> bool:
    until_s = time.monotonic() + 5.0
    while not condition() and time.monotonic() < until_s:
        time.sleep(0.001)
    return condition()


def test_bytes_arrive_whole_and_with_the_time_of_their_arrival(pty: Pty, link: SerialLink) -> None:
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


def test_what_is_sent_is_on_the_wire_and_the_time_of_it_is_given(pty: Pty, link: SerialLink) -> None:
    before_s = time.monotonic()
    sent_s = link.send(b"stop\n")
    assert os.read(pty.master, 100) == b"stop\n"
    assert sent_s is not None
    assert before_s <= sent_s <= time.monotonic()


def test_a_port_that_is_taken_away_is_a_fault_and_no_exception(pty: Pty, link: SerialLink) -> None:
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


def test_closing_twice_is_allowed_and_ends_the_thread(pty: Pty) -> None:
    link = open_serial("stage", SerialPort(port=pty.path), WallClock())
    link.close()
    link.close()
    assert not link._reader.is_alive()
    assert link.send(b"x") is None


def test_a_port_that_is_absent_says_where_to_look() -> None:
    with pytest.raises(PortError, match=r"^stage: /dev/ttyNONE does not exist .*ls /dev/serial/by-id$"):
        open_serial("stage", SerialPort(port="/dev/ttyNONE"), WallClock())


def test_a_port_that_another_program_holds_says_how_to_find_it(pty: Pty, link: SerialLink) -> None:
    with pytest.raises(PortError, match=f"held by another program .*fuser -v {pty.path}$"):
        open_serial("stage", SerialPort(port=pty.path), WallClock())


@pytest.mark.parametrize("path", ["/dev/null", "/", __file__])
def test_what_is_no_serial_port_is_called_so(path: str) -> None:
    with pytest.raises(PortError, match="is no serial port"):
        open_serial("stage", SerialPort(port=path), WallClock())
