import math
from types import SimpleNamespace

import numpy as np

from behaviors.events import Approached, Forecast
from controller.detectors.protocol import Quantity
from controller.guard import GuardSettings
from controller.live_view import BARS, SPARKS, LiveView, label, sparkline
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock

LIMITS = GuardSettings(travel_m=0.012)
WAITS = SimpleNamespace(deciding=())


def block(stream, values, unit, start_s=0.0):
    values = np.asarray(values, float).reshape(-1, 1)
    return SampleBlock(stream, 0, start_s, values, 100.0, None, unit)


def view_of(recording, detectors, limits=LIMITS, behavior=WAITS, events=()):
    return LiveView(recording, detectors, limits, behavior, events, {}, lambda: 0.0)


def test_a_sparkline_runs_from_the_least_to_the_largest_of_the_latest_samples():
    assert sparkline([0.0, 7.0, math.nan, 3.0]) == f"{BARS[0]}{BARS[7]} {BARS[3]}"
    assert sparkline([2.0, 2.0]) == BARS[0] * 2
    assert sparkline([]) == ""
    recording = TrialRecording(1)
    for start in range(0, 9, 3):
        recording.add(block("a", range(start, start + 3), "N"))
    values, unit = recording.latest("a", 4)
    assert (values[:, 0].tolist(), unit) == ([5.0, 6.0, 7.0, 8.0], "N")
    assert len(recording.latest("b", 4)[0]) == 0


def test_a_glimpse_shows_the_deciding_signal_its_threshold_and_the_guards_margins():
    recording = TrialRecording(1)
    detector = SimpleNamespace(inputs=("board.period",))
    streams = {"force_stream": "board.load_cell", "position_stream": "stage.position"}
    limits = GuardSettings(force_n=2.0, travel_m=0.012, **streams)
    view = view_of(recording, {"contact": detector}, limits)
    assert view.lines() == [], "nothing has arrived"
    recording.add(block("board.period", 1.0 / np.linspace(27.0, 28.0, 60), "s"))
    readings = np.array([[28.02, 28.13]])
    recording.add(SampleBlock("detector.contact", 0, 1.0, readings, times_s=np.array([1.0])))
    recording.add(block("board.load_cell", [0.1, -0.04], "N"))
    recording.add(block("stage.position", [0.0031], "m"))
    signal, margins = view.lines()
    assert signal.startswith("board.period  ")
    assert len(signal) == 80, "the threshold has its place, whatever the bars leave"
    wide, _ = view.lines(120)
    assert sum(letter in BARS for letter in wide) == SPARKS
    assert signal.endswith("28 Hz  contact 28.02 of 28.13")
    assert margins == "force 0.04 of 2.0 N  travel 3.10 of 12.0 mm"


def test_what_an_approach_will_do_is_shown_until_it_has_done_it():
    events = [Forecast(0.1, "stage", 0.004, 0.0003, None, 1.5)]
    view = view_of(TrialRecording(1), {}, events=events)
    assert view.lines() == ["stage: forecast, speed 4 mm/s, travel 0.3 mm, most 1.5 N"]
    events.append(Approached(0.9, "stage", 0.0002, 0.15))
    assert view.lines() == ["stage: approached, travel 0.2 mm, pressed 0.15 N"]


def test_what_decides_is_shown_whatever_the_profiles_order():
    recording = TrialRecording(1)
    waveform = SimpleNamespace(inputs=("board.accelerometer",), quantity=Quantity("departure", "σ"))
    detectors = {"contact": SimpleNamespace(inputs=("board.period",)), "ours": waveform}
    plan = SimpleNamespace(detectors=frozenset({"contact", "ours"}))
    behavior = SimpleNamespace(deciding=["ours"], acts_on=frozenset({"ours", "touch"}), plan=plan)
    view = view_of(recording, detectors, behavior=behavior)
    recording.add(block("board.period", [0.5, 1.0], "s"))
    recording.add(block("board.accelerometer", [1.0, 1.5], "m/s2"))
    for name, pair, unit in (("contact", [28.0, 28.2], "Hz"), ("ours", [2.1, 5.3], "σ")):
        held = np.array([pair])
        recording.add(SampleBlock(f"detector.{name}", 0, 1.0, held, times_s=np.ones(1), unit=unit))
    (signal,) = view.lines()
    assert signal.startswith("board.accelerometer  ")
    assert signal.endswith("1.5 m/s²  ours 2.1 of 5.3 σ")
    assert {name: acts for name, *_, acts in view.thresholds()} == {"ours": True, "contact": False}
    assert view.panels()[0] == "detector.ours"
    assert (label("detector.ours", "σ"), view.title("detector.ours")) == ("ours, σ", "ours: departure")
    assert view.title("detector.contact") == "contact: statistic"
    assert view.title("board.period") == ""


class Raising:
    """A detector of a user's own whose inputs cannot be read."""

    @property
    def inputs(self):
        raise ZeroDivisionError("no samples")


def test_a_detector_that_cannot_be_shown_ends_no_trial():
    recording = TrialRecording(1)
    recording.add(block("board.period", [0.5, 1.0], "s"))
    assert view_of(recording, {"own": SimpleNamespace(inputs=())}).lines() == []
    (line,) = view_of(recording, {"own": Raising()}).lines()
    assert line == "Raising cannot be shown: ZeroDivisionError: no samples"
