"""C1 measured on sweeps written by hand."""

import math

import numpy as np
import pytest

from behaviors.chirp import ChirpSettings
from controller.measures import chirp
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock


@pytest.mark.parametrize("late_s", [0.0, 0.06])
def test_the_best_frequency_is_where_most_comes_back_however_late_it_comes(late_s):
    """The order stands at 0.1 s; 60 ms of buffers and latency are 1.6 kHz of this sweep."""
    settings = ChirpSettings(duration_s=1.0)
    times_s = np.arange(0, 1.4, 1.0 / 96_000.0)
    swept_s = times_s - 0.1 - late_s
    f_hz = 20_000.0 + 26_000.0 * swept_s
    gain = 1.0 / np.sqrt(1.0 + ((f_hz - 39_500.0) / 1000.0) ** 2)
    tone = np.where(
        (swept_s >= 0) & (swept_s < 1.0),
        gain * np.sin(2 * np.pi * (20_000.0 * swept_s + 13_000.0 * swept_s**2)),
        0.0,
    )
    recording = TrialRecording(1)
    noise = 1e-3 * np.random.default_rng(1).standard_normal((len(tone), 2))
    recording.add(
        SampleBlock("audio.fingers", 0, 0.0, tone[:, None] * [1.0, 0.5] + noise, rate_hz=96_000.0, unit="FS")
    )
    evidence = TrialEvidence({}, recording, entered_s={"SWEEPING": 0.1, "RINGING": 1.1 + late_s})
    _, row = chirp.measure(evidence, settings, "swept")
    assert row["best_hz"] == pytest.approx(39_500.0, abs=chirp.STEP_HZ)
    # half a band, and a millisecond of 26 kHz a second
    assert row["unsure_hz"] == pytest.approx(125.0 + 26.0)
    assert row["band_low_hz"] == pytest.approx(38_500.0, abs=2 * chirp.STEP_HZ)
    assert row["band_high_hz"] == pytest.approx(40_500.0, abs=2 * chirp.STEP_HZ)
    # (1 + 1/4) / 2 over twice the noise's variance
    assert row["over_noise_db"] == pytest.approx(10 * math.log10(0.625 / 2e-6), abs=1.0)


def test_a_sweep_that_a_pause_broke_off_is_not_taken_for_silence():
    """A loud tone in the first second, silence from 2 s, the sweep from 3 s on."""
    times_s = np.arange(0.0, 4.2, 1.0 / 96_000.0)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(times_s))
    sound = np.where((times_s < 1.0) | ((times_s >= 3.0) & (times_s < 4.0)), np.sin(2e5 * times_s), 0.0)
    recording = TrialRecording(1)
    values = np.column_stack([sound + noise] * 2)
    recording.add(SampleBlock("audio.fingers", 0, 0.0, values, rate_hz=96_000.0, unit="FS"))
    evidence = TrialEvidence({}, recording, entered_s={"SILENT": 2.0, "SWEEPING": 3.0, "RINGING": 4.0})
    _, row = chirp.measure(evidence, ChirpSettings(duration_s=1.0), "swept")
    # half a square over the noise's variance
    assert row["over_noise_db"] == pytest.approx(10 * math.log10(0.5 / 1e-6), abs=1.0)


def test_a_sweep_that_did_not_come_to_its_end_gives_no_frequency():
    recording = TrialRecording(1)
    recording.add(SampleBlock("audio.fingers", 0, 0.0, np.ones((96_000, 2)), rate_hz=96_000.0, unit="FS"))
    evidence = TrialEvidence({}, recording, entered_s={"SILENT": 0.0, "SWEEPING": 0.2, "FAILED": 0.9})
    assert chirp.measure(evidence, ChirpSettings(), "fault") == ("fault", dict.fromkeys(chirp.COLUMNS))


def test_a_sweep_downwards_is_a_mistake_of_the_profile():
    with pytest.raises(ValueError, match="from_hz must be below to_hz"):
        ChirpSettings(from_hz=46_000.0, to_hz=20_000.0)
