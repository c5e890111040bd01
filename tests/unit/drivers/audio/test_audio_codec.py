"""The recorder's frames, tones and sweeps, and whether sound is fit for use."""

import math
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

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
from drivers.audio.oscillator import chirp, tone
from drivers.audio.quality import Excursions, Stillness, clipped, flaw
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


@pytest.mark.parametrize("frequency_hz", [40_000.0, 39_999.999, 0.001, 47_999.999, 12_345.678])
@pytest.mark.parametrize("first", [0, 7, 10**9, 45 * 96_000_000 + 95_999_990, 2**53])
def test_a_tone_is_exact_at_every_frame(frequency_hz: float, first: int) -> None:
    wave = tone(first, 40, frequency_hz, 0.5)
    exact = Fraction(round(frequency_hz * 1000), 1000)
    expected = [
        0.5 * math.cos(2.0 * math.pi * float(exact * frame / 96_000 % 1))
        for frame in range(first, first + 40)
    ]
    assert wave == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize(
    "wave",
    [
        partial(tone, frequency_hz=39_123.457, level=1.0),
        partial(chirp, begin=100, from_hz=1000.0, to_hz=3000.0, frames=500, level=0.5),
    ],
)
def test_a_wave_does_not_depend_on_how_it_is_cut(wave: partial[np.ndarray]) -> None:
    parts = [wave(first, min(7, 1000 - first)) for first in range(0, 1000, 7)]
    assert np.array_equal(np.concatenate(parts), wave(0, 1000))


def test_a_chirp_sweeps_once_between_two_silences() -> None:
    wave = chirp(0, 10_000, 100, 1000.0, 3000.0, 9600, 0.5)
    assert not wave[:100].any()
    assert not wave[9700:].any()
    assert wave[100] == 0.5
    # Mean frequency 2 kHz for 0.1 s: 200 cycles, each with two changes of sign.
    assert np.count_nonzero(np.diff(np.signbit(wave[100:9700]))) == pytest.approx(400, abs=1)


FULL = 2**23


def sound(n: int = 9600, level: float = 0.25) -> np.ndarray:
    frames = np.arange(n)
    wave = level * FULL * np.cos(2.0 * np.pi * 40_000.0 / 96_000.0 * frames[:, None] + np.array([0.1, 1.0]))
    return np.clip(np.rint(wave), -FULL, FULL - 1).astype(np.int32)


def found(counts: NDArray[np.int32], seconds: float) -> tuple[str, str]:
    result = flaw(counts, seconds)
    assert result is not None
    return result


def test_two_fingers_that_move_are_fit_for_use() -> None:
    assert flaw(sound(), 0.1) is None


def test_quiet_is_not_silent() -> None:
    noise = np.random.default_rng(1).normal(0.0, 30.0, (9600, 2))
    assert flaw(np.rint(noise).astype(np.int32), 0.1) is None


@pytest.mark.parametrize(("column", "finger"), [(0, "right"), (1, "left")])
def test_a_finger_that_does_not_move_is_silent(column: int, finger: str) -> None:
    counts = sound()
    counts[:, column] = 77
    reason, advice = found(counts, 0.1)
    assert reason == f"the {finger} finger is silent: nothing has moved in 0.1 s"
    assert "plugged in" in advice


def test_16_bits_in_24_are_seen() -> None:
    reason, _ = found(sound() >> 8 << 8, 0.1)
    assert reason == "its samples have 16 bits, not 24: the low 8 are empty"


@pytest.mark.parametrize(("column", "finger"), [(0, "right"), (1, "left")])
def test_a_finger_that_is_too_loud_is_clipped(column: int, finger: str) -> None:
    counts = sound()
    counts[:, column] = sound(level=1.3)[:, column]
    reason, _ = found(counts, 0.1)
    assert reason.startswith(f"the {finger} finger is clipped: ")


def test_a_single_knock_at_full_scale_is_not_clipping() -> None:
    counts = sound()
    counts[1000:1005, 0] = FULL - 1
    assert flaw(counts, 0.1) is None


@pytest.mark.parametrize("size", [1, 7, 480, 50_000])
def test_an_excursion_is_reported_once_however_the_sound_is_cut(size: int) -> None:
    counts = sound(48_000)
    counts[5000:6000:12, 0] = FULL - 1
    counts[6000 + 9000, 0] = -FULL  # 0.094 s later: the same excursion
    counts[15_000 + 9700, 0] = -FULL  # 0.101 s later: another
    counts[30_000, 1] = FULL - 1
    excursions = Excursions(96_000.0)
    begun = [
        (at + place, finger)
        for at in range(0, len(counts), size)
        for place, finger in excursions.push(clipped(counts[at : at + size]))
    ]
    assert begun == [(5000, 0), (24_700, 0), (30_000, 1)]


@pytest.mark.parametrize("size", [1, 7, 480])
def test_a_finger_that_falls_silent_is_noticed_in_time(size: int) -> None:
    counts = sound(20_000)
    counts[5000:, 1] = 3
    stillness = Stillness(96_000.0, 0.1)
    for at in range(0, len(counts), size):
        if (finger := stillness.push(counts[at : at + size])) is not None:
            break
    assert finger == "left"
    assert 5000 + 9600 - 1 <= at + size <= 5000 + 9600 + 2 * size


def test_a_slow_drift_is_a_movement() -> None:
    counts = np.repeat(np.arange(4000, dtype=np.int32)[:, None] // 100, 2, axis=1)
    stillness = Stillness(1000.0, 0.5)
    assert [stillness.push(counts[at : at + 10]) for at in range(0, 4000, 10)] == [None] * 400
