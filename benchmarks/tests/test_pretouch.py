"""Scoring of the pre-touch study, and that its passages are as specified."""

import math

import numpy as np
import pytest

from behaviors.events import Contact, ContactHeld, ContactLost, PreTouch
from benchmarks.pretouch import FULL, Event, events, passage, rate, seen_at, threshold_at, touch
from benchmarks.pretouch_rooms import TRAINING, UNDULATION_M, Passing, commanded, simulate
from simulator.physics.aura_settings import SIX


def event(kind, t_s):
    return kind(t_s, "touch", 1.0, 0.5)


def test_wilsons_interval_is_the_textbooks():
    """Newcombe, Statistics in Medicine 17 (1998), Table I: 81 of 263 gives 0.2553 to 0.3662."""
    found = rate([True] * 81 + [False] * 182)
    assert (found["low"], found["high"]) == pytest.approx((0.2553, 0.3662), abs=5e-5)


@pytest.mark.parametrize("share", [0.9, 0.953, 0.987])
def test_a_threshold_keeps_the_share_of_its_own_passages_quiet(share):
    maxima = np.random.default_rng(1).permutation(1000).astype(float)
    quiet = np.mean(maxima <= threshold_at(maxima.tolist(), share))
    assert share <= quiet < share + 0.002


def test_a_touch_that_is_felt_held_and_left_in_time():
    events = [event(Contact, 1.1), event(ContactHeld, 1.6), event(ContactLost, 3.02)]
    judged = touch(events, 1.0, 2.95, 3.0)
    assert judged.delay_s == pytest.approx(0.1)
    assert (judged.early, judged.held, judged.ended) == (False, True, True)


@pytest.mark.parametrize(
    ("events", "felt", "early", "held", "ended"),
    [
        ([], False, False, False, False),
        ([event(Contact, 0.5)], False, True, False, False),
        ([event(Contact, 0.9989)], False, True, False, False),
        ([event(Contact, 0.999)], True, False, False, False),
        ([event(Contact, 0.9), event(Contact, 1.1)], False, True, False, False),
        ([event(Contact, 1.6)], False, False, False, False),
        ([event(Contact, 1.1), event(ContactHeld, 1.6), event(ContactLost, 2.0)], True, False, False, False),
        ([event(Contact, 1.1), event(ContactHeld, 1.6), event(ContactLost, 2.96)], True, False, True, True),
        ([event(Contact, 1.1), event(ContactHeld, 1.6)], True, False, True, False),
    ],
)
def test_what_is_late_early_or_taken_back_is_seen(events, felt, early, held, ended):
    judged = touch(events, 1.0, 2.95, 3.0)
    assert (not math.isnan(judged.delay_s), judged.early, judged.held, judged.ended) == (
        felt,
        early,
        held,
        ended,
    )


def test_pre_touch_counts_within_the_approach_alone():
    events = [event(PreTouch, 0.5), event(PreTouch, 2.5)]
    assert seen_at(events, 1.0, 3.0) == 2.5
    assert math.isnan(seen_at(events, 3.0, 4.0))


def test_a_passage_goes_from_its_beginning_to_its_end_and_touches_when_it_is_to():
    near = passage(Event(1, 1, "near", "mug", "normal", 0.03))
    assert near.gap_m[0] == pytest.approx(0.055)
    assert near.gap_m[near.arrived + 50] == pytest.approx(0.004, abs=1e-6)
    assert near.touched is None
    pressed = passage(Event(1, 1, "touch", "mug", "normal", 0.03))
    assert pressed.touched is not None
    assert pressed.released is not None
    assert pressed.gap_m[pressed.touched] <= 0.0 < pressed.gap_m[pressed.touched - 1]
    assert pressed.gap_m.min() == pytest.approx(-0.0005, abs=1e-6)
    # the encoder gives the same path, with its own noise
    assert np.abs(pressed.position_m - (0.055 - pressed.gap_m)).max() < 1e-4


def test_the_full_study_has_more_than_eight_thousand_passages_of_all_kinds():
    work = list(events(1, FULL["all"]))
    assert len(work) > 8000
    assert len({event.number for event in work}) == len(work)
    assert {event.object for event in work} == {*SIX, "none"}
    assert {event.kind for event in work} == {"touch", "near", "nothing", "other_side", "drift"}


def test_passages_and_rooms_are_drawn_again_to_the_last_bit_and_no_two_are_alike():
    one, same, another = (passage(Event(1, number, "near", "mug", "top", 0.03)) for number in (2, 2, 4))
    assert np.array_equal(one.z, same.z)
    assert not np.array_equal(one.z[:1000], another.z[:1000])
    first, again, other = (simulate(Passing(1, number, TRAINING, None)) for number in (4, 4, 6))
    assert np.array_equal(first[0], again[0])
    assert not np.array_equal(first[0][:1000], other[0][:1000])


@pytest.mark.parametrize("speed_m_s", [0.01, 0.03])
def test_the_rival_with_the_commanded_speed_finds_the_power_of_a_wave_on_a_level_that_drifts(speed_m_s):
    times_s = np.arange(3000) / 1000.0
    wave = 1e-3 * np.exp(2j * np.pi * speed_m_s / UNDULATION_M * times_s)
    power = commanded(0.2 + 0.01 * times_s + wave, speed_m_s, 2)
    assert np.nanmedian(power) == pytest.approx(1e-6, rel=0.05)
