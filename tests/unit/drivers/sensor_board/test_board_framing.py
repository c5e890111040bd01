"""Frames against golden bytes, and against a reference of independent logic."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.sensor_board.framing import MAX_ENCODED_BYTES, BoardFrameDecoder, frame

GOLDEN: list[dict[str, Any]] = json.loads(
    (Path(__file__).parents[3] / "data" / "board_golden.json").read_text()
)["frames"]


def reference_crc(body: bytes) -> int:
    """CRC-16/IBM-3740 one bit at a time, straight from its definition."""
    remainder = 0xFFFF
    for byte in body:
        for bit in range(7, -1, -1):
            carry = (remainder >> 15) ^ ((byte >> bit) & 1)
            remainder = ((remainder << 1) & 0xFFFF) ^ (0x1021 if carry else 0)
    return remainder


def reference_unstuffed(encoded: bytes) -> bytes:
    """COBS undone by walking from code byte to code byte."""
    out = bytearray()
    at = 0
    while at < len(encoded):
        code = encoded[at]
        run = encoded[at + 1 : at + code]
        assert len(run) == code - 1
        out += run
        at += code
        if code < 0xFF and at < len(encoded):
            out.append(0)
    return bytes(out)


def bodies_in(data: bytes) -> list[bytes]:
    return BoardFrameDecoder().feed(b"\0" + data)


def test_the_reference_crc_gives_the_check_value_of_the_catalogue() -> None:
    assert reference_crc(b"123456789") == 0x29B1


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden["what"])
def test_a_golden_body_gives_its_golden_frame_and_back(golden: dict[str, Any]) -> None:
    body = bytes.fromhex(golden["body"])
    assert frame(body).hex(" ") == golden["frame"]
    assert bodies_in(bytes.fromhex(golden["frame"])) == [body]


@given(st.binary(max_size=600))
def test_a_frame_obeys_the_reference_of_stuffing_and_checksum(body: bytes) -> None:
    encoded = frame(body)
    assert encoded.count(0) == 1
    assert encoded[-1] == 0
    plain = reference_unstuffed(encoded[:-1])
    assert plain == body + reference_crc(body).to_bytes(2, "little")


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=5), st.data())
def test_bodies_come_back_however_the_bytes_are_cut(bodies: list[bytes], data: st.DataObject) -> None:
    line = b"\0" + b"".join(map(frame, bodies))
    decoder, found, at = BoardFrameDecoder(), [], 0
    while at < len(line):
        size = data.draw(st.integers(1, len(line)))
        found += decoder.feed(line[at : at + size])
        at += size
    assert found == bodies
    assert decoder.good == len(bodies)


@given(st.binary(max_size=300))
def test_any_bytes_at_all_raise_nothing_and_the_next_frame_is_read(noise: bytes) -> None:
    assert BoardFrameDecoder().feed(noise + b"\0" + frame(b"next"))[-1] == b"next"


def test_what_precedes_the_first_delimiter_is_passed_over_and_counted_as_nothing() -> None:
    decoder = BoardFrameDecoder()
    assert decoder.feed(frame(b"half a frame")[3:]) == []
    assert decoder.feed(frame(b"whole")) == [b"whole"]
    assert (decoder.good, decoder.bad_crc, decoder.bad_cobs) == (1, 0, 0)


def test_delimiters_in_a_row_are_no_frames() -> None:
    decoder = BoardFrameDecoder()
    assert decoder.feed(b"\0\0\0" + frame(b"x") + b"\0\0") == [b"x"]
    assert decoder.bad_cobs == decoder.bad_crc == 0


def test_every_flipped_bit_is_noticed() -> None:
    whole = frame(bytes.fromhex(GOLDEN[0]["body"]))
    for place in range(8 * (len(whole) - 1)):
        spoilt = bytearray(whole)
        spoilt[place // 8] ^= 1 << place % 8
        decoder = BoardFrameDecoder()
        assert decoder.feed(b"\0" + bytes(spoilt) + frame(b"next")) == [b"next"], place
        assert decoder.bad_crc + decoder.bad_cobs in (1, 2), "two where a delimiter came into being"


def test_a_lost_delimiter_takes_its_neighbour_along() -> None:
    decoder = BoardFrameDecoder()
    line = b"\0" + frame(b"first")[:-3] + frame(b"second") + frame(b"third")
    assert decoder.feed(line) == [b"third"]
    assert decoder.bad_crc + decoder.bad_cobs == 1


def test_a_frame_that_never_ends_is_given_up_once_and_its_memory_with_it() -> None:
    decoder = BoardFrameDecoder()
    decoder.feed(b"\0")
    for _ in range(100):
        assert decoder.feed(b"\x01" * 1000) == []
        assert len(decoder._partial) <= MAX_ENCODED_BYTES
    assert decoder.overlong == 1
    assert decoder.feed(b"\x01\0" + frame(b"after")) == [b"after"]


def test_the_longest_frame_is_written_and_read() -> None:
    body = b"\x01" * (MAX_ENCODED_BYTES - 35)
    whole = frame(body)
    assert len(whole) == MAX_ENCODED_BYTES + 1, "and its delimiter"
    assert bodies_in(whole) == [body]
    with pytest.raises(ValueError, match="longer than 8192"):
        frame(body + b"\x01")


@pytest.mark.parametrize(
    ("spoilt", "counted"),
    [
        (b"\x05\x01", "bad_cobs"),
        (bytes([*frame(b"x")[:-2], frame(b"x")[-2] ^ 1]), "bad_crc"),
        (b"\x01" * (MAX_ENCODED_BYTES + 1), "overlong"),
    ],
)
def test_each_spoilt_frame_is_counted_once(spoilt: bytes, counted: str) -> None:
    decoder = BoardFrameDecoder()
    assert decoder.feed(b"\0" + (spoilt + b"\0") * 3) == []
    counts = {name: getattr(decoder, name) for name in ("good", "bad_crc", "bad_cobs", "overlong")}
    assert counts == {**dict.fromkeys(counts, 0), counted: 3}
