"""Payloads of the DSACON32-M against bytes written by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.errors import CodecError
from drivers.dsa_matrix import codec
from drivers.dsa_matrix.packets import MatrixPacket, encode_packet

REQUESTS = [
    (codec.request(codec.Id.CONTROLLER), (), 0x01, ""),
    (codec.request(codec.Id.SENSOR), (), 0x02, ""),
    (codec.request(codec.Id.MATRIX, 2), (2,), 0x0B, "02"),
    (codec.acquire(run=True, rle=True, frames_per_s=100), (0x81, 100), 0x03, "81 64 00"),
    (codec.acquire(run=True, rle=False, frames_per_s=300), (0x80, 300), 0x03, "80 2C 01"),
    (codec.acquire(run=False, rle=True, frames_per_s=0), (0x01, 0), 0x03, "01 00 00"),
    (codec.acquire(run=True, rle=True, frames_per_s=40_000), (0x81, 40_000), 0x03, "81 40 9C"),
    (codec.request(codec.Id.SET_THRESHOLD, 2, 150), (2, 150), 0x13, "02 00 96 00"),
    (codec.request(codec.Id.SET_THRESHOLD, 2, 40_000), (2, 40_000), 0x13, "02 00 40 9C"),
    (codec.request(codec.Id.THRESHOLD, 0), (0,), 0x14, "00"),
]

CONTROLLER = "00 00  FA 23 00 00  10  22 01  80  00 00 00  40 42 0F 00  00"
SENSOR = "00 00  01 00  00 00  10  8A 0C 00 00  00"
MATRIX = (
    "00 00  9A 99 59 40  9A 99 59 40  06 00  0E 00  01 02 03 04 05 06  00 00  01"
    "  00 00 00 00  00 00 00 00  00 00 00 00  00 00 00 00  00 00 00 00  00 00 00 00  00 F0 7F 45  00"
)

ANSWERS = [
    (codec.ControllerInfo(0, 9210, 0x10, 290, 0x80), 0x01, CONTROLLER),
    (codec.SensorInfo(0, 1, 0x10, 3210), 0x02, SENSOR),
    (codec.Done(codec.Id.ACQUIRE, 0), 0x03, "00 00"),
    (codec.Done(codec.Id.SET_THRESHOLD, 5), 0x13, "05 00"),
    (codec.Done(codec.Id.ACQUIRE, 0x8001), 0x03, "01 80"),
    (codec.Done(codec.Id.THRESHOLD, 0, 150), 0x14, "00 00 96 00"),
    (codec.Done(codec.Id.THRESHOLD, 0x8001, 40_000), 0x14, "01 80 40 9C"),
]


@pytest.mark.parametrize(("request_", "numbers", "identifier", "payload"), REQUESTS)
def test_requests_are_the_bytes_of_the_command_set(
    request_: MatrixPacket, numbers: tuple[int, ...], identifier: int, payload: str
) -> None:
    assert request_ == MatrixPacket(identifier, bytes.fromhex(payload))
    assert codec.decode_request(request_) == numbers


@pytest.mark.parametrize(("answer", "number", "payload"), ANSWERS)
def test_answers_are_the_bytes_of_the_command_set(answer: codec.Answer, number: int, payload: str) -> None:
    packet = MatrixPacket(number, bytes.fromhex(payload))
    assert codec.encode_answer(answer) == packet
    assert codec.decode_answer(packet) == answer


def test_a_matrix_says_its_cells_and_their_size() -> None:
    """3.4 mm as a float is 9A 99 59 40; 4095 is 00 F0 7F 45."""
    packet = MatrixPacket(0x0B, bytes.fromhex(MATRIX))
    assert len(packet.payload) == 52
    answer = codec.decode_answer(packet)
    assert isinstance(answer, codec.MatrixInfo)
    assert (answer.error, answer.cells_x, answer.cells_y) == (0, 6, 14)
    assert answer.texel_width_mm == pytest.approx(3.4)
    assert answer.uid == bytes([1, 2, 3, 4, 5, 6])
    assert codec.encode_answer(answer) == packet


def test_a_raw_frame_is_time_flags_and_texels() -> None:
    answer = codec.decode_answer(MatrixPacket(0x00, bytes.fromhex("E8 03 00 00  00  01 00  FF 0F  00 F0")))
    assert isinstance(answer, codec.Frame)
    assert (answer.time_ms, answer.rle) == (1000, False)
    assert answer.texels.tolist() == [1, 4095, 0], "the upper four bits are none of the texel's"
    assert answer.texels.dtype == np.uint16


def test_a_frame_of_a_controller_that_has_run_for_25_days_keeps_its_time() -> None:
    frame = codec.Frame(0x8000_0001, True, np.array([3], np.uint16))
    packet = codec.encode_answer(frame)
    assert packet.payload[:5] == bytes.fromhex("01 00 00 80 01")
    answer = codec.decode_answer(packet)
    assert isinstance(answer, codec.Frame)
    assert answer.time_ms == frame.time_ms


def test_a_run_length_unit_is_a_count_above_a_value() -> None:
    answer = codec.decode_answer(MatrixPacket(0x00, bytes.fromhex("E8 03 00 00  01  00 F0  00 20  FF 1F")))
    assert isinstance(answer, codec.Frame)
    assert answer.texels.tolist() == [0] * 17 + [4095]


def test_a_raw_frame_of_70_cells_has_153_bytes() -> None:
    frame = codec.Frame(0, False, np.zeros(70, np.uint16))
    assert len(encode_packet(codec.encode_answer(frame))) == 153


def test_an_empty_matrix_of_70_cells_is_five_runs() -> None:
    frame = codec.Frame(0, True, np.zeros(70, np.uint16))
    assert codec.encode_answer(frame).payload[5:] == bytes.fromhex("00 F0" * 4 + "00 A0")


@given(arrays(np.uint16, st.integers(0, 210), elements=st.integers(0, 4095)), st.booleans())
def test_frames_come_back_as_they_were(texels: np.ndarray, rle: bool) -> None:
    answer = codec.decode_answer(codec.encode_answer(codec.Frame(7, rle, texels)))
    assert isinstance(answer, codec.Frame)
    assert answer.texels.tolist() == texels.tolist()


@pytest.mark.parametrize(
    "packet",
    [
        MatrixPacket(0x01, bytes(19)),
        MatrixPacket(0x02, bytes(11)),
        MatrixPacket(0x0B, bytes(51)),
        MatrixPacket(0x03, b""),
        MatrixPacket(0x00, bytes(4)),
        MatrixPacket(0x00, bytes(6)),
        MatrixPacket(0x55, b""),
    ],
)
def test_what_is_no_answer_is_refused(packet: MatrixPacket) -> None:
    with pytest.raises(CodecError, match=f"packet {packet.id:#04x} |bytes of texels"):
        codec.decode_answer(packet)


@pytest.mark.parametrize(
    "packet",
    [
        MatrixPacket(0x01, b"\0"),
        MatrixPacket(0x03, b"\0"),
        MatrixPacket(0x55),
        MatrixPacket(0x0B),
        MatrixPacket(0x13, b"\0"),
        MatrixPacket(0x55, bytes(4)),
    ],
)
def test_what_is_no_request_is_refused(packet: MatrixPacket) -> None:
    with pytest.raises(CodecError, match="no request: MatrixPacket"):
        codec.decode_request(packet)


def test_errors_are_named() -> None:
    assert codec.meaning(2) == "no sensor"
    assert codec.meaning(99) == "error 99"
    assert codec.meaning(len(codec.ERRORS)) == f"error {len(codec.ERRORS)}"


def test_cells_are_named_by_matrix_row_and_column() -> None:
    assert codec.channel_names([(1, 2), (2, 1)]) == ("m0.r0.c0", "m0.r0.c1", "m1.r0.c0", "m1.r1.c0")
