"""Packets of the DSACON32-M against bytes written by hand, and what is done with ruins of them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dsa_matrix.packets import MAX_PAYLOAD_BYTES, MatrixPacket, PacketDecoder, checksum, encode_packet

ASK_CONTROLLER = bytes.fromhex("AA AA AA 01 00 00")

packets = st.builds(MatrixPacket, st.integers(0, 0x14), st.binary(min_size=0, max_size=40))


def test_the_crc_is_that_of_the_interface_page() -> None:
    assert checksum(ASK_CONTROLLER) == bytes.fromhex("E8 10")


def test_the_crc_of_nothing_is_its_beginning() -> None:
    assert checksum(b"") == b"\xff\xff"


def test_one_byte_is_a_step_that_can_be_taken_by_hand() -> None:
    """0xFFFF and byte 0xFF: table[0] = 0, so the register moves down by a byte."""
    assert checksum(b"\xff") == b"\xff\x00"


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
