"""The emulated matrices, hand and CAN adapter, by bytes."""

from collections.abc import Sequence

import numpy as np
import pytest

from drivers.barrett_hand.strain import FingerStrainSettings
from drivers.core.can_frame import CanFrame
from drivers.dsa_matrix.packets import MatrixPacket, PacketDecoder, encode_packet
from simulator.devices.barrett_hand import EmulatedBarrettHand
from simulator.devices.barrett_hand import counts as counts_of_hand
from simulator.devices.dsa_matrix import EmulatedDsaMatrix, counts
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.fingertip_settings import Matrix
from tests.steady import SteadyForces, SteadyTexels

CELLS = np.arange(6) * 0.5


class Line:
    """One controller, and time."""

    def __init__(self, baud: int = 115_200) -> None:
        source = SteadyTexels([Matrix(2, 3, 0.0034)], CELLS)
        self.matrices = EmulatedDsaMatrix(source, baud, drift_ppm=0.0, start_ms=1000)
        self.decoder = PacketDecoder()
        self.t_s = 50.0
        self.matrices.step(self.t_s)

    def send(self, number: int, payload: str = "") -> list[MatrixPacket]:
        raw = self.matrices.receive(encode_packet(MatrixPacket(number, bytes.fromhex(payload))), self.t_s)
        return self.decoder.feed(raw) + self.wait(0.05)

    def wait(self, seconds: float) -> list[MatrixPacket]:
        got = []
        for _ in range(round(seconds * 1000)):
            self.t_s += 1e-3
            got += self.decoder.feed(self.matrices.step(self.t_s))
        return got


def test_infos_are_reported() -> None:
    line = Line()
    assert line.send(0x01)[0].payload.hex() == "0000fa2300001022018000000040420f0000"
    assert line.send(0x02)[0].payload.hex() == "000001000000108a0c000000"
    (matrix,) = line.send(0x0B, "00")
    assert len(matrix.payload) == 52
    assert matrix.payload[10:14] == b"\x03\0\x02\0", "three columns, two rows"
    (absent,) = line.send(0x0B, "01")
    assert absent.payload[:2] == b"\x05\0"


def test_more_frames_than_its_clock_can_distinguish_are_refused() -> None:
    assert Line().send(0x03, "80 e9 03") == [MatrixPacket(0x03, b"\x05\0")]


def test_frames_come_row_by_row_until_they_are_stopped() -> None:
    line = Line()
    acknowledged, *frames = line.send(0x03, "80 64 00")
    assert acknowledged == MatrixPacket(0x03, b"\0\0")
    frames += line.wait(0.95)
    assert len(frames) == pytest.approx(100, abs=1)
    first, second = frames[0].payload, frames[1].payload
    assert first[5:].hex() == "0000f401e803dc05d007c409"
    assert first[4] == 0
    assert int.from_bytes(second[:4], "little") - int.from_bytes(first[:4], "little") == 10
    line.send(0x03, "00 00 00")
    assert line.wait(0.5) == []


def test_runs_are_encoded_when_asked_for() -> None:
    line = Line()
    line.send(0x13, "02 00 D0 07")
    frame = line.send(0x03, "81 64 00")[-1]
    assert frame.payload[4:].hex() == "010040d017c419"


def test_bytes_take_their_time_on_the_line() -> None:
    """18 + 8 bytes of ten bits at 9600 baud: 27 ms."""
    line = Line(baud=9600)
    request = encode_packet(MatrixPacket(0x01))
    assert line.matrices.receive(request, line.t_s) == b""
    assert line.matrices.step(line.t_s + 0.0270) == b""
    assert len(line.matrices.step(line.t_s + 0.0272)) == 26


def test_an_unknown_command_and_a_refused_one_are_answered_with_an_error() -> None:
    line = Line()
    assert line.send(0x55)[0].payload == b"\x0d\0"
    line.matrices.inject("refuse", line.t_s)
    assert line.send(0x03, "81 64 00") == [MatrixPacket(0x03, b"\x05\0")]
    assert line.wait(0.2) == []


def test_a_packet_with_a_wrong_crc_has_no_answer() -> None:
    line = Line()
    raw = bytearray(encode_packet(MatrixPacket(0x03, b"\x81\x64\0")))
    raw[-1] ^= 1
    assert line.matrices.receive(bytes(raw), line.t_s) == b""
    assert line.wait(0.1) == []


def test_texels_saturate_at_their_converters_ends() -> None:
    assert counts(np.array([-1.0, 0.0, 0.0004, 0.0016, 9.0, np.nan])).tolist() == [0, 0, 0, 2, 4095, 0]
    assert counts(np.array([0.149, 0.150]), threshold=150).tolist() == [0, 150]


SETTINGS = FingerStrainSettings(newton_per_count=0.01, zero_counts=2000)


@pytest.fixture
def hand() -> EmulatedBarrettHand:
    return EmulatedBarrettHand(SETTINGS, SteadyForces({11: 1.0, 12: -0.5, 13: 30.0}), asleep=False)


def test_one_finger_answers_for_itself(hand: EmulatedBarrettHand) -> None:
    answer = hand.receive(CanFrame(0x00B, b"\x19"), 0.0)
    assert answer == [CanFrame(0x566, bytes.fromhex("99 00 34 08"))]  # 2100


def test_all_fingers_answer_one_question_and_the_spread_has_no_gauge(hand: EmulatedBarrettHand) -> None:
    answers = hand.receive(CanFrame(0x405, b"\x19"), 0.0)
    assert [(frame.id, int.from_bytes(frame.data[2:], "little")) for frame in answers] == [
        (0x566, 2100),
        (0x586, 1950),
        (0x5A6, 4095),
    ]


def test_a_finger_that_was_switched_on_answers_for_its_status_alone_until_it_was_woken() -> None:
    hand = EmulatedBarrettHand(SETTINGS, SteadyForces({11: 1.0, 12: 0.0, 13: 0.0}))
    status, strain = CanFrame(0x00B, b"\x05"), CanFrame(0x00B, b"\x19")
    assert hand.receive(strain, 0.0) == []
    assert hand.receive(status, 0.0) == [CanFrame(0x566, bytes.fromhex("85 00 00 00"))]
    assert hand.receive(CanFrame(0x00B, bytes.fromhex("85 00 02 00 00 00")), 1.0) == []
    assert hand.receive(status, 1.1) == hand.receive(strain, 1.1) == [], "it wakes"
    assert hand.receive(status, 1.4) == [CanFrame(0x566, bytes.fromhex("85 00 02 00"))]
    assert hand.receive(strain, 1.4) == [CanFrame(0x566, bytes.fromhex("99 00 34 08"))]
    assert hand.receive(CanFrame(0x00C, b"\x19"), 1.4) == [], "the others sleep on"


def test_frames_that_are_not_for_it_are_passed_over(hand: EmulatedBarrettHand) -> None:
    for frame in (
        CanFrame(0x00A, b"\x19"),
        CanFrame(0x404, b"\x19"),
        CanFrame(0x00B),
        CanFrame(0x00B, b"\x07"),
        CanFrame(0x00B, bytes.fromhex("AA 00 D0 01 01 00")),
    ):
        assert hand.receive(frame, 0.0) == []


def test_gauges_saturate_at_their_converters_ends() -> None:
    forces_n = np.array([-100.0, 0.0, 0.014, 100.0, np.nan])
    assert counts_of_hand(forces_n, SETTINGS).tolist() == [0, 2000, 2001, 4095, 0]


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


def test_faults_of_nodes_are_handed_on(adapter: EmulatedSlcan) -> None:
    adapter.inject("stall", 0.0)
    with pytest.raises(ValueError, match="nothing on this bus has a fault 'melt'"):
        adapter.inject("melt", 0.0)
