import math

import numpy as np
import pytest

from controller.detectors.calibration import calibrate_pieces, span_maxima, threshold_for
from controller.detectors.slip import SlipPaperDetector, SlipPaperSettings
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
