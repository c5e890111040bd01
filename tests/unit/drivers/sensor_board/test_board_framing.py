"""Frames out of bytes, and streams out of frames."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.clock import VirtualClock
from drivers.core.errors import CodecError
from drivers.core.messages import SampleBlock, StreamInfo
from drivers.sensor_board.codec import BoardSamples
from drivers.sensor_board.framing import MAX_ENCODED_BYTES, BoardFrameDecoder, frame
from drivers.sensor_board.streams import BoardStreams


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
    whole = frame(b"\x01\0\0 twelve bytes")
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


FORCE, ACCELERATION, PERIOD = 0, 1, 2

INFOS = {
    FORCE: StreamInfo("board.load_cell", ("force",), "N", 1e-5, 1000.0),
    ACCELERATION: StreamInfo("board.accelerometer", ("x", "z"), "m/s2", 1e-3, 500.0),
    PERIOD: StreamInfo("board.period", ("period",), "s", 1e-7, None),
}


@dataclass
class Board:
    """Sends frames of `n` samples of the load cell, from a true sample number on; counters and time wrap."""

    streams: BoardStreams
    start_us: int = 1_000_000
    start_seq: int = 0
    start_s: float = 1001.0

    def force(self, sample: int, n: int = 10, late_s: float = 0.0) -> tuple[SampleBlock, int | None]:
        frame = BoardSamples(
            FORCE,
            (self.start_seq + sample) % 2**16,
            (self.start_us + sample * 1000) % 2**32,
            np.arange(sample, sample + n, dtype=np.int32),
        )
        return self.streams.push(frame, self.start_s + (sample + n - 1) * 1e-3 + late_s)

    def periods(self, seq: int, times_s: list[float], late_s: float = 0.0) -> tuple[SampleBlock, int | None]:
        times_us = np.array([(self.start_us + round(t * 1e6)) % 2**32 for t in times_s], np.uint32)
        values = np.full(len(times_s), 357_143, np.int32)
        return self.streams.push(
            BoardSamples(PERIOD, seq % 2**16, int(times_us[0]), values, times_us),
            self.start_s + times_s[-1] + late_s,
        )


@pytest.fixture
def board() -> Board:
    clock = VirtualClock()
    clock.wait_until(1000.0)
    clock.restart()
    return Board(BoardStreams(INFOS, clock, 200.0))


def test_a_block_carries_raw_counts_and_all_its_times(board: Board) -> None:
    block, lost = board.force(0, late_s=20e-6)
    assert lost is None
    assert (block.stream, block.seq, block.rate_hz) == ("board.load_cell", 0, 1000.0)
    assert (block.unit, block.scale, block.values.dtype) == ("N", 1e-5, np.int32)
    assert block.values.tolist() == [[value] for value in range(10)]
    assert block.t0_s == pytest.approx(1.0, abs=25e-6)
    assert block.device_t0_s == 1.0
    assert block.arrival_s == pytest.approx(1.00902)


def test_channels_lie_side_by_side(board: Board) -> None:
    frame = BoardSamples(ACCELERATION, 0, 0, np.array([1, 2, 3, 4], np.int32))
    assert board.streams.push(frame, 1001.0)[0].values.tolist() == [[1, 2], [3, 4]]


def test_irregular_samples_keep_each_its_own_time_and_are_lost_by_the_counter(board: Board) -> None:
    board.start_us = 2**32 - 60_000
    block, _ = board.periods(65_530, [0.030, 0.0655, 0.101])
    assert (block.seq, block.rate_hz, block.values.shape) == (65_530, None, (3, 1))
    assert block.times.tolist() == pytest.approx([1.030, 1.0655, 1.101], abs=1e-6)
    block, lost = board.periods(65_540, [0.9])
    assert (lost, block.seq) == (7, 65_540)


@pytest.mark.parametrize(
    "frame",
    [
        BoardSamples(9, 0, 0, np.zeros(4, np.int32)),
        BoardSamples(ACCELERATION, 0, 0, np.zeros(3, np.int32)),
        BoardSamples(PERIOD, 0, 0, np.zeros(4, np.int32)),
        BoardSamples(FORCE, 0, 0, np.zeros(1, np.int32), np.zeros(1, np.uint32)),
        BoardSamples(PERIOD, 0, 5, np.zeros(1, np.int32), np.array([4], np.uint32)),
        BoardSamples(PERIOD, 0, 5, np.zeros(3, np.int32), np.array([5, 9, 8], np.uint32)),
    ],
)
def test_a_frame_that_does_not_fit_the_hello_is_refused(board: Board, frame: BoardSamples) -> None:
    with pytest.raises(CodecError):
        board.streams.push(frame, 1001.0)
