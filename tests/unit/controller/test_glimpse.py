import math
from types import SimpleNamespace

import numpy as np
import pytest

from controller.glimpse import BARS, SPARKS, Glimpse, sparkline
from controller.guard import GuardSettings
from controller.recording.series import TrialRecording
from drivers.messages import SampleBlock


def block(stream, values, unit, start_s=0.0):
    values = np.asarray(values, float).reshape(-1, 1)
    return SampleBlock(stream, 0, start_s, values, 100.0, None, unit)


def test_a_sparkline_runs_from_the_least_to_the_largest():
    assert sparkline([0.0, 7.0, math.nan, 3.0]) == f"{BARS[0]}{BARS[7]} {BARS[3]}"
    assert sparkline([2.0, 2.0]) == BARS[0] * 2
    assert sparkline([]) == ""


def test_a_glimpse_shows_the_deciding_signal_its_threshold_and_the_guards_margins():
    recording = TrialRecording(1)
    detector = SimpleNamespace(inputs=("board.period",))
    limits = GuardSettings(
        force_stream="board.load_cell", force_n=2.0, position_stream="stage.position", travel_m=0.012
    )
    glimpse = Glimpse(recording, {"contact": detector}, limits)
    assert glimpse.lines() == [], "nothing has arrived"
    recording.add(block("board.period", 1.0 / np.linspace(27.0, 28.0, 60), "s"))
    readings = np.array([[28.02, 28.13]])
    recording.add(SampleBlock("detector.contact", 0, 1.0, readings, times_s=np.array([1.0])))
    recording.add(block("board.load_cell", [0.1, -0.04], "N"))
    recording.add(block("stage.position", [0.0031], "m"))
    signal, margins = glimpse.lines()
    assert signal.startswith("board.period  ")
    assert len(signal) == 80, "the threshold has its place, whatever the bars leave"
    wide, _ = glimpse.lines(120)
    assert sum(letter in BARS for letter in wide) == SPARKS
    assert signal.endswith("28 Hz  contact 28.02 of 28.13")
    assert margins == "force 0.04 of 2.0 N  travel 3.10 of 12.0 mm"


def test_the_latest_samples_come_from_the_last_blocks():
    recording = TrialRecording(1)
    for start in range(0, 9, 3):
        recording.add(block("a", range(start, start + 3), "N"))
    values, unit = recording.latest("a", 4)
    assert (values[:, 0].tolist(), unit) == ([5.0, 6.0, 7.0, 8.0], "N")
    assert len(recording.latest("b", 4)[0]) == 0


class Raising:
    """A detector of a user's own whose inputs cannot be read."""

    @property
    def inputs(self):
        raise ZeroDivisionError("no samples")


@pytest.mark.parametrize(
    ("detector", "lines"),
    [
        (SimpleNamespace(inputs=()), []),
        (Raising(), ["Raising cannot be shown: ZeroDivisionError: no samples"]),
    ],
)
def test_a_detector_that_cannot_be_shown_ends_no_trial(detector, lines):
    recording = TrialRecording(1)
    recording.add(block("board.period", [0.5, 1.0], "s"))
    assert Glimpse(recording, {"own": detector}, GuardSettings(travel_m=0.012)).lines() == lines
