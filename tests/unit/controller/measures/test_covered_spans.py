"""A measure gets no number from a span that is not covered."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from controller.measures.trial import EDGE_S, MissingDataError, TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import Lost, SampleBlock, StreamInfo
from tests.refusals import refused

FORCE = StreamInfo("board.force", ("force",), "N", rate_hz=1000.0)
PLACE = StreamInfo("arm.position", ("position",), "m", rate_hz=500.0, longest_s=0.02)
PERIOD = StreamInfo("board.period", ("period",), "s", longest_s=0.2)
LOAD = StreamInfo("person.load", ("x",), "N")
LISTENER = SimpleNamespace(name="touch", inputs=("board.force", "arm.position"))
INFOS = {info.name: info for info in (FORCE, PLACE, PERIOD, LOAD)}


def part(info, first_s, last_s):
    """What a stream sends from one time up to before another, numbered as if it had always been sent."""
    rate_hz = info.rate_hz or 20.0
    first, last = round(first_s * rate_hz), round(last_s * rate_hz)
    times_s = None if info.rate_hz else np.arange(first, last) / rate_hz
    values = np.ones((last - first, 1))
    grid = {"rate_hz": info.rate_hz, "times_s": times_s}
    return SampleBlock(info.name, first, first / rate_hz, values, **grid, unit="x")


def evidence(info, *spans_s, skipped=(), **more):
    recording = TrialRecording(1)
    for first_s, last_s in spans_s:
        recording.add(part(info, first_s, last_s))
    for span_s in skipped:
        recording.skip(info.name, *span_s)
    return TrialEvidence({}, recording, streams=INFOS, **more)


def test_a_covered_span_is_given_whatever_is_missing_outside_of_it_or_under_way_at_its_end():
    found = evidence(FORCE, (0.0, 2.0))
    assert len(found.stream("board.force", 0.5, 1.5)) == 1000
    assert len(found.series("board.force", 0.5, 1.5)[1]) == 1001
    found = evidence(FORCE, (0.4, 0.45), (0.5, 1.5), (1.7, 2.0))
    assert len(found.stream("board.force", 0.5, 1.5)) == 1000
    found = evidence(FORCE, (0.0, 1.5 - 0.9 * EDGE_S))
    assert len(found.stream("board.force", 0.5, 1.5))


@pytest.mark.parametrize(
    ("spans_s", "hole"),
    [
        ([(0.0, 1.0)], "0.999 to 1.500"),  # fell silent
        ([(0.8, 2.0)], "0.500 to 0.800"),  # began late
        ([(0.0, 1.0), (1.002, 2.0)], "0.999 to 1.002"),  # two samples lost
        ([], "0.500 to 1.500"),
    ],
)
def test_a_span_with_a_hole_gives_no_number_but_its_place(spans_s, hole):
    with refused(MissingDataError, f"board.force: no samples from {hole} s", " of board, then run"):
        evidence(FORCE, *spans_s).series("board.force", 0.5, 1.5)


@pytest.mark.parametrize("noticed_s", [0.55, 0.57])  # with the first sample, or when that one is read
def test_what_was_lost_before_the_first_sample_is_a_hole_however_short(noticed_s):
    lost = Lost(noticed_s, "board", "board.force", 50)
    assert len(evidence(FORCE, (0.55, 2.0)).stream("board.force", 0.5, 1.5)), "it may begin so late"
    with pytest.raises(MissingDataError, match=r"0.500 to 0.550"):
        evidence(FORCE, (0.55, 2.0), events=[lost]).stream("board.force", 0.5, 1.5)
    before = Lost(0.45, "board", "board.force", 50)
    assert len(evidence(FORCE, (0.55, 2.0), events=[before]).stream("board.force", 0.5, 1.5))


def test_what_is_no_number_is_missing_in_the_channels_that_are_used_and_nothing_in_a_signal():
    sent = part(FORCE, 0.0, 2.0)
    sent = replace(sent, values=np.ones((len(sent), 2)))
    sent.values[1000, 1] = np.nan
    found = evidence(FORCE)
    found.recording.add(sent)
    assert len(found.series("board.force", 0.5, 1.5)[1]) == 1001
    assert len(found.series("board.force", 1.001, 1.5, channel=1)[1]) == 500
    for use in (found.stream, lambda *span: found.series(*span, channel=1)):
        with pytest.raises(MissingDataError, match=r"0.999 to 1.001"):
            use("board.force", 0.5, 1.5)
    made = evidence(FORCE, sources={"board.force": ("board.raw",)})
    made.recording.add(sent)
    assert len(made.stream("board.force", 0.5, 1.5)) == 1000


@pytest.mark.parametrize(("gap_s", "borne"), [(0.016, True), (0.03, False)])
def test_a_stream_bears_holes_as_long_as_it_states(gap_s, borne):
    found = evidence(PLACE, (0.0, 1.0), (1.0 + gap_s, 2.0))
    if borne:
        assert len(found.stream("arm.position", 0.5, 1.5))
    else:
        with pytest.raises(MissingDataError):
            found.stream("arm.position", 0.5, 1.5)


def test_periods_are_above_zero_with_a_bound_of_their_own_and_an_operators_entry_has_none():
    assert len(evidence(PERIOD, (0.0, 2.0)).stream("board.period", 0.5, 1.5))
    with pytest.raises(MissingDataError, match=r"0.950 to 1.300"):
        evidence(PERIOD, (0.0, 1.0), (1.3, 2.0)).stream("board.period", 0.5, 1.5)
    assert len(evidence(LOAD, (0.0, 0.1)).covered("person.load", 0.0, 90.0)) == 2
    found = evidence(PERIOD, (0.0, 2.0))
    assert len(found.periods("board.period", 0.5, 1.5)[1]) == 21
    broken = part(PERIOD, 2.0, 3.0)
    broken.values[3] = 0.0
    found.recording.add(broken)
    with pytest.raises(MissingDataError, match=r"board.period: 0 s at 2.150 s is no period"):
        found.periods("board.period", 0.5, 2.9)


def test_an_open_span_ends_with_the_trial_and_an_unsubscribed_one_is_no_hole_unless_it_is_all():
    found = evidence(FORCE, (0.0, 2.0), visits=[("A", 0.0), ("DONE", 2.0)])
    assert len(found.covered("board.force", 0.5)) == 2000
    found.visits[-1] = ("DONE", 3.0)
    with pytest.raises(MissingDataError, match=r"1.999 to 3.000"):
        found.covered("board.force", 0.5)
    halves = evidence(FORCE, (0.0, 1.0), (1.4, 2.0), skipped=[(1.0, 1.4)])
    assert len(halves.stream("board.force", 0.5, 1.5)) == 600
    with pytest.raises(MissingDataError, match=r"1.050 to 1.350"):
        halves.series("board.force", 1.05, 1.35)


def test_a_detectors_silence_counts_where_all_its_inputs_came_and_a_signal_is_as_strict_as_its_source():
    found = evidence(FORCE, (0.0, 2.0), detectors={"touch": LISTENER})
    with pytest.raises(MissingDataError, match=r"arm.position: no samples from 0.500 to 1.500 s"):
        found.require_samples("touch", 0.5, 1.5)
    found.recording.add(part(PLACE, 0.0, 2.0))
    found.require_samples("touch", 0.5, 1.5)
    found = evidence(FORCE, (0.0, 2.0), sources={"signals.tip": ("board.force",)})
    with pytest.raises(MissingDataError, match=r"signals.tip: no samples .* of board, then"):
        found.covered("signals.tip", 0.5, 1.5)
