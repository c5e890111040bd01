"""Contact by the force alone."""

import tracemalloc

import numpy as np
import pytest

from behaviors.events import BaselineReady, BaselineRefused, Contact, ContactLost
from controller.detectors.threshold import ForceThresholdDetector, ForceThresholdSettings
from drivers.core.messages import SampleBlock

SETTINGS = {"baseline_s": 0.1, "average_s": 0.01, "threshold": 1.0, "release_ratio": 0.5, "hold_s": 0.0}


def detector(**settings):
    return ForceThresholdDetector("touch", ForceThresholdSettings(**{**SETTINGS, **settings}))


def block(values, seq=0, rate_hz=1000.0):
    values = np.asarray(values, dtype=float)
    shaped = values[:, None] if values.ndim == 1 else values
    return SampleBlock("board.fingertip", seq, seq / rate_hz, shaped, rate_hz=rate_hz)


def step(offset=0.0):
    """At rest at an offset, then 2 N more for 0.1 s, then at rest again."""
    return offset + np.concatenate([np.zeros(200), np.full(100, 2.0), np.zeros(100)])


def test_it_learns_the_level_then_reports_contact_and_its_end_with_the_running_mean():
    ready, contact, lost = detector().push(block(step(offset=-3.0)))
    assert (type(ready), type(contact), type(lost)) == (BaselineReady, Contact, ContactLost)
    assert ready.t_s == pytest.approx(0.099)
    assert ready.value == pytest.approx(0.0)
    # six of ten samples of 2 N make more than 1 N; eight of ten at rest leave less than 0.5 N
    assert (contact.t_s, contact.value) == (pytest.approx(0.205), pytest.approx(1.2))
    assert (lost.t_s, lost.value) == (pytest.approx(0.307), pytest.approx(0.4))
    assert contact.threshold == 1.0


def test_several_channels_count_as_one_vector_and_the_others_do_not():
    values = np.zeros((300, 3))
    values[200:] = [0.8, 0.8, 99.0]
    assert [type(e) for e in detector(channels=[0, 1]).push(block(values))] == [BaselineReady, Contact]
    assert [type(e) for e in detector(channels=[0]).push(block(values))] == [BaselineReady]


def test_a_gap_empties_the_running_mean_and_keeps_the_level():
    listener = detector()
    listener.push(block(np.full(105, 5.0)))
    assert listener.push(block(np.full(9, 8.0), seq=1000)) == []
    (contact,) = listener.push(block(np.full(1, 8.0), seq=1009))
    assert (contact.t_s, contact.value) == (pytest.approx(1.009), pytest.approx(3.0))


def test_nan_in_the_baseline_is_refused_and_later_left_out():
    spoilt = np.zeros(150)
    spoilt[50] = np.nan
    (refused,) = detector().push(block(spoilt))
    assert isinstance(refused, BaselineRefused)
    assert "not finite" in refused.reason
    later = step()
    later[150:250:7] = np.nan
    assert [type(e) for e in detector().push(block(later))] == [BaselineReady, Contact, ContactLost]


def test_a_baseline_in_contact_is_refused_with_the_reason_and_nothing_is_reported_after_it():
    values = np.concatenate([np.zeros(50), np.full(150, 131.0), np.zeros(200)])
    (refused,) = detector().push(block(values))
    assert isinstance(refused, BaselineRefused)
    assert refused.value > 60.0
    assert refused.reason.startswith("the baseline is not at rest: a mean of 0.01 s is ")
    assert "the threshold is 1; is something touching" in refused.reason


def test_a_threshold_that_is_not_set_is_taken_from_the_noise_of_the_baseline():
    rng = np.random.default_rng(5)
    noise = 0.01 * rng.standard_normal(60_000)
    touch = detector(threshold=None, baseline_s=0.5)
    (ready,) = touch.push(block(noise))
    assert isinstance(ready, BaselineReady), "a minute of noise is no contact"
    assert ready.threshold == pytest.approx(8.0 * 0.01 / np.sqrt(10.0), rel=0.3)
    (contact,) = touch.push(block(np.full(20, 0.05), seq=60_000))
    assert isinstance(contact, Contact)
    assert contact.threshold == ready.threshold


def test_a_baseline_without_noise_gives_no_threshold_and_a_coarse_converter_at_rest_is_no_contact():
    for level in (0.0, 0.1):  # whose mean is rounded
        (refused,) = detector(threshold=None).push(block(np.full(400, level)))
        assert isinstance(refused, BaselineRefused)
        assert "set threshold" in refused.reason
    values = np.zeros(600)
    values[300:320] = 0.05
    event = detector(threshold=None, baseline_s=0.5).push(block(values))[0]
    assert isinstance(event, BaselineReady)


@pytest.mark.parametrize("offset", [0.15, 0.3, 0.5])
def test_flips_by_one_step_of_the_converter_are_no_contact_and_three_steps_are(offset):
    """Noise of 0.12 steps, for five minutes; between codes it flips seldom, or always."""
    noise = 0.12 * np.random.default_rng(4).standard_normal(300_000)
    noise[100] = 0.5  # the baseline shows one step at least
    touch = detector(threshold=None, baseline_s=0.5, average_s=0.02)
    (ready,) = touch.push(block(0.05 * np.round(offset + noise)))
    assert isinstance(ready, BaselineReady)
    assert ready.threshold == pytest.approx(2.0 * 0.05)
    (contact,) = touch.push(block(0.05 * np.round(offset + noise[:40] + 3.0), seq=300_000))
    assert isinstance(contact, Contact)


@pytest.mark.parametrize(("offset", "kind"), [(0.1, BaselineReady), (2.0, BaselineRefused)])
def test_a_tared_sensor_that_reads_more_than_the_threshold_at_rest_is_in_contact(offset, kind):
    rng = np.random.default_rng(3)
    event = detector(threshold=0.5, tared=True).push(block(offset + 0.01 * rng.standard_normal(1000)))[0]
    assert type(event) is kind
    assert kind is BaselineReady or "in contact" in event.reason


@pytest.mark.parametrize(("touch_n", "kind"), [(0.0, BaselineReady), (0.3, BaselineRefused)])
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_a_threshold_from_the_noise_refuses_a_contact_within_its_baseline(part, touch_n, kind):
    rng = np.random.default_rng(11)
    values = 0.02 * rng.standard_normal((600, 3))
    values[500 - round(500 * part) :, 2] += touch_n
    event = detector(threshold=None, baseline_s=0.5).push(block(values))[0]
    assert type(event) is kind
    assert kind is BaselineReady or "is something touching" in event.reason


def test_a_tip_that_bounces_is_one_contact_where_the_hold_is_longer_than_the_bounces():
    bounces = np.concatenate([np.zeros(200), np.tile(np.repeat([3.0, 0.0], 30), 5), np.zeros(300)])
    kinds = [type(event) for event in detector(hold_s=0.05).push(block(bounces))]
    assert kinds == [BaselineReady, Contact, ContactLost]
    assert [type(event) for event in detector().push(block(bounces))].count(Contact) == 5


def test_minutes_of_sound_take_no_more_memory_than_they_are(monkeypatch):
    """In windows of 882 samples: all windows at once would be 0.7 GB."""
    x = np.random.default_rng(8).standard_normal((100_000, 1))
    whole = detector(average_s=0.02).statistic(x, 44_100.0)
    monkeypatch.setattr("controller.detectors.stream.AT_ONCE", 882 * 50)
    tracemalloc.start()
    again = detector(average_s=0.02).statistic(x, 44_100.0)
    assert tracemalloc.get_traced_memory()[1] < 20 * x.nbytes
    tracemalloc.stop()
    assert np.array_equal(whole, again, equal_nan=True)
