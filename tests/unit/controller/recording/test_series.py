import numpy as np

from controller.recording.series import Gap, Span, TrialRecording
from drivers.core.messages import SampleBlock


def block(seq, count, *, rate_hz=1000.0):
    values = np.arange(seq, seq + count, dtype=np.int32).reshape(-1, 1)
    return SampleBlock("board.load_cell", seq, seq / rate_hz, values, rate_hz, unit="N", scale=0.5)


def recorded(*blocks):
    recording = TrialRecording(1)
    for each in blocks:
        recording.add(each)
    return recording


def test_a_stream_is_its_blocks_in_its_unit():
    series = recorded(block(0, 3), block(3, 2)).stream("board.load_cell")
    assert series.unit == "N"
    assert series.values[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert np.allclose(series.times_s, np.arange(5) / 1000, atol=1e-15)
    assert series.gaps == ()


def test_a_lost_block_is_a_gap_with_the_number_of_samples_that_are_missing():
    series = recorded(block(0, 10), block(15, 5)).stream("board.load_cell")
    assert series.gaps == (Gap(0.009, 0.015, 5),)


def test_a_skipped_span_is_no_loss():
    recording = recorded(block(0, 10), block(1000, 5))
    recording.skip("board.load_cell", 0.010, 1.0)
    series = recording.stream("board.load_cell")
    assert series.gaps == ()
    assert series.skipped == (Span(0.010, 1.0),)


def test_a_skipped_span_excuses_no_loss_elsewhere():
    recording = recorded(block(0, 10), block(1000, 5), block(1010, 5))
    recording.skip("board.load_cell", 0.010, 1.0)
    assert recording.stream("board.load_cell").gaps == (Gap(1.004, 1.01, 5),)


def test_a_stream_that_was_not_recorded_is_empty():
    series = recorded().stream("board.load_cell")
    assert len(series) == 0
    assert series.values.shape == (0, 1)


def test_between_takes_the_first_instant_and_leaves_the_last():
    series = recorded(block(0, 10), block(20, 10)).stream("board.load_cell")
    part = series.between(0.002, 0.005)
    assert np.allclose(part.times_s, [0.002, 0.003, 0.004], atol=1e-15)
    assert part.gaps == ()
    assert len(series.between(0.0, 0.1).gaps) == 1


def test_empty_blocks_change_nothing():
    recording = recorded(block(0, 2), block(2, 0), block(2, 2))
    assert len(recording.stream("board.load_cell")) == 4
    assert len(recording.blocks("board.load_cell")) == 3
