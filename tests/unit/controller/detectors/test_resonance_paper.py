import dataclasses
import math

import numpy as np
import pytest

from behaviors.events import BaselineReady, BaselineRefused, Contact, ContactLost
from controller.detectors.resonance_paper import ResonancePaperDetector, ResonancePaperSettings
from drivers.core.messages import SampleBlock


def periods(frequencies_hz, t0_s=0.0):
    lengths_s = 1.0 / np.asarray(frequencies_hz, dtype=float)
    ends_s = t0_s + np.cumsum(lengths_s)
    return SampleBlock("board.period", 0, float(ends_s[0]), lengths_s[:, None], times_s=ends_s, unit="s")


def cut(block, size):
    for start in range(0, len(block), size):
        part = slice(start, start + size)
        times_s, values = block.times[part], block.values[part]
        yield SampleBlock(block.stream, start, float(times_s[0]), values, times_s=times_s, unit=block.unit)


def wandering(n, seed=1, mean_hz=28.0, sd_hz=0.05):
    return mean_hz + sd_hz * np.random.default_rng(seed).standard_normal(n)


def events_of(block, **settings):
    """Eight sigma, not three: with a baseline of 1 s the paper's three alarm falsely now and then."""
    made = ResonancePaperSettings(**{"threshold_sigma": 8.0, **settings})
    return ResonancePaperDetector("contact", made).push(block)


def test_a_rise_beyond_the_threshold_is_contact():
    frequencies = np.concatenate([wandering(200), np.full(40, 31.0)])
    block = periods(frequencies)
    events = events_of(block)
    assert [type(event) for event in events] == [BaselineReady, Contact]
    rise_s = block.times[199]
    # A tenth of 3 Hz lifts the average by 0.3 Hz, beyond 8 sigma of 0.05 / sqrt(10) Hz: the first samples do.
    assert rise_s < events[1].t_s < rise_s + 3 / 15
    assert events[1].value > events[1].threshold


def test_baseline_is_mean_and_sample_deviation_of_the_averaged_frequency():
    """Against the definition, worked out by numpy on every period."""
    frequencies = wandering(60)
    ready = events_of(periods(frequencies), sample_hz=None, threshold_sigma=3.0)[0]
    averages = np.convolve(frequencies, np.ones(10) / 10, mode="valid")
    ends_s = np.cumsum(1.0 / frequencies)[9:]
    within = averages[: np.searchsorted(ends_s, ends_s[0] + 1.0 - 5e-10) + 1]
    assert ready.value == pytest.approx(within.mean(), rel=1e-12)
    assert ready.threshold == pytest.approx(within.mean() + 3 * within.std(ddof=1), rel=1e-12)


def test_sigma_of_single_samples_is_taken_from_the_first_second_and_the_average_is_compared():
    """Against the definition, worked out by numpy on every period."""
    frequencies = np.concatenate([wandering(60), np.full(40, 31.0)])
    block = periods(frequencies)
    ready, contact = events_of(block, sample_hz=None, threshold_sigma=3.0, sigma_of="samples")
    second = frequencies[: np.searchsorted(block.times, block.times[0] + 1.0 - 5e-10) + 1]
    assert ready.value == pytest.approx(second.mean(), rel=1e-12)
    assert ready.threshold == pytest.approx(second.mean() + 3 * second.std(ddof=1), rel=1e-12)
    averages = np.convolve(frequencies, np.ones(10) / 10, mode="valid")
    assert contact.t_s == block.times[9:][averages > ready.threshold][0]


def test_nothing_is_compared_before_the_average_is_full():
    """A baseline shorter than the average: the first periods are beyond the threshold, and no contact."""
    frequencies = np.concatenate([[27.9, 28.1, 27.9, 28.1, 27.9], np.full(20, 31.0)])
    settings = {"sample_hz": None, "threshold_sigma": 3.0, "baseline_s": 0.1, "sigma_of": "samples"}
    block = periods(frequencies)
    assert [type(event) for event in events_of(block, **settings)] == [BaselineReady, Contact]
    assert events_of(block, **settings)[1].t_s == block.times[9]


def test_return_below_the_threshold_ends_the_contact_and_what_is_no_frequency_is_passed_over():
    frequencies = np.concatenate([wandering(100), np.full(40, 31.0), np.full(60, 27.9)])
    block = periods(frequencies)
    block.values[50:53, 0] = [math.nan, 0.0, -1.0]
    assert [type(event) for event in events_of(block)] == [BaselineReady, Contact, ContactLost]


@pytest.mark.parametrize("sample_hz", [10.0, 15.0, 28.0])
def test_no_more_samples_are_taken_than_asked_for(sample_hz):
    """n samples at a rate r take n / r seconds: the baseline cannot be ready before (10 - 1) / r + 1 s."""
    ready = events_of(periods(wandering(400, mean_hz=28.3)), sample_hz=sample_hz)[0]
    assert 9 / sample_hz + 1.0 <= ready.t_s <= 9 / sample_hz + 1.0 + 3 / sample_hz


def test_frequencies_do_as_well_as_periods_and_a_baseline_without_variance_is_refused_once():
    frequencies = np.concatenate([wandering(100), np.full(40, 31.0)])
    block = periods(frequencies)
    direct = SampleBlock("f", 0, block.t0_s, frequencies[:, None], times_s=block.times, unit="Hz")
    assert events_of(direct, input="f") == events_of(block)
    events = events_of(periods(np.full(200, 28.0)), sample_hz=None)
    assert [type(event) for event in events] == [BaselineRefused]
    assert "no variance" in events[0].reason


def test_a_waveform_is_counted_in_software():
    rate_hz = 1000.0
    t_s = np.arange(6000) / rate_hz
    rng = np.random.default_rng(2)
    frequency = np.where(t_s < 4.0, 28.0, 31.0)
    x = 12.0 * np.sin(2 * np.pi * np.cumsum(frequency) / rate_hz) + 0.01 * rng.standard_normal(len(t_s))
    block = SampleBlock("a", 0, 0.0, x[:, None], rate_hz=rate_hz, unit="m/s2")
    contact = events_of(block, input="a", hysteresis=1.0)[-1]
    assert isinstance(contact, Contact)
    assert 4.0 < contact.t_s < 4.5


def test_a_gap_empties_the_average():
    """After a silence of 2 s the average holds only what came after it."""
    before = periods(wandering(100))
    after = periods(wandering(5, seed=3), t0_s=float(before.times[-1]) + 2.0)
    detector = ResonancePaperDetector("contact", ResonancePaperSettings(sample_hz=None))
    detector.push(before)
    high = periods(np.full(9, 31.0), t0_s=float(after.times[-1]) + 2.0)
    assert not detector.push(after)
    assert not detector.push(high)  # nine samples do not fill an average of ten


def flexed(touched_from=10_000):
    """Periods of a finger whose frequency follows the tendon: swept once, then to and fro three times as fast."""
    frequencies, tendon_m, t_s = [], [], 0.0
    for i, wander in enumerate(wandering(1400, mean_hz=0.0)):
        way_mm = max(0.0, t_s - 2.0) if t_s < 22.0 else 20.0 + 3.0 * (t_s - 22.0)
        at_mm = 10.0 - abs(way_mm % 20.0 - 10.0)
        tendon_m.append(1e-3 * at_mm)
        frequencies.append(28.0 + 0.3 * at_mm - 0.004 * at_mm**2 + wander + 3.0 * (i >= touched_from))
        t_s += 1.0 / frequencies[-1]
    block = periods(frequencies)
    grid_s = np.arange(0.0, float(block.times[-1]) + 0.05, 0.01)
    position = np.interp(grid_s, block.times, tendon_m)[:, None]
    return block, SampleBlock("board.tendon", 0, 0.0, position, rate_hz=100.0, unit="m")


def following(block, tendon, size=10_000, **settings):
    named = {"tendon": "board.tendon", "baseline_s": 21.0, "threshold_sigma": 6.0, **settings}
    detector = ResonancePaperDetector("following", ResonancePaperSettings(**named))
    return [
        event
        for part in (*cut(tendon, 100 * size), *cut(block, size))
        for event in detector.push(dataclasses.replace(part, rate_hz=100.0) if part.unit == "m" else part)
    ]


def test_flexing_is_a_contact_to_a_fixed_threshold_and_none_to_one_that_follows_the_tendon():
    block, tendon = flexed()
    assert Contact in {type(event) for event in events_of(block)}
    assert [type(event) for event in following(block, tendon)] == [BaselineReady]


def test_a_contact_is_detected_while_the_tendon_moves_in_pieces_of_any_size():
    block, tendon = flexed(touched_from=1000)
    ready, contact, *_ = following(block, tendon)
    assert isinstance(ready, BaselineReady)
    assert isinstance(contact, Contact)
    assert block.times[999] < contact.t_s < block.times[999] + 0.5
    block, tendon = flexed(touched_from=1000)
    assert following(block, tendon, size=7) == following(block, tendon)


@pytest.mark.parametrize("lost", [50, 90])
def test_lost_samples_of_a_waveform_are_no_slow_period(lost):
    rng = np.random.default_rng(6)
    x = np.sin(2.0 * np.pi * 28.0 * np.arange(6_000) / 1000.0) + 0.01 * rng.standard_normal(6_000)
    detector = ResonancePaperDetector("contact", ResonancePaperSettings(sample_hz=None, baseline_s=3.0))
    events = []
    for part in (slice(0, 1_510), slice(1_510 + lost, 6_000)):
        about = {"rate_hz": 1000.0, "unit": "m/s2"}
        events += detector.push(
            SampleBlock("board.period", part.start, 1e-3 * part.start, x[part, None], **about)
        )
    ready = next(event for event in events if isinstance(event, BaselineReady))
    # noise moves a crossing by 0.01 / (2 pi) of a period; an average of ten is between two crossings, over ten
    sd_hz = 28.0 * math.sqrt(2.0) * 0.01 / (2.0 * math.pi) / 10.0
    assert ready.value == pytest.approx(28.0, abs=2.0 * sd_hz)
    assert ready.threshold - ready.value < 3.0 * 2.0 * sd_hz
