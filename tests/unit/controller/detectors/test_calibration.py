import math

import numpy as np
import pytest

from controller.detectors.calibration import calibrate_pieces, span_maxima, threshold_for
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.detectors.threshold import ForceThresholdDetector, ForceThresholdSettings
from drivers.core.messages import SampleBlock
from tests.refusals import refused


def exponential(n, seed=1):
    return np.random.default_rng(seed).exponential(size=n)


def test_within_the_recording_the_threshold_is_its_own_quantile():
    maxima = exponential(36_000)
    found = threshold_for(maxima, 3600.0)
    assert not found.extrapolated
    # ten hours, once an hour: nine spans alarm above the tenth largest, and the tenth is the threshold itself
    assert np.sum(maxima > found.threshold) == 9
    assert found.low < found.threshold < found.high
    assert found.recording_s == 36_000.0


def test_beyond_the_recording_the_tail_is_extrapolated_and_marked():
    found = threshold_for(exponential(1800), 3600.0 * 10)
    assert found.extrapolated
    assert found.low < math.log(36_000.0) < found.high


def test_the_interval_covers_the_truth_about_as_often_as_stated():
    truth = math.log(3600.0)
    found = [threshold_for(exponential(36_000, seed), 3600.0) for seed in range(200)]
    covered = np.mean([each.low <= truth <= each.high for each in found])
    assert 0.90 <= covered <= 1.0


@pytest.mark.parametrize("interval_s", [250.0, 1e4, 1e6])
def test_the_interval_of_an_extrapolation_covers_the_truth_about_as_often_as_stated(interval_s):
    rng = np.random.default_rng(11)
    found = [threshold_for(rng.exponential(size=1000), interval_s) for _ in range(2000)]
    assert all(each.extrapolated for each in found)
    covered = np.mean([each.low <= math.log(interval_s) <= each.high for each in found])
    assert 0.92 <= covered <= 0.97


def test_spans_without_a_decision_do_not_count():
    statistic = np.full(1000, np.nan)
    statistic[[5, 305, 306]] = 1.0, 2.0, 7.0
    assert span_maxima(statistic, 100.0).tolist() == [1.0, 7.0]


class Given:
    """A detector whose statistic is the recording itself; it decides nothing where that is negative."""

    inputs = ("board.any",)

    def statistic(self, values, rate_hz):
        return np.where(values[:, 0] < 0.0, np.nan, values[:, 0])


def deciding(statistic, rate_hz=100.0):
    """A piece with such a statistic."""
    return Given(), [SampleBlock("board.any", 0, 0.0, statistic[:, None], rate_hz=rate_hz)]


def test_a_second_is_one_in_which_the_detector_decides_however_the_pieces_lie():
    """Of each 1.4 s the first 0.8 s decide nothing: 100 pieces are 60 s."""
    rng = np.random.default_rng(5)
    pieces = [deciding(np.r_[np.full(80, -1.0), rng.random(60)]) for _ in range(100)]
    found = calibrate_pieces(pieces, 10.0)
    assert (found.recording_s, found.pieces) == (60.0, 100)
    joined = np.concatenate([blocks[0].values[80:, 0] for _, blocks in pieces]).reshape(60, 100)
    # six of 60 s reach it, each the largest value of a hundred in a row
    assert np.count_nonzero(joined.max(axis=1) >= found.threshold) == 6
    assert (found.checked_interval_s, found.checked_expected) == (6.0, 10.0)


def test_time_between_decisions_counts_and_a_pause_does_not():
    """A decision in every tenth sample, none for 30 s in between; before the first one is its own tenth."""
    statistic = np.full(13_000, -1.0)
    statistic[59:5000:10], statistic[8009::10] = 1.0, 2.0
    found = calibrate_pieces([deciding(statistic)], 20.0)
    assert found.recording_s == 49.5 + 50.0 + 0.5  # a rest of more than half a second is one
    assert calibrate_pieces([deciding(statistic[:-20])], 20.0).recording_s == 99.0


def test_recordings_at_several_rates_are_as_many_seconds_as_they_last():
    rng = np.random.default_rng(6)
    pieces = [deciding(rng.random(30 * round(rate_hz)), rate_hz) for rate_hz in (100.0, 200.0)]
    assert calibrate_pieces(pieces, 10.0).recording_s == 60.0


def test_thresholds_from_short_pieces_alarm_as_often_in_fresh_ones_as_was_asked_for():
    """White noise; the level at rest is learned anew in each piece of 1.4 s, and varies."""
    rng = np.random.default_rng(1)
    detector = ForceThresholdDetector("force", ForceThresholdSettings())

    def quiet():
        return SampleBlock("board.fingertip", 0, 0.0, rng.standard_normal((280, 1)), rate_hz=200.0)

    found = calibrate_pieces([(detector, [quiet()]) for _ in range(600)], 20.0)
    # 0.5 s are learned from, and the first mean is of 20 ms: 177 of 280 samples decide
    assert found.recording_s == 600 * 177 / 200
    fresh = [detector.statistic(quiet().values, 200.0)[103:] for _ in range(2000)]
    seconds = np.concatenate(fresh).reshape(1770, 200).max(axis=1)
    # 88 are expected, give or take 9, from a threshold known to within a fifth
    assert 60 <= np.count_nonzero(seconds >= found.threshold) <= 125


@pytest.mark.parametrize("drags", [30, 56, 80])
def test_more_short_recordings_are_never_too_few(drags):
    """Of each drag 1.6 s and 0.5 s are quiet, and slip learns for 1.001 s: 0.599 s of the first decide."""
    rng = np.random.default_rng(2)

    def quiet(n):
        block = SampleBlock("board.tangential", 0, 0.0, rng.standard_normal((n, 1)), rate_hz=1000.0)
        return SlipDetector("slip", SlipSettings()), [block]

    found = calibrate_pieces([quiet(n) for _ in range(drags) for n in (1600, 500)], 60.0)
    assert found.recording_s == pytest.approx(0.599 * drags, abs=0.5)
    assert found.extrapolated


def test_a_calibrated_detector_alarms_as_often_as_was_asked_for():
    rng = np.random.default_rng(3)
    detector = SlipPaperDetector("slip", SlipPaperSettings())
    quiet = SampleBlock("board.tangential", 0, 0.0, rng.standard_normal((600_000, 1)), rate_hz=1000.0)
    found = calibrate_pieces([(detector, [quiet])], 30.0)
    fresh = detector.statistic(rng.standard_normal((1_800_000, 1)), 1000.0)
    alarms = np.nansum(span_maxima(fresh, 1000.0) > found.threshold)
    # 60 are expected, give or take 8, from a threshold known to within a quarter
    assert 30 <= alarms <= 100


def test_what_cannot_be_calibrated_is_refused_in_one_line():
    for n, span_s, reason in ((9, 3600.0, "too few"), (100, 1.0, "too short"), (100, math.nan, "too short")):
        with refused(ValueError, reason):
            threshold_for(exponential(n), span_s)
