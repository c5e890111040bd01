"""Counters and times extended, loss and restarts seen: frames with known truth in, blocks out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import CodecError
from drivers.core.messages import StreamInfo
from drivers.sensor_board.codec import Samples, Times
from drivers.sensor_board.streams import Arrival, BoardStreams

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

    def force(self, sample: int, n: int = 10, late_s: float = 0.0) -> Arrival:
        frame = Samples(
            FORCE,
            (self.start_seq + sample) % 2**16,
            (self.start_us + sample * 1000) % 2**32,
            np.arange(sample, sample + n, dtype=np.int32),
        )
        return self.streams.push(frame, self.start_s + (sample + n - 1) * 1e-3 + late_s)

    def periods(self, seq: int, times_s: list[float], late_s: float = 0.0) -> Arrival:
        times_us = np.array([(self.start_us + round(t * 1e6)) % 2**32 for t in times_s], np.uint32)
        values = np.full(len(times_s), 357_143, np.int32)
        return self.streams.push(
            Times(PERIOD, seq % 2**16, int(times_us[0]), times_us, values),
            self.start_s + times_s[-1] + late_s,
        )


@pytest.fixture
def board() -> Board:
    clock = VirtualClock()
    clock.wait_until(1000.0)
    clock.restart()
    return Board(BoardStreams(INFOS, clock, 200.0))


def test_a_block_carries_raw_counts_and_all_its_times(board: Board) -> None:
    arrival = board.force(0, late_s=20e-6)
    block = arrival.block
    assert arrival.lost is None
    assert (block.stream, block.seq, block.rate_hz, block.unit, block.scale) == (
        "board.load_cell",
        0,
        1000.0,
        "N",
        1e-5,
    )
    assert block.values.dtype == np.int32
    assert block.values.tolist() == [[value] for value in range(10)]
    assert block.t0_s == pytest.approx(1.0, abs=25e-6)
    assert block.device_t0_s == 1.0
    assert block.arrival_s == pytest.approx(1.00902)
    assert block.physical[3, 0] == pytest.approx(3e-5)


def test_channels_lie_side_by_side(board: Board) -> None:
    frame = Samples(ACCELERATION, 0, 0, np.array([1, 2, 3, 4], np.int32))
    assert board.streams.push(frame, 1001.0).block.values.tolist() == [[1, 2], [3, 4]]


def test_blocks_in_a_row_follow_on_one_another_whatever_their_length(board: Board) -> None:
    at = 0
    for n in (10, 1, 64, 7, 30):
        arrival = board.force(at, n)
        assert (arrival.block.seq, arrival.lost) == (at, None)
        at += n


def test_the_counter_is_extended_over_its_wraps(board: Board) -> None:
    board.start_seq = 65_000
    for block in range(1_500):
        arrival = board.force(100 * block, 100)
        assert arrival.lost is None
    assert arrival.block.seq == 65_000 + 149_900


def test_device_time_is_extended_over_its_wrap(board: Board) -> None:
    board.start_us = 2**32 - 50_000
    blocks = [board.force(10 * at).block for at in range(20)]
    device_s = [block.device_t0_s for block in blocks]
    assert np.diff(np.array(device_s, float)) == pytest.approx(0.01)
    assert [block.t0_s for block in blocks] == pytest.approx([1.0 + 0.01 * at for at in range(20)], abs=1e-6)


@pytest.mark.parametrize("missing", [1, 10, 33, 65_526, 65_536, 65_537, 200_000])
def test_a_lost_block_is_counted_exactly_even_when_the_counter_went_round(board: Board, missing: int) -> None:
    board.force(0)
    arrival = board.force(10 + missing)
    assert arrival.lost == missing
    assert arrival.block.seq == 10 + missing
    assert arrival.block.t0_s == pytest.approx(1.0 + (10 + missing) * 1e-3, abs=1e-6)
    assert board.force(20 + missing).lost is None


def test_a_block_that_arrives_late_is_neither_lost_nor_dated_by_its_arrival(board: Board) -> None:
    for at in range(50):
        board.force(10 * at)
    late = board.force(500, late_s=2.5)
    assert late.lost is None
    assert late.block.t0_s == pytest.approx(1.5, abs=1e-4)
    assert late.block.arrival_s == pytest.approx(4.009)
    assert board.force(510, late_s=2.49).lost is None


def test_irregular_samples_keep_each_its_own_time(board: Board) -> None:
    board.start_us = 2**32 - 60_000
    arrival = board.periods(7, [0.030, 0.0655, 0.101])
    assert arrival.block.seq == 7
    assert arrival.block.rate_hz is None
    assert arrival.block.times_s is not None
    assert arrival.block.times_s.tolist() == pytest.approx([1.030, 1.0655, 1.101], abs=1e-6)
    assert arrival.block.values.shape == (3, 1)


def test_lost_irregular_samples_are_detected_by_the_counter(board: Board) -> None:
    board.periods(65_530, [0.1, 0.2])
    arrival = board.periods(65_540, [0.9])
    assert (arrival.lost, arrival.block.seq) == (8, 65_540)


def test_streams_share_the_clock_and_keep_their_own_counters(board: Board) -> None:
    board.force(0)
    board.periods(40_000, [0.005])
    assert board.force(10).lost is None
    assert board.periods(40_001, [0.018]).lost is None


def test_a_board_that_restarts_begins_a_segment_in_every_stream(board: Board) -> None:
    for at in range(20):
        board.force(10 * at)
    last = board.periods(5, [0.1]).block
    before = board.force(200).block
    board.start_us, board.start_seq, board.start_s = 0, 0, 1011.0  # ten seconds later it counts from zero
    arrival = board.force(0)
    assert arrival.lost == 0
    assert arrival.block.seq > before.seq + 10
    assert arrival.block.device_t0_s == 0.0
    assert arrival.block.t0_s == pytest.approx(11.0, abs=1e-6)
    assert board.force(10).lost is None
    other = board.periods(0, [0.05])
    assert other.lost == 0
    assert other.block.seq > last.seq + 1


def test_a_segment_never_seems_to_follow_on_the_one_before(board: Board) -> None:
    """The counter after the restart happens to be the one that was due."""
    for at in range(5):
        board.force(10 * at)
    board.start_us, board.start_s = 3_000_000_000, 1001.0
    arrival = board.force(50)
    assert arrival.lost == 0
    assert arrival.block.seq > 50


def test_a_time_that_lies_in_the_future_is_another_clock(board: Board) -> None:
    board.periods(5, [0.1])
    board.start_us = 7_000_000
    assert board.periods(6, [0.2]).lost == 0


@pytest.mark.parametrize("jump_us", [-400_000, 2_000_000])
def test_a_clock_that_jumps_while_the_counter_goes_on_is_a_restart(board: Board, jump_us: int) -> None:
    for at in range(50):
        board.force(10 * at)
    board.start_us += jump_us
    assert board.force(500).lost == 0
    assert board.force(510).lost is None


def test_an_irregular_counter_that_runs_backwards_is_a_restart(board: Board) -> None:
    board.periods(500, [0.1])
    assert board.periods(3, [0.2]).lost == 0


def test_times_do_not_turn_back_over_a_restart(board: Board) -> None:
    for at in range(20):
        last = board.force(10 * at).block
    board.start_us, board.start_s = 5_000, 1001.1
    restarted = board.force(95).block
    assert restarted.t0_s >= last.t0_s + 9e-3


def test_a_stream_that_goes_on_after_a_silence_that_was_asked_for_has_lost_nothing(board: Board) -> None:
    board.force(0)
    board.streams.begin([FORCE])
    arrival = board.force(5000)
    assert arrival.lost is None
    assert arrival.block.seq == pytest.approx(5000, abs=1)
    assert arrival.block.seq > 10


def test_a_counter_that_begins_at_zero_when_asked_for_is_no_restart(board: Board) -> None:
    board.force(0)
    board.streams.begin([FORCE])
    board.start_seq = -5000
    arrival = board.force(5000)
    assert arrival.lost is None
    assert board.streams.clock.restarts == 0
    assert arrival.block.seq > 10
    assert board.force(5010).lost is None


def test_an_hour_and_a_half_of_silence_is_dated_right(board: Board) -> None:
    """Longer than the u32 of microseconds: the host's clock shows how often it wrapped."""
    board.force(0)
    board.streams.begin([FORCE])
    arrival = board.force(5_400_000)
    assert arrival.block.device_t0_s == pytest.approx(5401.0)
    assert arrival.block.t0_s == pytest.approx(5401.0, abs=1e-3)


@pytest.mark.parametrize(
    "frame",
    [
        Samples(9, 0, 0, np.zeros(4, np.int32)),
        Samples(ACCELERATION, 0, 0, np.zeros(3, np.int32)),
        Samples(PERIOD, 0, 0, np.zeros(4, np.int32)),
        Times(FORCE, 0, 0, np.zeros(1, np.uint32), np.zeros(1, np.int32)),
        Times(PERIOD, 0, 5, np.array([4], np.uint32), np.zeros(1, np.int32)),
        Times(PERIOD, 0, 5, np.array([5, 9, 8], np.uint32), np.zeros(3, np.int32)),
    ],
)
def test_a_frame_that_does_not_fit_the_hello_is_refused(board: Board, frame: Samples | Times) -> None:
    with pytest.raises(CodecError):
        board.streams.push(frame, 1001.0)
