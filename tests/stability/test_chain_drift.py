"""The 96 kHz chain does not drift, and a late frame is as good as an early one."""

import numpy as np
import pytest

from controller.signals.demodulation import Fused

RATE_HZ, DECIMATION = 96_000, 96


def test_no_output_differs_in_a_hundred_million_frames():
    """A second holds whole periods of the drive and whole outputs: the same noise must give the same for ever."""
    chain = Fused(0, 40_000.0, float(RATE_HZ), DECIMATION)
    noise = np.random.default_rng(7).integers(-(1 << 23), 1 << 23, (RATE_HZ, 1)).astype(np.int32)
    chain.push(noise, 0)
    _, second = chain.push(noise, RATE_HZ)
    for turn in range(2, 10**8 // RATE_HZ + 1):
        assert np.array_equal(chain.push(noise, turn * RATE_HZ)[1], second)


@pytest.mark.parametrize("drive_hz", [40_000.0, 40_123.457])
def test_a_frame_centuries_later_gives_the_same_to_the_bit(drive_hz):
    """96,000,000 frames after any frame every drive in whole millihertz is where it was."""
    noise = np.random.default_rng(3).integers(-(1 << 23), 1 << 23, (5000, 1)).astype(np.int32)
    chain = Fused(0, drive_hz, float(RATE_HZ), DECIMATION)
    first, early = chain.push(noise, 777)
    later, late = chain.push(noise, 777 + 96_000_000 * 10**7)
    assert np.array_equal(late, early)
    assert later - first == 10**13
