"""The row of a roll-and-slip trial, from events and a recording made by hand."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from behaviors.events import (
    BaselineReady,
    BaselineRefused,
    Contact,
    GuardStopped,
    Paused,
    SlipEnded,
    SlipStarted,
)
from behaviors.slip import RollSlipSettings
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.measures.slip import COLUMNS, measure, paper_blocks
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock, Sent, Standstill, Stop

NAMED = {"stream": "board.fingertip", "channel": 1, "touch": "touch", "paper": "p", "ours": "o"}
STEPS = ({"do": "slip", "duration_s": 1.0, "speed_m_s": 0.01},)
SETTINGS = RollSlipSettings(sensors={"fingertip": {**NAMED, "press_m": 0.001, "steps": STEPS}})

VISITS = [
    *(("HOMING", 0.0), ("RESTING", 1.0), ("DESCENDING", 2.0), ("STOPPING", 3.5), ("PRESSING", 3.6)),
    *(("HOLDING", 4.0), ("SLIPPING", 5.0), ("HOLDING", 6.0), ("LIFTING", 8.0)),
]

BOTH = [*VISITS[:-1], ("SLIPPING", 7.0), ("LIFTING", 8.0)]
"""Forth, and back."""


def recorded(*blocks):
    recording = TrialRecording(1)
    for block in blocks:
        recording.add(block)
    return recording


def started(t_s, detector):
    return SlipStarted(t_s, detector, 12.0, 7.0)


def ended(t_s, detector):
    return SlipEnded(t_s, detector, 1.0, 7.0)


def tone(hz=187.5, volt=0.2, since_s=5.02, until_s=6.0, gap=0):
    """Three channels at 1 kHz, the second with a tone while it slips; `gap` samples are lost in its middle."""
    times_s = np.arange(1000, 8000) / 1000.0
    values = np.zeros((len(times_s), 3))
    slipping = (times_s >= since_s) & (times_s < until_s)
    values[:, 1] = volt * np.sin(2 * np.pi * hz * times_s) * slipping
    spans = ((0, 4500), (4500 + gap, 7000))
    parts = [(1000 + first, times_s[first], values[first:last]) for first, last in spans]
    return [SampleBlock("board.fingertip", *part, rate_hz=1000.0, unit="V") for part in parts]


def ours(threshold=20.0):
    return SlipDetector("o", SlipSettings(input="board.fingertip", channel=1, threshold=threshold))


ARMED: Any = SimpleNamespace(inputs=())
"""A detector that was armed, and whose samples count for nothing here."""


def evidence(
    events=(), slips=((5.02, True), (6.0, False)), blocks=(), extra=(), visits=VISITS, detectors=None
):
    listed = [Contact(3.5, "touch", 0.4, 0.3), *events, *extra]
    listed.sort(key=lambda event: event.t_s)
    seen = (recorded(*blocks), listed, dict(visits), list(visits))
    armed = {"o": ARMED, "p": ARMED} | (detectors or {})
    touch = [(3.4, True), (8.1, False)]
    return TrialEvidence({"sensor": "fingertip"}, *seen, truth=touch, slips=slips, detectors=armed)


def row_of(*args, **given):
    outcome, row = measure(evidence(*args, **given), SETTINGS, "contact")
    assert outcome == "contact"
    assert set(row) <= set(COLUMNS)
    return row


def test_delays_run_from_the_true_slip_to_each_detectors_first_event():
    row = row_of([started(5.026, "o"), started(5.108, "p"), ended(6.05, "o"), ended(6.08, "p")])
    assert (row["reference"], row["slips"], row["slip_s"], row["slip_end_s"]) == ("truth", 1, 5.02, 6.0)
    assert row["ours_delay_s"] == row["ours_first_delay_s"] == pytest.approx(0.006)
    assert row["paper_delay_s"] == pytest.approx(0.088)
    for who in ("paper", "ours"):
        counts = [row[f"{who}_{what}"] for what in ("detected", "missed", "early", "false_alarms")]
        assert counts == [1, 0, 0, 0]
    assert (row["clock_s"], row["touch_s"], row["touch_truth_s"]) == (1.0, 3.5, 3.4)


def test_an_event_after_the_patience_is_a_miss_and_none_is_one_too():
    row = row_of([started(5.02 + 0.76, "o")])
    assert (row["ours_missed"], row["ours_detected"], row["ours_delay_s"]) == (1, 0, None)
    assert row["paper_missed"] == 1
    assert row["ours_false_alarms"] == 0, "late, not false"


@pytest.mark.parametrize(
    ("event_s", "detected", "early"),
    [(4.9, 0, 1), (5.01, 0, 1), (5.0189, 0, 1), (5.0191, 1, 0), (5.02, 1, 0)],
)
def test_an_event_more_than_a_step_before_the_slip_is_early_and_a_false_alarm(event_s, detected, early):
    row = row_of([started(event_s, "o"), ended(5.5, "o")])
    assert (row["ours_detected"], row["ours_missed"]) == (detected, 0)
    assert (row["ours_early"], row["ours_false_alarms"]) == (early, early)
    assert row["ours_delay_s"] == (0.0 if detected else None)
    assert (row["slide_s"], row["slip_s"]) == (5.0, 5.02)
    assert row["ours_event_s"] == (event_s if event_s >= 5.0 else None)


LATE = [started(5.03, "o"), ended(5.9, "o"), started(6.1, "o"), ended(6.2, "o")]


@pytest.mark.parametrize(
    ("events", "at_touch", "false"),
    [
        pytest.param(
            [started(3.42, "o"), ended(3.5, "o"), started(3.7, "o"), ended(3.8, "o"), started(4.6, "o")],
            2,
            1,
            id="descent",
        ),
        pytest.param(LATE, 0, 0, id="just after the end: late"),
        pytest.param([*LATE, started(6.3, "o")], 0, 1, id="long after it"),
    ],
)
def test_alarms_of_the_descent_are_counted_apart_and_a_late_one_is_not_false(events, at_touch, false):
    row = row_of(events)
    assert (row["ours_touch_alarms"], row["ours_false_alarms"]) == (at_touch, false)


def test_quiet_is_what_is_neither_descent_nor_slip_nor_the_time_in_which_a_detector_learns():
    # rest 1 to 2 s, after pressing from 4.2 s to the slip at 5.02 s, after it from 6.2 s until it lifts at 8 s
    row = row_of()
    assert row["listen_s"] == 1.0
    assert row["paper_quiet_s"] == row["ours_quiet_s"] == pytest.approx(1.0 + 0.82 + 1.8)
    row = row_of(blocks=tone(), detectors={"o": ours()})
    assert row["paper_quiet_s"] == pytest.approx(1.0 + 0.82 + 1.8)
    assert row["ours_quiet_s"] == pytest.approx(0.82 + 1.8), "it learns in the second at rest"


def test_how_long_ours_takes_at_least_follows_from_threshold_rate_and_the_worth_of_a_knock():
    # a knock is worth ln(200 / 1) nats at once, and a ninth of it each ms after that
    knock = np.log(200.0)
    row = row_of(blocks=tone(), detectors={"o": ours(threshold=20.0)})
    assert row["ours_least_delay_s"] == pytest.approx(0.001 * np.ceil((20.0 - knock) / (knock / 9.0)))
    assert row_of(blocks=tone())["ours_least_delay_s"] is None, "the detector is unknown"


@pytest.mark.parametrize(
    ("end_s", "visits", "extra", "missed"),
    [
        pytest.param(5.05, [*VISITS[:7], ("LIFTING", 9.0)], [GuardStopped(5.04, "force")], 0, id="guard"),
        pytest.param(5.05, [*VISITS[:7], ("LIFTING", 9.0)], [Paused(5.04)], 0, id="pause"),
        pytest.param(5.05, [*VISITS[:7], ("FAILED", 5.05)], [], 0, id="failed"),
        pytest.param(5.05, VISITS[:7], [Sent(5.06, "arm", Stop("arm"))], 0, id="fault without an event"),
        pytest.param(5.05, VISITS, [], 1, id="ended by itself"),
        pytest.param(5.5, [*VISITS[:7], ("LIFTING", 5.5)], [], 1, id="step ended as planned"),
    ],
)
def test_a_slip_that_was_cut_short_is_not_missed_and_a_short_one_is(end_s, visits, extra, missed):
    row = row_of(slips=((5.02, True), (end_s, False)), visits=visits, extra=extra)
    assert (row["slips"], row["ours_missed"], row["paper_missed"]) == (1, missed, missed)


def test_a_pause_before_the_contact_restarts_the_trial_and_takes_nothing_from_its_slip():
    again = [("HOMING", 0.0), ("RESTING", 0.2), ("HOMING", 0.9), *VISITS[1:]]
    row = row_of([started(0.5, "o"), ended(0.6, "o")], extra=[Paused(0.7)], visits=again)
    assert (row["listen_s"], row["ours_missed"], row["ours_false_alarms"]) == (1.0, 1, 0)


def test_two_slides_are_two_slips_one_where_the_tip_held_is_none_and_one_without_a_command_is_not_scored():
    both = ((5.02, True), (6.0, False), (7.1, True), (8.0, False))
    events = [started(5.03, "o"), ended(6.1, "o"), started(7.13, "o")]
    row = row_of(events, both, visits=BOTH)
    assert (row["slips"], row["ours_detected"]) == (2, 2)
    assert row["ours_delay_s"] == pytest.approx(0.02), "the median of 10 and 30 ms"
    assert row_of(events, both[:2], visits=BOTH)["slips"] == 1
    slips = ((3.55, True), (3.6, False), (5.02, True), (6.0, False))
    row = row_of([started(3.56, "o"), ended(3.65, "o"), started(5.03, "o")], slips)
    assert (row["slips"], row["ours_detected"], row["ours_touch_alarms"]) == (1, 1, 0)


def test_without_the_truth_the_command_is_what_counts():
    row = row_of([started(5.03, "o")], None)
    assert (row["reference"], row["slip_s"], row["slip_end_s"]) == ("command", 5.0, 6.0)
    assert row["ours_delay_s"] == pytest.approx(0.03)


def test_the_papers_product_the_frequency_that_dominates_and_the_press_are_those_of_the_slip():
    row = row_of(blocks=tone())
    # a tone of amplitude A in the middle of a bin has A^2 N / 4 of the power
    assert row["peak_product"] == pytest.approx(0.2**2 * 64 / 4 * 187.5, rel=0.02)
    assert row["dominant_hz"] == pytest.approx(187.5)
    assert row["peak_product_before"] == pytest.approx(0.0, abs=1e-12)
    times_s = np.arange(0.0, 9.0, 0.002)
    values = np.zeros((len(times_s), 6))
    values[(times_s > 3.8) & (times_s < 8.1), 2] = 5.0
    force = SampleBlock("arm.force", 0, 0.0, values, rate_hz=500.0, unit="N")
    assert row_of(blocks=[force])["press_n"] == pytest.approx(5.0)


def test_the_stop_is_timed_from_the_deciding_sample_to_the_command_on_its_way():
    events = [started(5.026, "o")]
    stop = [Sent(5.031, "arm", Stop("arm")), Standstill(5.05, "arm", 0.004)]
    times_s = np.arange(4.0, 6.0, 0.002)
    pose = np.zeros((len(times_s), 6))
    pose[:, 0] = 0.01 * np.clip(times_s - 5.0, 0.0, 0.035)
    visits = [*VISITS[:7], ("HALTING", 5.026), ("STOPPED", 5.05), ("LIFTING", 5.55)]
    blocks = [SampleBlock("arm.pose", 0, 4.0, pose, rate_hz=500.0, unit="m")]
    row = row_of(events, extra=stop, visits=visits, blocks=blocks)
    assert row["slip_to_stop_s"] == pytest.approx(0.005)
    assert (row["ours_detected"], row["paper_missed"]) == (1, 0), "the paper's had no time to detect it"
    assert row["stop_travel_m"] == pytest.approx(0.01 * 0.009, abs=1e-6)


def test_a_trial_that_never_touched_has_no_slips_and_a_detector_that_never_learned_no_columns():
    bare = replace(evidence(slips=None, visits=[("RESTING", 1.0)]), events=[])
    outcome, row = measure(bare, SETTINGS, "no_contact")
    assert outcome == "no_contact"
    assert (row["slips"], row["ours_missed"], row["peak_product"], row["touch_s"]) == (0, 0, None, None)
    refused = BaselineRefused(2.0, "o", 0.1, 0.02, "it vibrates")
    row = row_of([refused, started(5.108, "p")])
    assert {value for name, value in row.items() if name.startswith("ours_")} == {None}
    assert row["paper_detected"] == 1
    learned = BaselineReady(2.5, "o", 0.02, 20.0)
    assert row_of([refused, learned])["ours_missed"] == 1


@pytest.mark.parametrize("gap", [0, 30])
def test_the_papers_blocks_are_its_detectors_own_begun_with_listening_and_after_a_gap(gap):
    blocks = tone(gap=gap)
    threshold = 0.02**2 * 64 / 4 * 187.5
    settings = SlipPaperSettings(input="board.fingertip", channel=1, threshold=threshold)
    detector = SlipPaperDetector("p", settings)
    # it is subscribed from the second block on: 5.5 s is in the middle of a block of those that begin at 2 s
    events = detector.push(blocks[1])
    found = paper_blocks(blocks, 1, listen_s=blocks[1].t0_s)
    assert events
    for event in events:
        (at,) = np.flatnonzero(np.isclose(found.end_s, event.t_s))
        assert found.product[at] == pytest.approx(event.value)
    first = np.flatnonzero(found.begin_s > blocks[0].last_s - 1e-6)[0]
    assert found.begin_s[first] == pytest.approx(blocks[1].t0_s - 0.001), "a period before the first sample"
