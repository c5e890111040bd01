"""From frames to blocks: loss, restarts, wrong shapes, saturation."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.messages import Lost, StreamInfo
from drivers.dsa_matrix.codec import Frame
from drivers.dsa_matrix.frames import MatrixFrames

INFO = StreamInfo("dsa.taxels", ("a", "b"), "V", 1e-3, 100.0)


@pytest.fixture
def frames() -> MatrixFrames:
    return MatrixFrames("dsa", INFO, VirtualClock(), 200.0)


def push(frames: MatrixFrames, *times_ms: int, cells: int = 2, begun_ms: int = 0) -> None:
    for time_ms in times_ms:
        texels = np.full(cells, 7, dtype=np.uint16)
        frames.push(Frame(time_ms, False, texels), (time_ms - begun_ms) % 2**32 * 1e-3)


def test_frames_that_follow_one_another_are_one_block(frames: MatrixFrames) -> None:
    push(frames, 0, 10, 20, 31, 40)
    (block,) = frames.take_blocks()
    assert (block.seq, block.values.shape, block.rate_hz) == (0, (5, 2), 100.0)
    assert block.t0_s == pytest.approx(0.0, abs=1e-3)
    assert frames.take_statuses() == []


def test_a_gap_is_lost_frames_and_a_new_block(frames: MatrixFrames) -> None:
    push(frames, 0, 10, 40, 50)
    first, second = frames.take_blocks()
    assert (first.seq, len(first), second.seq, len(second)) == (0, 2, 4, 2)
    (lost,) = frames.take_statuses()
    assert isinstance(lost, Lost)
    assert lost.samples == 2
    assert frames.lost == 2


def test_a_clock_that_goes_back_is_a_controller_that_began_anew(frames: MatrixFrames) -> None:
    push(frames, 100_000, 100_010, 5, 15)
    first, second = frames.take_blocks()
    assert second.seq > first.seq + len(first)
    (lost,) = frames.take_statuses()
    assert isinstance(lost, Lost)
    assert lost.samples == 0


def test_the_wrap_of_the_clock_is_no_step_back(frames: MatrixFrames) -> None:
    push(frames, 2**32 - 10, 0, 10, begun_ms=2**32 - 10)
    (block,) = frames.take_blocks()
    assert len(block) == 3
    assert block.device_t0_s == pytest.approx((2**32 - 10) * 1e-3)


def test_a_segment_that_was_asked_for_jumps_by_the_time_that_has_passed(frames: MatrixFrames) -> None:
    push(frames, 0, 10)
    frames.begin()
    push(frames, 1010)
    first, second = frames.take_blocks()
    assert second.seq == first.seq + 101
    assert frames.take_statuses() == []


def test_frames_of_another_shape_are_passed_over_and_counted(frames: MatrixFrames) -> None:
    push(frames, 0)
    push(frames, 10, cells=3)
    push(frames, 20)
    assert frames.wrong == 1
    assert [block.seq for block in frames.take_blocks()] == [0, 2]
