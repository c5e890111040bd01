"""What devices share: patience while one is opened, lines out of bytes."""

import itertools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.clock import VirtualClock
from drivers.core.errors import DeviceError, PortError, ProtocolError, SilentError
from drivers.core.links import LineBuffer
from drivers.core.wire import Inquiry
from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from drivers.operator.driver import Person, PersonSettings
from simulator.mocks.base import MemoryLine
from tests.refusals import refused
from tests.unit.drivers.far_end import Other


class Slow:
    """The link to a device whose answer comes so long after the first query."""

    fault: str | None = None

    def __init__(self, clock: VirtualClock, delay_s: float) -> None:
        self.asked: list[float] = []
        self._clock, self._delay_s = clock, delay_s

    def send(self) -> None:
        self.asked.append(self._clock.now())

    def receive(self) -> list[str]:
        return ["here"] * (self._clock.now() >= self._delay_s)

    def close(self) -> None:
        """There is nothing to close."""


def inquiry(delay_s: float, timeout_s: float) -> tuple[Slow, Inquiry]:
    clock = VirtualClock()
    link = Slow(clock, delay_s)
    said: dict[str, Any] = {"strange": lambda: "", "stranger": "another?", "silent": "is it powered?"}
    return link, Inquiry("scale", "asking who is there", link, clock, timeout_s, **said)


@pytest.mark.parametrize(("timeout_s", "queries"), [(0.02, 95), (0.5, 4), (5.0, 1)])
def test_an_answer_after_nearly_two_seconds_is_taken_whatever_the_devices_own_timeout(
    timeout_s: float, queries: int
) -> None:
    link, one = inquiry(1.9, timeout_s)
    assert one.ask(link.send, lambda received: received) == "here"
    assert len(link.asked) == pytest.approx(queries, rel=0.1)


@pytest.mark.parametrize(("patience_s", "waited_s"), [(0.1, 2.0), (12.0, 12.0)])
def test_silence_is_reported_after_the_patience_and_two_seconds_at_least(
    patience_s: float, waited_s: float
) -> None:
    link, one = inquiry(60.0, 0.1)
    with refused(SilentError, "scale", f"no answer in {waited_s:g} s", "is it powered?"):
        one.ask(link.send, lambda received: received, patience_s)
    assert one.clock.now() == pytest.approx(waited_s, abs=0.3)


def test_a_link_that_is_gone_is_not_waited_for() -> None:
    link, one = inquiry(60.0, 0.1)
    link.fault = "the port was taken away"
    with refused(PortError, "scale", "asking who is there", "taken away", "plugged in"):
        one.ask(link.send, lambda received: received)
    assert one.clock.now() == 0.0


@pytest.mark.parametrize(
    ("driver", "settings", "line", "error", "named"),
    [
        (DsaMatrix, DsaMatrixSettings, b"@01 0 RJ\r\n", ProtocolError, ("@01 0 RJ", "/dev/far", "baud rate")),
        (DsaMatrix, DsaMatrixSettings, b"", SilentError, ("no answer in 12 s", "/dev/far", "is it powered?")),
        (
            Person,
            PersonSettings,
            b"",
            SilentError,
            ("no answer in 2 s", "program running", 'port = "console"'),
        ),
    ],
)
def test_another_device_or_none_is_not_opened(
    driver: Any, settings: Any, line: bytes, error: type[DeviceError], named: tuple[str, ...]
) -> None:
    clock = VirtualClock()
    with refused(error, "far", *named):
        driver("far", settings(port="/dev/far"), clock, MemoryLine(Other(line), clock).connect).open()


LINES = [b"@01 1 04 OK IDLE -- 24188:2D", b'{"answer": 3, "done": true}', b"x"]
STREAM = b"\r\n".join([*LINES, b"\n"])


@given(st.lists(st.integers(min_value=0, max_value=len(STREAM)), max_size=6))
def test_lines_are_the_same_wherever_the_bytes_are_split(cuts: list[int]) -> None:
    buffer = LineBuffer(40)
    ends = [0, *sorted(cuts), len(STREAM)]
    assert [line for a, b in itertools.pairwise(ends) for line in buffer.feed(STREAM[a:b])] == LINES
    assert buffer.dropped == 0


def test_a_line_of_the_greatest_length_is_read_and_no_longer_one() -> None:
    buffer = LineBuffer(160)
    assert buffer.feed(b"x" * 160) == []
    assert buffer.feed(b"\r\n") == [b"x" * 160]
    assert buffer.feed(b"x" * 161) == []
    assert buffer.feed(b"\r\none\r\ntw") == [b"one"]
    assert buffer.feed(b"o\r\n") == [b"two"]
    assert buffer.dropped == 1


def test_bytes_without_an_end_of_line_do_not_pile_up_and_count_as_one_line() -> None:
    buffer = LineBuffer(160)
    for _ in range(1000):
        assert buffer.feed(b"\x02" * 100) == []
        assert len(buffer._rest) <= 160
    assert buffer.feed(b"tail\r\nnext\r\n") == [b"next"]
    assert buffer.dropped == 1
