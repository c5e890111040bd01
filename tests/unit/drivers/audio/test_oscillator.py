"""The drive's phase against exact fractions; no frame is too late."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from drivers.audio.oscillator import ChirpWave, Silence, ToneWave


@pytest.mark.parametrize("frequency_hz", [40_000.0, 39_999.999, 0.001, 47_999.999, 12_345.678])
@pytest.mark.parametrize("first", [0, 7, 10**9, 45 * 96_000_000 + 95_999_990, 2**53])
def test_a_tone_is_exact_at_every_frame(frequency_hz: float, first: int) -> None:
    wave = ToneWave(frequency_hz, 0.5).at(first, 40)
    exact = Fraction(round(frequency_hz * 1000), 1000)
    expected = [
        0.5 * math.cos(2.0 * math.pi * float(exact * frame / 96_000 % 1))
        for frame in range(first, first + 40)
    ]
    assert wave == pytest.approx(expected, abs=1e-13)


def test_a_tone_does_not_depend_on_how_it_is_cut() -> None:
    tone = ToneWave(39_123.457, 1.0)
    parts = [tone.at(first, min(7, 1000 - first)) for first in range(0, 1000, 7)]
    assert np.array_equal(np.concatenate(parts), tone.at(0, 1000))


def test_a_chirp_sweeps_once_between_two_silences() -> None:
    chirp = ChirpWave(1000.0, 3000.0, 9600, 0.5, begin=100)
    assert chirp.end == 9700
    wave = chirp.at(0, 10_000)
    assert not wave[:100].any()
    assert not wave[9700:].any()
    assert wave[100] == 0.5
    # Mean frequency 2 kHz for 0.1 s: 200 cycles, each with two changes of sign.
    assert np.count_nonzero(np.diff(np.signbit(wave[100:9700]))) == pytest.approx(400, abs=1)
    parts = [chirp.at(first, 123) for first in range(0, 123 * 80, 123)]
    assert np.array_equal(np.concatenate(parts), chirp.at(0, 123 * 80))


def test_silence_is_nothing_and_goes_on() -> None:
    assert not Silence().at(5, 10).any()
    assert Silence().end is None
