"""One suite for every detector: what it is given in which pieces must not matter."""

import numpy as np
import pytest

from behaviors.events import BaselineRefused
from config.assemble import DETECTORS
from controller.detectors.protocol import Compiled
from controller.named import found, settings_of
from drivers.messages import SampleBlock


def resonance_input():
    """Periods of a finger that wanders, is touched, and is released; made by no plant."""
    rng = np.random.default_rng(5)
    frequencies = np.concatenate(
        [
            28.0 + 0.05 * rng.standard_normal(400),
            31.0 + rng.standard_normal(50),
            28.0 + 0.05 * rng.standard_normal(90),
        ]
    )
    lengths_s = 1.0 / frequencies
    ends_s = np.cumsum(lengths_s)
    return [SampleBlock("board.period", 0, float(ends_s[0]), lengths_s[:, None], times_s=ends_s, unit="s")]


def waveform_input():
    """A finger's waveform: free for 10 s, stiffened by a contact that gives and takes, free again; and a lost block."""
    rng, rate_hz = np.random.default_rng(10), 1024.0
    t_s = np.arange(16000) / rate_hz
    touched = (t_s > 11.0) & (t_s < 12.0)
    frequency = 28.0 + np.where(touched, 3.0 + 4.0 * np.sin(50.0 * t_s), 0.0)
    x = 1.8 * np.sin(2.0 * np.pi * np.cumsum(frequency) / rate_hz) + 0.05 * rng.standard_normal(t_s.size)
    return [
        SampleBlock("board.accelerometer", 0, 0.0, x[:15000, None], rate_hz=rate_hz, unit="m/s2"),
        SampleBlock(
            "board.accelerometer", 15100, 15100 / rate_hz, x[15100:, None], rate_hz=rate_hz, unit="m/s2"
        ),
    ]


def force_input():
    """Nothing, a force, nothing. Sample times of 1024 Hz are exact: pieces and the whole have the same."""
    force_n = np.concatenate([np.zeros(1000), np.full(300, 2.0), np.zeros(500)])
    force_n += 0.01 * np.random.default_rng(6).standard_normal(force_n.size)
    return [SampleBlock("board.fingertip", 0, 0.0, force_n[:, None], rate_hz=1024.0, unit="N")]


def slip_input():
    """Noise of two channels; for a second knocks that ring at 180 Hz in one of them; and a lost block after it."""
    rng, rate_hz = np.random.default_rng(7), 1024.0
    noise = 0.003 * rng.standard_normal((5 * 1024, 2))
    since_s = np.arange(200) / rate_hz
    ring = np.exp(-34.0 * since_s) * np.sin(2.0 * np.pi * 180.0 * since_s)
    knocks = np.where(rng.random(1024) < 0.2, 0.3 * rng.standard_normal(1024), 0.0)
    noise[2048:3072, 1] += np.convolve(knocks, ring)[:1024]
    return [
        SampleBlock("board.tangential", 0, 0.0, noise[:4000], rate_hz=rate_hz, unit="V"),
        SampleBlock("board.tangential", 4100, 4100 / rate_hz, noise[4100:], rate_hz=rate_hz, unit="V"),
    ]


def pretouch_input():
    """A finger that rests, comes nearer at 2 cm/s, waits and goes back, with a lost block; and the mover's encoder."""
    rng, rate_hz = np.random.default_rng(8), 1024.0
    way_m = np.interp(
        np.arange(8192) / rate_hz, [0.0, 1.0, 3.5, 4.0, 6.5, 8.0], [0.0, 0.0, 0.05, 0.05, 0.0, -0.03]
    )
    gap_m = 0.055 - way_m
    z = 0.1 - 0.05j + 0.001 * (1.0 + gap_m / 0.01) ** -2 * np.exp(-2j * np.pi * gap_m / 0.0043)
    z += 1.5e-4 * (rng.standard_normal(8192) + 1j * rng.standard_normal(8192))
    values = np.column_stack([z.real, z.imag])
    return [
        SampleBlock("signals.right", 0, 0.0, values[:5000], rate_hz=rate_hz, unit="FS"),
        SampleBlock("signals.right", 5040, 5040 / rate_hz, values[5040:], rate_hz=rate_hz, unit="FS"),
        SampleBlock("arm.position", 0, 0.0, way_m[::2, None], rate_hz=rate_hz / 2.0, unit="m"),
    ]


def level_input():
    """A level in noise that another one takes the place of for a second."""
    rng, rate_hz = np.random.default_rng(9), 1024.0
    values = 0.1 + 1e-5 * rng.standard_normal((6144, 2))
    values[3000:4100] += (0.01, -0.004)
    return [SampleBlock("signals.right", 0, 0.0, values, rate_hz=rate_hz, unit="FS")]


ALARMS = ("Contact", "PreTouch", "SlipStarted")
"""What a detector reports because its number exceeds its threshold."""

INPUTS = {
    "level": level_input,
    "level.paper": level_input,
    "pretouch": pretouch_input,
    "pretouch.paper": pretouch_input,
    "force.threshold": force_input,
    "resonance": waveform_input,
    "resonance.paper": resonance_input,
    "slip": slip_input,
    "slip.paper": slip_input,
}


def cut(block, size):
    for start in range(0, len(block), size):
        part = slice(start, start + size)
        times_s = block.times[part]
        yield SampleBlock(
            block.stream,
            block.seq + start,
            float(times_s[0]),
            block.values[part],
            rate_hz=block.rate_hz,
            times_s=None if block.times_s is None else times_s,
            unit=block.unit,
            scale=block.scale,
        )


def made(kind):
    entry = DETECTORS[kind]
    return found(entry.made)(
        "name", (found(entry.settings) if entry.settings else settings_of(found(entry.made)))()
    )


@pytest.mark.parametrize("size", [1, 7, 64])
@pytest.mark.parametrize("kind", DETECTORS)
def test_blocks_of_any_size_give_the_same_events(kind, size):
    whole, pieces = made(kind), made(kind)
    expected = [event for block in INPUTS[kind]() for event in whole.push(block)]
    events = [event for block in INPUTS[kind]() for part in cut(block, size) for event in pieces.push(part)]
    assert len(expected) >= 2
    assert events == expected


@pytest.mark.parametrize("kind", DETECTORS)
def test_after_a_reset_it_is_as_new(kind):
    detector = made(kind)
    first = [event for block in INPUTS[kind]() for event in detector.push(block)]
    detector.reset()
    assert [event for block in INPUTS[kind]() for event in detector.push(block)] == first


@pytest.mark.parametrize("kind", DETECTORS)
def test_events_bear_their_samples_time_and_never_go_back(kind):
    detector = made(kind)
    times_s = [event.t_s for block in INPUTS[kind]() for event in detector.push(block)]
    known = {t_s for block in INPUTS[kind]() for t_s in block.times.tolist()}
    assert set(times_s) <= known
    assert times_s == sorted(times_s)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", DETECTORS)
def test_values_that_are_not_finite_raise_no_alarm_and_no_error(kind, bad):
    detector = made(kind)
    for block in INPUTS[kind]():
        spoiled = SampleBlock(
            block.stream,
            0,
            block.t0_s,
            np.full_like(block.values, bad),
            rate_hz=block.rate_hz,
            times_s=block.times_s,
            unit=block.unit,
        )
        events = detector.push(spoiled)
        # a missing baseline may be reported
        assert [event for event in events if not isinstance(event, BaselineRefused)] == []


@pytest.mark.parametrize("kind", [kind for kind in DETECTORS if isinstance(made(kind), Compiled)])
def test_warming_up_in_the_middle_of_it_changes_nothing(kind):
    warmed, other = made(kind), made(kind)
    parts = [part for block in INPUTS[kind]() for part in cut(block, 500)]
    expected = [event for part in parts for event in other.push(part)]
    events = []
    for part in parts:
        warmed.warm_up()
        events += warmed.push(part)
    assert events == expected
    assert expected


@pytest.mark.parametrize("kind", DETECTORS)
def test_what_it_alarms_by_is_shown_beside_its_threshold_in_the_push_that_alarms(kind):
    detector = made(kind)
    shown = 0
    for block in INPUTS[kind]():
        for part in cut(block, 64):
            alarms = [event for event in detector.push(part) if type(event).__name__ in ALARMS]
            for alarm in alarms:
                assert alarm.value <= detector.reading.statistic
                assert alarm.threshold == detector.reading.threshold < detector.reading.statistic
                shown += 1
    assert shown
    detector.reset()
    assert detector.reading is None
