"""Golden bytes written by hand from docs/reference/audio.md, and what must not be read."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.audio.codec import (
    FrameDecoder,
    Sound,
    SoundMessage,
    decode_line,
    encode,
    encode_line,
    pack24,
    unpack24,
)
from drivers.core.errors import CodecError

# Two frames of two channels from frame 2^32 + 1 on: (1, -1), (8388607, -8388608).
SOUND = bytes.fromhex("54 42 41 31 01 02 02 00 01 00 00 00 01 00 00 00 01 00 00 ff ff ff ff ff 7f 00 00 80")

# {"reply":7} at frame 258.
MESSAGE = bytes.fromhex("54 42 41 31 02 00 0b 00 02 01 00 00 00 00 00 00") + b'{"reply":7}'


def content(frames: list[Sound | SoundMessage]) -> list[object]:
    return [
        (one.frame, one.counts.tolist()) if isinstance(one, Sound) else (one.frame, one.content)
        for one in frames
    ]


EXPECTED = [(2**32 + 1, [[1, -1], [8388607, -8388608]]), (258, {"reply": 7})]


def test_golden_frames_are_read_however_they_are_cut() -> None:
    for size in (1, 5, 16, 1000):
        decoder = FrameDecoder()
        data = SOUND + MESSAGE
        frames = [frame for at in range(0, len(data), size) for frame in decoder.feed(data[at : at + size])]
        assert content(frames) == EXPECTED


def test_golden_frames_are_written() -> None:
    counts = np.array([[1, -1], [8388607, -8388608]], np.int32)
    assert encode(Sound(2**32 + 1, counts)) == SOUND
    assert encode(SoundMessage(258, {"reply": 7})) == MESSAGE


def test_the_hosts_lines_are_json() -> None:
    assert encode_line({"do": "stop", "tag": 3}) == b'{"do":"stop","tag":3}\n'
    assert decode_line(b'{"do": "stop", "tag": 3}') == {"do": "stop", "tag": 3}


@given(st.lists(st.integers(-(2**23), 2**23 - 1), max_size=200))
def test_24_bits_go_there_and_back(values: list[int]) -> None:
    counts = np.array(values, np.int32)
    packed = pack24(counts)
    assert packed == b"".join(value.to_bytes(3, "little", signed=True) for value in values)
    assert unpack24(packed).tolist() == values


@pytest.mark.parametrize("count", [2**23, -(2**23) - 1])
def test_what_does_not_fit_24_bits_is_not_written(count: int) -> None:
    with pytest.raises(CodecError, match="do not fit 24 bits"):
        pack24(np.array([[0, count]], np.int32))


def test_more_frames_than_a_header_can_count_are_not_written() -> None:
    with pytest.raises(CodecError, match="does not fit"):
        encode(Sound(0, np.zeros((1 << 16, 2), np.int32)))


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"HTTP/1.1 400", "begins with b'TBA1', not with b'HTTP'"),
        (SOUND[:4] + b"\x03" + SOUND[5:], "kind 3 with 2 channels and a length of 2"),
        (SOUND[:4] + b"\x03\x00" + SOUND[6:], "kind 3 with 0 channels"),
        (SOUND[:5] + b"\x00" + SOUND[6:], "0 channels"),
        (SOUND[:6] + b"\x00\x00" + SOUND[8:], "a length of 0"),
        (SOUND + b"\x00" + MESSAGE, "begins with"),  # out of step
        (MESSAGE[:-1] + b"]", "no JSON: Expecting"),
        (MESSAGE[:6] + b"\x02\x00" + MESSAGE[8:16] + b"[]", "^no JSON object$"),
    ],
)
def test_what_is_no_recorders_is_not_read(data: bytes, why: str) -> None:
    with pytest.raises(CodecError, match=why):
        FrameDecoder().feed(data)


def test_a_frame_of_nothing_but_its_header_is_read_at_once() -> None:
    nothing = b"{}"
    with pytest.raises(CodecError, match="no JSON: Expecting value"):
        FrameDecoder().feed(MESSAGE[:6] + b"\x00\x00" + MESSAGE[8:16])
    assert content(FrameDecoder().feed(MESSAGE[:6] + b"\x02\x00" + MESSAGE[8:16] + nothing)) == [(258, {})]


def test_a_message_of_two_keys_is_written_without_blanks() -> None:
    assert encode(SoundMessage(0, {"a": 1, "b": 2})).endswith(b'{"a":1,"b":2}')


def test_counts_of_any_type_and_shape_are_packed_and_come_back_in_32_bits() -> None:
    packed = pack24(np.array([[1, -1], [2, -2]], np.int64))  # type: ignore[arg-type]
    assert packed == bytes.fromhex("01 00 00 ff ff ff 02 00 00 fe ff ff")
    assert unpack24(packed).dtype == np.int32


def test_half_a_sample_is_none() -> None:
    with pytest.raises(CodecError, match="no whole number"):
        unpack24(b"1234")
