"""The drive's phase, against whole numbers."""

from fractions import Fraction

import numpy as np
import pytest

from simulator.physics.aura_drive import FRAME_HZ, AuraDrive


@pytest.mark.parametrize("frequency_hz", ["40000", "39999.999", "38123.457", "1"])
@pytest.mark.parametrize("frame", [0, 1, 11, 12, 10**6 + 1, 10**9 + 7, 10**12 + 5])
def test_a_tones_phase_is_exact_however_late_the_frame(frequency_hz: str, frame: int) -> None:
    drive = AuraDrive()
    drive.tone(0.0, float(frequency_hz), 0.5)
    turns = Fraction(frequency_hz) * frame / FRAME_HZ
    expected = 2.0 * np.pi * float(turns - turns.__floor__())
    assert drive.phase_rad(np.array([frame]))[0] == pytest.approx(expected, abs=1e-14)


def test_switching_on_late_does_not_move_the_phase() -> None:
    early, late = AuraDrive(), AuraDrive()
    early.tone(0.0, 40_000.0, 0.5)
    late.tone(1.2345, 40_000.0, 0.5)
    frames = np.arange(200_000, 200_100)
    assert (early.phase_rad(frames) == late.phase_rad(frames)).all()


def test_commands_hold_from_their_instant_until_the_next() -> None:
    drive = AuraDrive()
    drive.tone(1.0, 40_000.0, 0.5)
    drive.tone(2.0, 39_000.0, 0.25)
    drive.silence(3.0)
    frequency_hz, level = drive.at(np.array([0.5, 1.0, 1.999, 2.0, 2.5, 3.0, 9.0]))
    assert frequency_hz.tolist() == [0.0, 40_000.0, 40_000.0, 39_000.0, 39_000.0, 0.0, 0.0]
    assert level.tolist() == [0.0, 0.5, 0.5, 0.25, 0.25, 0.0, 0.0]
    assert drive.at(np.empty(0))[0].size == 0


def test_a_later_order_at_the_same_instant_counts() -> None:
    drive = AuraDrive()
    drive.tone(1.0, 40_000.0, 0.5)
    drive.silence(1.0)
    assert drive.at(np.array([1.5]))[1].tolist() == [0.0]


def test_a_sweep_passes_through_its_frequencies_and_ends_in_silence() -> None:
    drive = AuraDrive()
    drive.sweep(1.0, 20_000.0, 46_000.0, 4.0, 0.5)
    frequency_hz, level = drive.at(np.array([1.0, 3.0, 4.999999, 5.0, 6.0]))
    assert frequency_hz[:2].tolist() == [20_000.0, 33_000.0]
    assert frequency_hz[2] == pytest.approx(46_000.0, abs=0.01)
    assert level.tolist() == [0.5, 0.5, 0.5, 0.0, 0.0]


def test_a_sweeps_phase_is_the_integral_of_its_frequency() -> None:
    drive = AuraDrive()
    drive.sweep(0.0, 20_000.0, 46_000.0, 4.0, 0.5)
    frames = np.arange(FRAME_HZ, FRAME_HZ + 2000)
    turned = np.diff(np.unwrap(drive.phase_rad(frames)))  # below half a turn a frame
    middle_hz, _ = drive.at((frames[:-1] + 0.5) / FRAME_HZ)
    assert turned == pytest.approx(2.0 * np.pi * middle_hz / FRAME_HZ, abs=1e-7)
