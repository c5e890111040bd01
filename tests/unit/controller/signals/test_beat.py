"""Two clocks: their beat is found and removed, and nothing else."""

import numpy as np
import pytest

from controller.signals.iq import Beat

RATE_HZ = 1000.0


def scene(seconds, beat_hz, seed=1):
    """Signal of an unbalanced bridge: some undulations, a contact, noise; and the turned one. Both shape (n,)."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    rng = np.random.default_rng(seed)
    noise = 1e-5 * (rng.standard_normal(len(t)) + 1j * rng.standard_normal(len(t)))
    near = (t % 10.0 > 4.0) & (t % 10.0 < 8.0)
    still = 0.1 + 0.05j + near * 0.01 * np.exp(2j * np.pi * 2.3 * t) + noise
    still[t % 20.0 > 15.0] += 0.03 + 0.02j
    return still, still * np.exp(2j * np.pi * beat_hz * t)


@pytest.mark.parametrize("beat_hz", [-8.0, -0.8, 0.0, 0.8, 4.0])
def test_the_beat_is_found_among_undulations_and_contacts(beat_hz):
    beat = Beat(RATE_HZ)
    beat.push(scene(30.0, beat_hz)[1], 0)
    assert beat.hz == pytest.approx(beat_hz, abs=1e-4)


@pytest.mark.parametrize("beat_hz", [0.0, 0.8])
def test_without_the_beat_the_signal_is_that_of_one_clock(beat_hz):
    still, turned = scene(60.0, beat_hz)
    ratio = Beat(RATE_HZ).push(turned, 0) / still[1000:]
    # the first second's error stays as a constant turn; after that nothing moves that did not move before
    late = ratio[20_000:]
    assert np.ptp(np.unwrap(np.angle(late))) < 0.02
    assert np.abs(late) == pytest.approx(1.0, abs=1e-9)
    assert beat_hz or np.abs(np.angle(ratio)).max() < 0.02, (
        "hardly anything is removed where there is no beat"
    )


def test_blocks_of_any_size_give_the_same():
    turned = scene(5.0, 0.8)[1]
    at_once = Beat(RATE_HZ).push(turned, 0)
    beat, place, parts = Beat(RATE_HZ), 0, []
    for size in np.random.default_rng(3).integers(1, 400, 1000):
        parts.append(beat.push(turned[place : place + size], place))
        place += size
    assert np.concatenate(parts) == pytest.approx(at_once, abs=1e-12)


def test_a_gap_is_turned_through():
    turned = scene(40.0, 0.8)[1]
    whole = Beat(RATE_HZ).push(turned, 0)
    beat = Beat(RATE_HZ)
    beat.push(turned[:9_300], 0)
    after = beat.push(turned[9_900:12_000], 9_900)
    assert np.abs(np.angle(after / whole[8_900:11_000])).max() < 0.02
