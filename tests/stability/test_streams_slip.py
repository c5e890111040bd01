"""The slip detectors' streams under stress: offsets, glitches, gaps, changed noise, long runs."""

import numpy as np
import pytest

from behaviors.events import SlipEnded, SlipStarted
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from drivers.core.messages import SampleBlock

RATE_HZ = 1000.0


def block(x, seq=0):
    return SampleBlock("board.tangential", seq, seq / RATE_HZ, np.asarray(x)[:, None], rate_hz=RATE_HZ)


def ringing(n, seed, knocks_hz, size):
    """Noise of deviation 1 and a structure of 180 Hz that is knocked."""
    rng = np.random.default_rng(seed)
    ring = np.exp(-np.arange(200) / 30.0) * np.sin(2.0 * np.pi * 0.18 * np.arange(200))
    knocks = (rng.random(n) < knocks_hz / RATE_HZ) * rng.standard_normal(n) * size
    return rng.standard_normal(n) + np.convolve(knocks, ring)[:n]


def slip_events(x):
    """Slip events of the detector."""
    events = SlipDetector("slip", SlipSettings(threshold=25.0)).push(block(x))
    return [event for event in events if isinstance(event, SlipStarted | SlipEnded)]


def evidence(x):
    detector = SlipDetector("slip", SlipSettings(threshold=1e6))
    detector.push(block(x))
    return detector.readings[:, 1]


def test_an_offset_a_million_times_the_noise_changes_no_evidence():
    x = ringing(12_000, 1, 1.0, 50.0)
    x[9000:9400] += ringing(400, 2, 200.0, 20.0)
    plain = evidence(x)
    assert plain.max() > 50.0
    assert np.max(np.abs(evidence(x + 1e6) - plain)) <= 1e-4


@pytest.mark.parametrize("lost", [1, 60, 700])
def test_a_short_gap_keeps_the_sum_and_one_longer_than_half_a_second_does_not(lost):
    x = 1000.0 + ringing(6000, 13, 1.0, 50.0)
    x[3000:3400] += ringing(400, 14, 200.0, 20.0)
    x[3300 : 3300 + lost] = np.nan
    x[4500:4900] += ringing(400, 15, 200.0, 20.0)
    found = evidence(x)
    assert found[3299] > 50.0
    assert (found[3300 + lost] > 50.0) == (lost < 500)
    # a bump of fifty deviations just before is an impact: knocks count less for a moment
    assert found[4500:].max() > 40.0


def test_a_glitch_of_1e9_is_one_bump_and_forgotten_at_once():
    x = ringing(20_000, 3, 0.0, 0.0)
    spoiled = x.copy()
    spoiled[10_000] = 1e9
    found = evidence(spoiled)
    # one knock is worth ln(200 / 1); what may be added while it lasts comes on top
    assert found[10_000:10_100].max() < 3.0 * np.log(200.0)
    assert found[10_500:].max() < 2.0 * np.log(200.0)


@pytest.mark.parametrize("disturbed", ["glitch", "gap", "offset", "jumps"])
def test_slip_is_found_as_fast_after_a_disturbance_as_without(disturbed):
    x = np.concatenate([ringing(20_000, 4, 0.0, 0.0), ringing(1000, 5, 200.0, 20.0)])
    plain = slip_events(x)[0].t_s
    if disturbed == "glitch":
        x[15_000] = 1e9
    elif disturbed == "gap":
        x[15_000:15_700] = np.nan
    elif disturbed == "offset":
        x[15_000:] += 1000.0
    else:
        x[15_000:15_010] = np.inf
        x[16_000:16_003] = -1e200
    events = slip_events(x)
    assert type(events[0]) is SlipStarted
    assert events[0].t_s == pytest.approx(plain, abs=0.005)


def test_a_noise_floor_that_rises_tenfold_is_an_alarm_that_ends():
    """Louder noise may look like slip at first; after a while it is the new normal, and slip is detected again."""
    x = np.concatenate([ringing(20_000, 6, 0.0, 0.0), 10.0 * ringing(120_000, 7, 0.0, 0.0)])
    x[-1000:] += ringing(1000, 8, 200.0, 300.0)
    events = slip_events(x)
    assert [type(event) for event in events[:2]] == [SlipStarted, SlipEnded]
    assert events[1].t_s < 100.0
    assert events[-1].t_s > 139.0
    assert type(events[-1]) is SlipStarted


def test_a_dead_stretch_neither_alarms_nor_desensitizes():
    x = ringing(30_000, 9, 0.0, 0.0)
    x[5000:9000] = x[5000]
    x[29_000:] += ringing(1000, 10, 200.0, 20.0)
    events = slip_events(x)
    assert [event.t_s > 29.0 for event in events] == [True]


def test_the_papers_detector_loses_one_block_to_a_glitch_and_two_to_a_gap():
    x = 0.001 * np.random.default_rng(11).standard_normal(64 * 20)
    clean = SlipPaperDetector("slip", SlipPaperSettings()).statistic(x[:, None], RATE_HZ)
    spoiled = x.copy()
    spoiled[64 * 5 + 3] = 1e9
    spoiled[64 * 10 + 60 : 64 * 11 + 2] = np.nan
    found = SlipPaperDetector("slip", SlipPaperSettings()).statistic(spoiled[:, None], RATE_HZ)
    ends = np.arange(1, 21) * 64 - 1
    same = found[ends] == clean[ends]
    assert np.flatnonzero(~same).tolist() == [5, 10, 11]
    assert found[ends[5]] > 1e15
    assert np.isnan(found[ends[10]])


def test_an_hour_of_noise_leaves_the_state_as_an_hour_before():
    """After an hour the evidence of the last minute is that of a detector which received that minute alone."""
    rng = np.random.default_rng(12)
    detector = SlipDetector("slip", SlipSettings())
    last = np.empty(0)
    for minute in range(60):
        last = 1000.0 + rng.standard_normal(60_000)
        detector.push(block(last, seq=60_000 * minute))
    fresh = SlipDetector("slip", SlipSettings())
    fresh.push(block(last))
    assert np.max(np.abs(detector.readings[-10_000:, 1] - fresh.readings[-10_000:, 1])) < 0.05
