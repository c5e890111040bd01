"""The chain in whole numbers, against references of other arithmetic."""

import math
from fractions import Fraction

import numpy as np
import pytest

from controller.signals.demodulation import Fused, cic_taps, cosine_taps

RATE_HZ = 96_000.0
DECIMATION = 96
DRIVES_HZ = (40_000.0, 40_123.457, 25_000.001)


def made(kind, drive_hz=40_000.0, channel=0):
    return Fused(channel, drive_hz, RATE_HZ, DECIMATION, kind)


def noise(n, seed=1):
    return np.random.default_rng(seed).integers(-(1 << 23), 1 << 23, (n, 2)).astype(np.int32)


def whole_cycles(drive_hz, frame):
    """The phase at a frame as a fraction of a cycle, in exact arithmetic."""
    return Fraction(round(drive_hz * 1000) * frame, round(RATE_HZ) * 1000) % 1


def decibels(x):
    return 20.0 * np.log10(np.max(np.abs(x)) + 1e-300)


def test_a_rate_that_is_no_whole_number_is_refused():
    with pytest.raises(ValueError, match=r"96000\.5 frames a second are no whole number"):
        Fused(0, 40_000.0, 96_000.5, DECIMATION)


@pytest.mark.parametrize(("kind", "low_pass"), [("fused", cosine_taps), ("cic", cic_taps)])
@pytest.mark.parametrize("frame", [0, 10**9 + 5, 2**40])
@pytest.mark.parametrize("drive_hz", DRIVES_HZ)
def test_the_fused_filter_is_its_low_pass_in_long_arithmetic_to_150_db(drive_hz, frame, kind, low_pass):
    counts = noise(2000)
    first, values = made(kind, drive_hz).push(counts, frame)
    taps = low_pass(DECIMATION).astype(np.longdouble)
    turns = [float(whole_cycles(drive_hz, n)) for n in range(frame, frame + len(counts))]
    angle = 2 * np.array(turns, np.longdouble) * np.longdouble(math.pi)
    mixed = counts[:, 0] * np.exp(-1j * angle)
    for m, (i, q) in enumerate(values):
        last = (first + m + 1) * DECIMATION - 1 - frame
        expected = 2 * np.sum(taps * mixed[last - len(taps) + 1 : last + 1])
        assert decibels((i + 1j * q - complex(expected)) / 2**23) < -150.0


def response(taps, hz):
    k = np.arange(len(taps)) - 0.5 * (len(taps) - 1)
    return np.cos(2 * np.pi * np.outer(np.asarray(hz) / RATE_HZ, k)) @ taps


def test_the_filters_are_flat_where_undulations_are_stop_what_folds_on_them_and_droop_as_documented():
    taps = cosine_taps(DECIMATION)
    assert decibels(response(taps, np.linspace(0, 100, 501)) - 1.0) < -83.0  # 0.0006 dB
    near = [1000.0 * m + np.linspace(-100, 100, 201) for m in range(1, 48)]
    assert decibels(response(taps, near[0])) < -80.0
    assert decibels(response(taps, np.concatenate(near[2:]))) < -93.0
    assert decibels(response(taps, np.linspace(10_000, 48_000, 38_001))) < -129.5
    taps = cic_taps(DECIMATION)
    droop = 20 * np.log10(response(taps, [23.0, 100.0]))
    assert droop == pytest.approx([-0.02, -0.43], abs=0.006)
    assert decibels(response(taps, np.linspace(900, 1100, 201))) < -57.0


@pytest.mark.parametrize("kind", ["fused", "cic"])
def test_a_gap_leaves_out_the_windows_that_span_it_and_turns_nothing(kind):
    """A tone of constant phase: what follows a gap of any length reads as what came before."""
    for lost in (1, 7, 95, 96, 1000):
        chain = made(kind)
        frames = np.arange(20_000)
        kept = np.flatnonzero((frames < 5000) | (frames >= 5000 + lost))
        tone = np.rint(0.5 * 2**23 * np.cos(2 * np.pi * 40_000.0 / RATE_HZ * frames + 0.7)).astype(np.int32)
        (first, before), (later, after) = (
            chain.push(tone[part, None], int(part[0])) for part in np.split(kept, [5000])
        )
        span = round(2 * chain.delay_frames) + 1
        assert first + len(before) == 5000 // DECIMATION
        # the first output whose whole window comes after the gap
        assert later == math.ceil((5000 + lost + span) / DECIMATION) - 1
        values = np.concatenate([before, after]) / 2**23
        exact = 0.5 * np.array([math.cos(0.7), math.sin(0.7)])
        assert decibels(values - exact) < -150.0
