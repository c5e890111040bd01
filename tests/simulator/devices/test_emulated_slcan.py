"""The emulated adapter, line by line."""

from collections.abc import Sequence

import pytest

from drivers.core.can_frame import CanFrame
from simulator.devices.slcan import EmulatedSlcan


class Echo:
    """Answers each frame with its data reversed, and sends frames of its own when set."""

    def __init__(self) -> None:
        self.received: list[CanFrame] = []
        self.due: list[CanFrame] = []

    def receive(self, frame: CanFrame, t_s: float) -> Sequence[CanFrame]:
        self.received.append(frame)
        return [CanFrame(frame.id + 1, frame.data[::-1])]

    def step(self, t_s: float) -> Sequence[CanFrame]:
        due, self.due = self.due, []
        return due

    def inject(self, kind: str, t_s: float) -> None:
        if kind != "stall":
            raise ValueError(kind)


@pytest.fixture
def echo() -> Echo:
    return Echo()


@pytest.fixture
def adapter(echo: Echo) -> EmulatedSlcan:
    opened = EmulatedSlcan(echo)
    assert opened.receive(b"C\rS8\r\rO\r", 0.0) == b"\r\r\r\r"
    return opened


def test_a_frame_goes_out_and_its_answer_comes_back(adapter: EmulatedSlcan, echo: Echo) -> None:
    assert adapter.receive(b"t07A5641401F4C0\r", 0.0) == b"z\rt07B5C0F4011464\r"
    assert echo.received == [CanFrame(0x7A, bytes.fromhex("641401F4C0"))]


def test_a_line_may_come_in_pieces(adapter: EmulatedSlcan, echo: Echo) -> None:
    for byte in b"t1002ABCD\r":
        answer = adapter.receive(bytes([byte]), 0.0)
    assert answer == b"z\rt1012CDAB\r"


def test_a_remote_frame_has_no_data(adapter: EmulatedSlcan, echo: Echo) -> None:
    adapter.receive(b"r0320\r", 0.0)
    assert echo.received == [CanFrame(0x32, remote=True)]


def test_a_nodes_own_frames_come_while_the_channel_is_open(adapter: EmulatedSlcan, echo: Echo) -> None:
    echo.due = [CanFrame(0x12)]
    assert adapter.step(0.0) == b"t0120\r"
    adapter.receive(b"C\r", 0.0)
    echo.due = [CanFrame(0x12)]
    assert adapter.step(0.0) == b""


@pytest.mark.parametrize(
    "line",
    [b"t07\r", b"t07A9\r", b"t07A2AB\r", b"tXYZ0\r", b"tFFF0\r", b"T0000007A0\r", b"q\r", b"O\r", b"S8\r"],
)
def test_what_it_does_not_do_is_refused_with_a_bell(adapter: EmulatedSlcan, echo: Echo, line: bytes) -> None:
    assert adapter.receive(line, 0.0) == b"\a"
    assert echo.received == []


def test_a_closed_channel_carries_nothing(echo: Echo) -> None:
    assert EmulatedSlcan(echo).receive(b"t07A0\r", 0.0) == b"\a"
    assert echo.received == []


def test_a_refused_frame_reaches_no_node(adapter: EmulatedSlcan, echo: Echo) -> None:
    adapter.inject("bell", 0.0)
    assert adapter.receive(b"t07A0\rt07C0\r", 0.0) == b"\az\rt07D0\r"
    assert [frame.id for frame in echo.received] == [0x7C]


def test_spoilt_lines_are_no_slcan(adapter: EmulatedSlcan) -> None:
    adapter.inject("malformed", 0.0)
    assert adapter.receive(b"t1002ABCD\r", 0.0) == b"z\rt?012CDAB\r"
    adapter.inject("truncated", 0.0)
    assert adapter.receive(b"t1002ABCD\r", 0.0) == b"z\rt1012CD\r"


def test_faults_of_nodes_are_handed_on(adapter: EmulatedSlcan) -> None:
    adapter.inject("stall", 0.0)
    with pytest.raises(ValueError, match="nothing on this bus knows a fault 'melt'"):
        adapter.inject("melt", 0.0)
