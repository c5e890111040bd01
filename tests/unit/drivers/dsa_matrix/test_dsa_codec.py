"""The controller's packets, and what is in them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.errors import CodecError
from drivers.dsa_matrix import codec
from drivers.dsa_matrix.packets import MAX_PAYLOAD_BYTES, MatrixPacket, PacketDecoder, checksum, encode_packet

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


ASK_CONTROLLER = bytes.fromhex("AA AA AA 01 00 00")

packets = st.builds(MatrixPacket, st.integers(0, 0x14), st.binary(min_size=0, max_size=40))


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        (ASK_CONTROLLER, "E8 10"),  # the interface page's
        (b"", "FF FF"),  # its beginning
        (b"\xff", "FF 00"),  # by hand: table[0] = 0, so the register moves down by a byte
    ],
)
def test_the_crc_is_that_of_the_interface_page(data: bytes, crc: str) -> None:
    assert checksum(data) == bytes.fromhex(crc)


def test_a_packet_without_payload_has_no_crc() -> None:
    assert encode_packet(MatrixPacket(0x01)) == ASK_CONTROLLER
    assert PacketDecoder().feed(ASK_CONTROLLER) == [MatrixPacket(0x01)]


def test_a_packet_with_payload_has_its_crc_over_all_but_the_preamble() -> None:
    raw = encode_packet(MatrixPacket(0x03, b"\x81\x64\x00"))
    assert raw[:9] == bytes.fromhex("AA AA AA 03 03 00 81 64 00")
    assert raw[9:] == checksum(raw[3:9])
    assert len(raw) == 11


@given(st.lists(packets, max_size=5), st.integers(1, 20))
def test_packets_come_whole_however_the_bytes_come(sent: list[MatrixPacket], size: int) -> None:
    raw = b"".join(map(encode_packet, sent))
    decoder = PacketDecoder()
    got = [packet for at in range(0, len(raw), size) for packet in decoder.feed(raw[at : at + size])]
    assert got == sent
    assert decoder.passed_over == 0


@given(st.binary(max_size=60).filter(lambda noise: b"\xaa" not in noise), packets)
def test_noise_before_a_packet_is_passed_over_and_counted(noise: bytes, packet: MatrixPacket) -> None:
    decoder = PacketDecoder()
    assert decoder.feed(noise + encode_packet(packet)) == [packet]
    assert decoder.passed_over == len(noise)
    assert decoder.noise == noise[-32:]


@pytest.mark.parametrize("extra", [1, 2, 5])
def test_a_row_of_preamble_bytes_is_no_hindrance(extra: int) -> None:
    assert PacketDecoder().feed(b"\xaa" * extra + ASK_CONTROLLER) == [MatrixPacket(0x01)]


@given(st.data())
def test_a_flipped_bit_never_passes_for_the_packet(data: st.DataObject) -> None:
    packet = data.draw(st.builds(MatrixPacket, st.integers(0, 0x14), st.binary(min_size=1, max_size=40)))
    raw = bytearray(encode_packet(packet))
    place = data.draw(st.integers(24, 8 * len(raw) - 1))
    raw[place // 8] ^= 1 << place % 8
    decoder = PacketDecoder()
    assert packet not in decoder.feed(bytes(raw)) + decoder.flush()


def test_a_truncated_packet_costs_itself_alone() -> None:
    first, second = encode_packet(MatrixPacket(0x00, bytes(150))), encode_packet(MatrixPacket(0x03, b"\0\0"))
    decoder = PacketDecoder()
    got = decoder.feed(first[:80] + second * 10)
    assert got + decoder.flush() == [MatrixPacket(0x03, b"\0\0")] * 10


def test_silence_gives_up_what_has_begun() -> None:
    whole = encode_packet(MatrixPacket(0x03, b"\0\0"))
    decoder = PacketDecoder()
    assert decoder.feed(bytes.fromhex("AA AA AA 00 F4 01") + whole) == []
    assert decoder.flush() == [MatrixPacket(0x03, b"\0\0")]


def test_memory_is_bounded() -> None:
    decoder = PacketDecoder()
    for _ in range(100):
        decoder.feed(b"\xaa\xaa\xaa\x00\xff\xff" + bytes(1000))
    assert len(decoder._rest) <= MAX_PAYLOAD_BYTES + 8


def test_too_long_a_payload_is_refused() -> None:
    with pytest.raises(ValueError, match="longer than"):
        encode_packet(MatrixPacket(0x00, bytes(MAX_PAYLOAD_BYTES + 1)))
