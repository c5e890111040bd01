"""The 96 kHz chain does not drift, and a late frame is as good as an early one."""

import numpy as np
import pytest

from controller.signals.demodulation import Cic, Fused, Oscillator, cic_taps

RATE_HZ, DECIMATION = 96_000, 96


def fused(channel, oscillator, decimation):
    return Fused((channel,), oscillator, decimation)


@pytest.mark.parametrize("kind", [Cic, fused])
def test_no_output_differs_in_a_hundred_million_frames(kind):
    """A second holds whole periods of the drive and whole outputs: the same noise must give the same for ever."""
    chain = kind(0, Oscillator(40_000.0, float(RATE_HZ)), DECIMATION)
    noise = np.random.default_rng(7).integers(-(1 << 23), 1 << 23, (RATE_HZ, 1)).astype(np.int32)
    chain.push(noise, 0)
    second = chain.push(noise, RATE_HZ).values
    for turn in range(2, 10**8 // RATE_HZ + 1):
        last = chain.push(noise, turn * RATE_HZ).values
        assert np.array_equal(last, second)
    if isinstance(chain, Cic):  # the last output once more, in Python's own integers
        wave = [[int(w) for w in row] for row in chain._table]
        taps = [int(tap) for tap in cic_taps(DECIMATION)]
        begin = RATE_HZ - len(taps)
        mixed = [[int(noise[k, 0]) * row[k % 12] for k in range(begin, RATE_HZ)] for row in wave]
        exact = [sum(t * x for t, x in zip(taps, row, strict=True)) for row in mixed]
        assert [int(value) for value in last[-1]] == exact


@pytest.mark.parametrize("kind", [Cic, fused])
@pytest.mark.parametrize("drive_hz", [40_000.0, 40_123.457])
def test_a_frame_centuries_later_gives_the_same_to_the_bit(kind, drive_hz):
    """96,000,000 frames after any frame every drive in whole millihertz is where it was."""
    noise = np.random.default_rng(3).integers(-(1 << 23), 1 << 23, (5000, 1)).astype(np.int32)
    chain = kind(0, Oscillator(drive_hz, float(RATE_HZ)), DECIMATION)
    early = chain.push(noise, 777)
    late = chain.push(noise, 777 + 96_000_000 * 10**7)
    assert np.array_equal(late.values, early.values)
    assert late.first - early.first == 10**13
