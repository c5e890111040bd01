"""The drive's phase against exact fractions; no frame is too late."""

import math
from fractions import Fraction
from functools import partial

import numpy as np
import pytest

from drivers.audio.oscillator import chirp, tone


@pytest.mark.parametrize("frequency_hz", [40_000.0, 39_999.999, 0.001, 47_999.999, 12_345.678])
@pytest.mark.parametrize("first", [0, 7, 10**9, 45 * 96_000_000 + 95_999_990, 2**53])
def test_a_tone_is_exact_at_every_frame(frequency_hz: float, first: int) -> None:
    wave = tone(first, 40, frequency_hz, 0.5)
    exact = Fraction(round(frequency_hz * 1000), 1000)
    expected = [
        0.5 * math.cos(2.0 * math.pi * float(exact * frame / 96_000 % 1))
        for frame in range(first, first + 40)
    ]
    assert wave == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize(
    "wave",
    [
        partial(tone, frequency_hz=39_123.457, level=1.0),
        partial(chirp, begin=100, from_hz=1000.0, to_hz=3000.0, frames=500, level=0.5),
    ],
)
def test_a_wave_does_not_depend_on_how_it_is_cut(wave: partial[np.ndarray]) -> None:
    parts = [wave(first, min(7, 1000 - first)) for first in range(0, 1000, 7)]
    assert np.array_equal(np.concatenate(parts), wave(0, 1000))


def test_a_chirp_sweeps_once_between_two_silences() -> None:
    wave = chirp(0, 10_000, 100, 1000.0, 3000.0, 9600, 0.5)
    assert not wave[:100].any()
    assert not wave[9700:].any()
    assert wave[100] == 0.5
    # Mean frequency 2 kHz for 0.1 s: 200 cycles, each with two changes of sign.
    assert np.count_nonzero(np.diff(np.signbit(wave[100:9700]))) == pytest.approx(400, abs=1)
