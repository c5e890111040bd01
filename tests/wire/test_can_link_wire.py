"""The CAN link with real python-can: slcan on ptys, the virtual bus, and every way in which a bus can be missing."""

import os
import select
import termios
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import can
import pytest

from drivers.core.can_frame import CanFrame
from drivers.core.can_link import CanLink, CanPort, PeriodicQuestion, ReceivedFrame, open_can
from drivers.core.clock import WallClock
from drivers.core.errors import PortError
from simulator.devices.slcan import EmulatedSlcan
from tests.refusals import refused
from tests.wire.open_ends import OpenEnd, eventually

ASK = CanFrame(0x100, b"\x01")


class Echo:
    """Answers 0x100 as 0x101 with the number of the question, unless set to be quiet or late."""

    def __init__(self) -> None:
        self.asked = 0
        self.received_s: list[float] = []
        self.quiet: set[int] = set()
        self.late: set[int] = set()
        self._waiting: list[CanFrame] = []

    def receive(self, frame: CanFrame, t_s: float) -> Sequence[CanFrame]:
        number, self.asked = self.asked, self.asked + 1
        self.received_s.append(t_s)
        answer = CanFrame(frame.id + 1, number.to_bytes(2, "big") + frame.data)
        waiting, self._waiting = self._waiting, []
        if number in self.quiet:
            return waiting
        if number in self.late:
            self._waiting = [answer]
            return waiting
        return [*waiting, answer]

    def step(self, t_s: float) -> Sequence[CanFrame]:
        return ()

    def inject(self, kind: str, t_s: float) -> None:
        raise ValueError(kind)


def gathered(link: CanLink, count: int) -> list[ReceivedFrame]:
    received: list[ReceivedFrame] = []

    def enough() -> bool:
        received.extend(link.receive())
        return len(received) >= count

    assert eventually(enough), received
    return received


@pytest.fixture
def line() -> Iterator[OpenEnd]:
    opened = OpenEnd()
    yield opened
    opened.hang_up()


@pytest.fixture
def link(line: OpenEnd) -> Iterator[CanLink]:
    opened = open_can("gripper", CanPort(port=line.path), WallClock())
    yield opened
    opened.close()


def test_a_question_is_answered_through_an_adapter(serve: Any) -> None:
    link = open_can("gripper", CanPort(port=serve(EmulatedSlcan(Echo()))), serve.clock)
    try:
        before_s = serve.clock.monotonic_s()
        sent_s = link.send(ASK)
        (received,) = gathered(link, 1)
        assert received.frame == CanFrame(0x101, b"\x00\x00\x01")
        assert sent_s is not None
        assert before_s <= sent_s
        assert before_s <= received.arrival_s <= serve.clock.monotonic_s()
        assert (received.cycle, received.due_s) == (None, None)
    finally:
        link.close()


def test_the_adapter_is_given_the_bit_rate_and_opened(line: OpenEnd, link: CanLink) -> None:
    written = b""
    while not written.endswith(b"O\r"):  # a pty hands on in pieces
        written += os.read(line.master, 100)
    assert b"S8\r" in written


def test_what_is_no_frame_is_counted_and_the_next_one_is_received(line: OpenEnd, link: CanLink) -> None:
    line.send(b"t?782AABB\r")  # no number: ValueError in python-can
    line.send(b"t07\r")  # too short: IndexError
    line.send(b"t0784AABB\r")  # two bytes of four: passes in python-can
    line.send(b"T000000780\r")  # extended
    line.send(b"\a")  # refused: dropped without a report
    line.send(b"t0782AABB\r")
    (received,) = gathered(link, 1)
    assert received.frame == CanFrame(0x78, b"\xaa\xbb")
    assert link.malformed == 4
    assert link.fault is None


def test_noise_does_not_deafen_it(line: OpenEnd, link: CanLink) -> None:
    line.send(b"\xff\xfe\r")  # no text: python-can keeps it in its buffer
    assert eventually(lambda: link.malformed > 0)
    time.sleep(0.05)
    line.send(b"t0782AABB\r")
    assert gathered(link, 1)[0].frame == CanFrame(0x78, b"\xaa\xbb")


def test_a_frame_may_come_in_pieces(line: OpenEnd, link: CanLink) -> None:
    line.send(b"t0782A")
    time.sleep(0.05)
    line.send(b"ABB\rr0780\r")
    first, second = gathered(link, 2)
    assert first.frame == CanFrame(0x78, b"\xaa\xbb")
    assert second.frame == CanFrame(0x78, remote=True)


def test_an_adapter_that_is_taken_away_is_a_fault_and_no_exception(line: OpenEnd, link: CanLink) -> None:
    line.hang_up()
    assert eventually(lambda: link.fault is not None)
    assert link.send(ASK) is None
    assert link.receive() == []
    link.close()


def test_an_adapter_that_takes_no_more_bytes_is_a_fault_and_blocks_no_caller(
    line: OpenEnd, link: CanLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever a port can be waited with is watched, so that the machine's speed does not matter."""
    waits: list[str] = []

    def watch(module: Any, name: str) -> None:
        wait, here = getattr(module, name), threading.get_ident()

        def watched(*arguments: Any) -> Any:
            if threading.get_ident() == here:  # the link's own thread may wait for what comes
                waits.append(name)
            return wait(*arguments)

        monkeypatch.setattr(module, name, watched)

    watch(select, "select")
    watch(termios, "tcdrain")
    watch(time, "sleep")
    frames = 0
    while link.send(CanFrame(0x7A, bytes(8))) is not None:
        frames += 1
        assert frames < 3000, "it takes all there is"
    assert frames > 10
    assert "takes no frame (the adapter takes no more bytes)" in str(link.fault)
    assert waits == []


def test_closing_twice_is_allowed_and_ends_the_thread(line: OpenEnd) -> None:
    link = open_can("gripper", CanPort(port=line.path), WallClock())
    link.close()
    link.close()
    assert not link._thread.is_alive()
    assert link.send(ASK) is None


def test_an_interface_that_is_absent_is_a_port_error_in_one_line() -> None:
    with pytest.raises(PortError, match="see: ip link show can99") as error:
        open_can("gripper", CanPort(port="can99", interface="socketcan"), WallClock())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("interface", "named"),
    [("vector", ("vector 0", "python-can's documentation")), ("nix", ("no interface nix", "kvaser"))],
)
def test_an_adapter_whose_library_is_missing_or_that_nobody_knows_is_a_port_error(
    interface: str, named: tuple[str, ...]
) -> None:
    with refused(PortError, "hand", *named):
        open_can("hand", CanPort(port="0", interface=interface), WallClock())


def test_every_adapter_that_python_can_knows_is_asked_for_by_its_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: dict[str, Any] = {}

    def bus(interface: str, **given: Any) -> Any:
        asked[interface] = given
        raise can.CanError("no library here")

    monkeypatch.setattr(can, "Bus", bus)
    known = can.VALID_INTERFACES - {"slcan", "socketcan"}  # which are opened otherwise, and tested above
    for name in known:
        with refused(PortError, "hand", name, "no library here", "python-can's documentation"):
            open_can("hand", CanPort(port="3", interface=name, options={"index": 1}), WallClock())
    assert {"pcan", "kvaser", "gs_usb"} <= set(asked) == known
    wanted = {"channel": 3, "bitrate": CanPort(port="3").bitrate, "index": 1, "ignore_config": True}
    assert all(given == wanted for given in asked.values())


@pytest.mark.parametrize(
    "port",
    [
        CanPort(port="bench of two", interface="virtual", options={"rx_queue_size": 100}),
        CanPort(port="239.74.163.2", interface="udp_multicast", options={"port": 43_713, "hop_limit": 0}),
    ],
    ids=["virtual", "udp_multicast"],
)
def test_two_links_speak_on_a_bus_without_an_adapter(port: CanPort) -> None:
    one, other = open_can("one", port, WallClock()), open_can("other", port, WallClock())
    try:
        one.send(ASK)
        other.send(CanFrame(0x32, remote=True))
        assert gathered(other, 1)[0].frame == ASK
        own = port.interface == "udp_multicast"  # which hears itself
        assert gathered(one, 1 + own)[-1].frame == CanFrame(0x32, remote=True)
    finally:
        one.close()
        other.close()


def polled(serve: Any, echo: Echo, frames: int, answer_s: float = 0.1) -> list[ReceivedFrame]:
    link = open_can("hand", CanPort(port=serve(EmulatedSlcan(echo))), serve.clock)
    try:
        link.ask(PeriodicQuestion(ASK, frozenset({0x101}), period_s=0.01, answer_s=answer_s))
        return gathered(link, frames)
    finally:
        link.close()


def test_a_question_is_asked_in_its_cycle_and_each_answer_bears_its_number(serve: Any) -> None:
    received = polled(serve, Echo(), 30)
    cycles = [one.cycle for one in received if one.cycle is not None]
    assert cycles == sorted(set(cycles))
    assert len(cycles) >= 30
    for one in received:
        assert one.due_s is not None
        assert one.due_s - received[0].due_s == pytest.approx(0.01 * one.cycle)
        assert one.arrival_s > one.due_s


def test_a_lost_answer_leaves_a_gap_in_the_cycles(serve: Any) -> None:
    echo = Echo()
    echo.quiet = {5}
    received = polled(serve, echo, 15)
    assert [int.from_bytes(one.frame.data[:2], "big") for one in received[:8]] == [0, 1, 2, 3, 4, 6, 7, 8]
    assert received[5].cycle - received[4].cycle >= 10, "its answer had 0.1 s: ten cycles"


def test_a_late_answer_passes_for_one_to_the_next_question_and_to_no_other(serve: Any) -> None:
    """The answer to question 5 comes together with that to question 6, when question 5 has been given up."""
    echo = Echo()
    echo.late = {5}
    received = polled(serve, echo, 25)
    mistaken = []
    for one in received:
        number = int.from_bytes(one.frame.data[:2], "big")
        # A question reaches the far end after it was due: one that had before is another cycle's.
        if one.due_s is not None and echo.received_s[number] < one.due_s:
            mistaken.append(number)
    assert mistaken == [5]


def test_an_answer_to_a_question_that_is_asked_no_more_bears_no_number(serve: Any) -> None:
    link = open_can("hand", CanPort(port=serve(EmulatedSlcan(Echo()))), serve.clock)
    first, second = (
        PeriodicQuestion(ASK, frozenset({0x101}), period_s=0.005, answer_s=after_s) for after_s in (0.1, 0.2)
    )
    try:
        link.ask(first)
        assert eventually(lambda: len(link._arrived) > 3)
        link.ask(second)
        of_first = [received for question, received in [*link._arrived] if question is first]
        assert of_first[-1].cycle is not None
        received = gathered(link, len(of_first) + 3)
        numbered = [one.cycle for one in received if one.cycle is not None]
        assert numbered[0] == 0
        assert numbered == sorted(set(numbered)), "the second question's"
        assert all((one.cycle, one.due_s) == (None, None) for one in received[: len(of_first)])
    finally:
        link.close()
