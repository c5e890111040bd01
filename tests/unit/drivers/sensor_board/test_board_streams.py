"""Counters and times extended, loss and restarts seen: frames with known truth in, blocks out."""

from dataclasses import dataclass

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import CodecError
from drivers.core.messages import SampleBlock, StreamInfo
from drivers.sensor_board.codec import BoardSamples
from drivers.sensor_board.streams import BoardStreams

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


def test_blocks_of_any_length_follow_on_over_the_wraps_of_counter_and_clock(board: Board) -> None:
    board.start_seq, board.start_us = 65_000, 2**32 - 50_000
    at = 0
    for n in (10, 1, 64, 7, 30) * 20:
        block, lost = board.force(at, n)
        assert (block.seq, lost) == (65_000 + at, None)
        assert block.t0_s == pytest.approx(1.0 + at * 1e-3, abs=1e-6)
        at += n


@pytest.mark.parametrize("missing", [1, 10, 65_536, 200_000])
def test_a_lost_block_is_counted_exactly_even_when_the_counter_went_round(board: Board, missing: int) -> None:
    board.force(0)
    block, lost = board.force(10 + missing)
    assert (lost, block.seq) == (missing, 10 + missing)
    assert board.force(20 + missing)[1] is None


def test_irregular_samples_keep_each_its_own_time_and_are_lost_by_the_counter(board: Board) -> None:
    board.start_us = 2**32 - 60_000
    block, _ = board.periods(65_530, [0.030, 0.0655, 0.101])
    assert (block.seq, block.rate_hz, block.values.shape) == (65_530, None, (3, 1))
    assert block.times.tolist() == pytest.approx([1.030, 1.0655, 1.101], abs=1e-6)
    block, lost = board.periods(65_540, [0.9])
    assert (lost, block.seq) == (7, 65_540)


def test_streams_share_the_clock_and_keep_their_own_counters(board: Board) -> None:
    board.force(0)
    board.periods(40_000, [0.005])
    assert board.force(10)[1] is None
    assert board.periods(40_001, [0.018])[1] is None
    board.start_us, board.start_s = 0, 1011.0  # ten seconds later it began anew
    assert board.force(0)[1] == 0
    assert board.periods(0, [0.05])[1] == 0
    assert board.streams.clock.restarts == 1


def test_a_stream_that_goes_on_after_a_silence_that_was_asked_for_has_lost_nothing(board: Board) -> None:
    board.force(0)
    board.streams.begin([FORCE])
    block, lost = board.force(5000)
    assert lost is None
    assert block.seq == pytest.approx(5000, abs=1)


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
