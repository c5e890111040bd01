"""What is found wrong with sound, and what is not."""

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.audio.quality import Excursions, Stillness, clipped, flaw

FULL = 2**23


def sound(n: int = 9600, level: float = 0.25) -> np.ndarray:
    frames = np.arange(n)
    wave = level * FULL * np.cos(2.0 * np.pi * 40_000.0 / 96_000.0 * frames[:, None] + np.array([0.1, 1.0]))
    return np.clip(np.rint(wave), -FULL, FULL - 1).astype(np.int32)


def found(counts: NDArray[np.int32], seconds: float) -> tuple[str, str]:
    result = flaw(counts, seconds)
    assert result is not None
    return result


def test_two_fingers_that_move_are_fit_for_use() -> None:
    assert flaw(sound(), 0.1) is None


def test_quiet_is_not_silent() -> None:
    noise = np.random.default_rng(1).normal(0.0, 30.0, (9600, 2))
    assert flaw(np.rint(noise).astype(np.int32), 0.1) is None


@pytest.mark.parametrize(("column", "finger"), [(0, "right"), (1, "left")])
def test_a_finger_that_does_not_move_is_silent(column: int, finger: str) -> None:
    counts = sound()
    counts[:, column] = 77
    reason, advice = found(counts, 0.1)
    assert reason == f"the {finger} finger is silent: nothing has moved in 0.1 s"
    assert "plugged in" in advice


def test_16_bits_in_24_are_seen() -> None:
    reason, _ = found(sound() >> 8 << 8, 0.1)
    assert reason == "its samples have 16 bits, not 24: the low 8 are empty"


@pytest.mark.parametrize(("column", "finger"), [(0, "right"), (1, "left")])
def test_a_finger_that_is_too_loud_is_clipped(column: int, finger: str) -> None:
    counts = sound()
    counts[:, column] = sound(level=1.3)[:, column]
    reason, _ = found(counts, 0.1)
    assert reason.startswith(f"the {finger} finger is clipped: ")


def test_a_single_knock_at_full_scale_is_not_clipping() -> None:
    counts = sound()
    counts[1000:1005, 0] = FULL - 1
    assert flaw(counts, 0.1) is None


@pytest.mark.parametrize("size", [1, 7, 480, 50_000])
def test_an_excursion_is_reported_once_however_the_sound_is_cut(size: int) -> None:
    counts = sound(48_000)
    counts[5000:6000:12, 0] = FULL - 1
    counts[6000 + 9000, 0] = -FULL  # 0.094 s later: the same excursion
    counts[15_000 + 9700, 0] = -FULL  # 0.101 s later: another
    counts[30_000, 1] = FULL - 1
    excursions = Excursions(96_000.0)
    begun = [
        (at + place, finger)
        for at in range(0, len(counts), size)
        for place, finger in excursions.push(clipped(counts[at : at + size]))
    ]
    assert begun == [(5000, 0), (24_700, 0), (30_000, 1)]


@pytest.mark.parametrize("size", [1, 7, 480])
def test_a_finger_that_falls_silent_is_noticed_in_time(size: int) -> None:
    counts = sound(20_000)
    counts[5000:, 1] = 3
    stillness = Stillness(96_000.0, 0.1)
    for at in range(0, len(counts), size):
        if (finger := stillness.push(counts[at : at + size])) is not None:
            break
    assert finger == "left"
    assert 5000 + 9600 - 1 <= at + size <= 5000 + 9600 + 2 * size


def test_a_slow_drift_is_a_movement() -> None:
    counts = np.repeat(np.arange(4000, dtype=np.int32)[:, None] // 100, 2, axis=1)
    stillness = Stillness(1000.0, 0.5)
    assert [stillness.push(counts[at : at + 10]) for at in range(0, 4000, 10)] == [None] * 400
