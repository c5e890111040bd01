"""The 96 kHz chain does not drift, and a late frame is as good as an early one."""

import numpy as np
import pytest

from benchmarks.chain.drift import endure
from controller.signals.demodulation import Cic, Fused
from controller.signals.oscillator import Oscillator

RATE_HZ, DECIMATION = 96_000, 96


@pytest.mark.parametrize("kind", ["cic", "fused"])
def test_no_output_differs_in_a_hundred_million_frames(kind):
    found = endure(kind, 10**8)
    assert found["frames"] >= 10**8
    assert found["outputs_that_differ"] == 0
    assert found.get("last_equals_python_integers", True)


@pytest.mark.parametrize("kind", [Cic, Fused])
@pytest.mark.parametrize("drive_hz", [40_000.0, 40_123.457])
def test_a_frame_centuries_later_gives_the_same_to_the_bit(kind, drive_hz):
    """96,000,000 frames after any frame every drive in whole millihertz is where it was."""
    noise = np.random.default_rng(3).integers(-(1 << 23), 1 << 23, (5000, 1)).astype(np.int32)
    chain = kind(0, Oscillator(drive_hz, float(RATE_HZ)), DECIMATION)
    early = chain.push(noise, 777)
    late = chain.push(noise, 777 + 96_000_000 * 10**7)
    assert np.array_equal(late.values, early.values)
    assert late.first - early.first == 10**13
