"""One suite for every detector: what it is given in which pieces must not matter."""

import numpy as np
import pytest

from config.assemble import DETECTORS, found
from drivers.messages import SampleBlock


def resonance_input():
    """Periods of a finger that wanders, is touched, and is let go; made by no plant."""
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


INPUTS = {"resonance": resonance_input, "resonance.paper": resonance_input}


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
    return found(entry.made)("name", found(entry.settings)())


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
        assert list(detector.push(spoiled)) == []
