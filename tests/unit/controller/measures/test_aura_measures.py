"""C2 to C5 measured on evidence written by hand."""

import numpy as np
import pytest

from behaviors.aura import AuraSettings
from behaviors.centering import CenteringSettings
from behaviors.events import Contact, ContactHeld, ContactLost, PreTouch
from controller.measures import aura, centering
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import Gripped, MoveAt, Reached, SampleBlock, Sent, Standstill, Stop

PATHS = {"x": {"start_m": (0.0, 0.0, 0.0), "end_m": (0.05, 0.0, 0.0)}}


def approach(events, truth, thing="pipe", per_cm=2.33, until_s=14.0):
    """Rest 0 to 2 s, approach 2 to 7 s at 1 cm/s, hold to 9 s, back to 14 s; an envelope with `per_cm` undulations."""
    recording = TrialRecording(1)
    times_s = np.arange(0.0, until_s, 0.002)
    x_m = np.interp(times_s, [0.0, 2.0, 7.0, 9.0, 14.0], [0.0, 0.0, 0.05, 0.05, 0.0])
    pose = np.column_stack([x_m, *[np.zeros_like(x_m)] * 5])
    recording.add(SampleBlock("arm.pose", 0, 0.0, pose, rate_hz=500.0, unit="m"))
    fine_s = np.arange(0.0, until_s, 0.001)
    z = np.exp(2j * np.pi * 100.0 * per_cm * np.interp(fine_s, times_s, x_m))
    iq = np.column_stack([z.real, z.imag])
    recording.add(SampleBlock("signals.right", 0, 0.0, iq, rate_hz=1000.0, unit="FS"))
    visits = [("BASELINE", 0.0), ("APPROACHING", 2.0), ("HOLDING", 7.0), ("RETRACTING", 9.0)]
    visits.append(("LEAVING", 14.0))
    events = sorted(events, key=lambda event: event.t_s)
    return TrialEvidence({"object": thing}, recording, events=events, visits=visits, truth=truth)


def row_of(events, truth=(), **extra):
    gap_m = extra.pop("end_gap_m", 0.0)
    settings = AuraSettings(paths=PATHS, end_gap_m=gap_m, methods=extra.pop("methods", ("paper", "ours")))
    known = None if truth is None else list(truth)
    return aura.measure(approach(events, known, **extra), settings, "approached")[1]


def near(t_s, method="ours"):
    return PreTouch(t_s, f"pretouch_{method}", 1.0, 0.5)


TOUCH = ((6.0, True), (9.5, False))


def made(t_s, method="ours"):
    return Contact(t_s, f"contact_{method}", 9.0, 5.0)


def held(t_s):
    return ContactHeld(t_s, "contact_ours", 9.0, 5.0)


def lost(t_s, method="ours"):
    return ContactLost(t_s, f"contact_{method}", 1.0, 5.0)


@pytest.mark.parametrize("per_cm", [2.33, 1.5])
def test_undulations_are_counted_along_the_way(per_cm):
    assert row_of([], per_cm=per_cm)["undulations_per_cm"] == pytest.approx(per_cm, abs=0.02)


@pytest.mark.parametrize(
    ("t_s", "given", "seen", "alarms", "distance_m"),
    [
        pytest.param(4.0, {"truth": TOUCH}, 1, 0, 0.02, id="in time: the distance is to the touch"),
        pytest.param(4.0, {"end_gap_m": 0.004}, 1, 0, 0.034, id="no touch: from beyond the way's end"),
        pytest.param(6.5, {"truth": TOUCH}, 0, 0, None, id="after the touch"),
        pytest.param(1.0, {"truth": TOUCH}, 0, 1, None, id="before the approach"),
        pytest.param(4.0, {"thing": "none"}, None, 1, None, id="before nothing"),
    ],
)
def test_pre_touch_is_seen_or_an_alarm(t_s, given, seen, alarms, distance_m):
    row = row_of([near(t_s)], **given)
    assert (row["seen_ours"], row["alarms_ours"]) == (seen, alarms)
    assert row["distance_m_ours"] == (distance_m and pytest.approx(distance_m, abs=1e-4))


def test_a_detector_that_reported_nothing_saw_nothing_and_one_that_was_not_asked_has_no_column():
    assert row_of([near(4.0)], TOUCH)["seen_paper"] == 0
    assert row_of([near(4.0)], TOUCH, methods=("ours",))["seen_paper"] is None


def test_an_approach_that_a_pause_broke_off_is_no_approach_and_the_next_one_is_one():
    """Paused at 1 s, sent back, and begun again: the whole approach of `approach` is the second one."""
    evidence = approach([near(4.0)], [])
    broken = [("BASELINE", 0.0), ("APPROACHING", 0.5), ("RETRACTING", 1.0), ("BASELINE", 1.5)]
    evidence.visits = [*broken, *evidence.visits[1:]]
    _, row = aura.measure(evidence, AuraSettings(paths=PATHS, end_gap_m=0.0), "approached")
    assert (row["approaches"], row["seen_ours"]) == (1, 1)
    evidence.visits = [*broken[:3], ("LEAVING", 1.5)]
    _, row = aura.measure(evidence, AuraSettings(paths=PATHS, end_gap_m=0.0), "approached")
    assert row["approaches"] == 0


@pytest.mark.parametrize(
    ("events", "counts", "delay_s"),
    [
        pytest.param([made(6.02), held(7.0), lost(9.6)], (1, 0, 1, 1), 0.02, id="felt, held and ended"),
        pytest.param([made(6.0)], (1, 0, 0, 0), 0.0, id="at the touch"),
        pytest.param([made(5.9991)], (1, 0, 0, 0), 0.0, id="within a step before it"),
        pytest.param([made(5.9989)], (0, 1, 0, 0), None, id="more than a step before it"),
        pytest.param([made(4.0)], (0, 1, 0, 0), None, id="where nothing touches"),
        pytest.param([made(6.9)], (0, 0, 0, 0), None, id="late, yet true"),
        pytest.param([made(9.49)], (0, 0, 0, 0), None, id="while there is force"),
        pytest.param([made(9.51)], (0, 1, 0, 0), None, id="after the force is gone"),
        pytest.param([made(1.0), made(6.01)], (1, 1, 0, 0), 0.01, id="after a false one in the rest"),
        pytest.param([made(5.99), made(6.01)], (0, 1, 0, 0), None, id="after a false one on the way"),
        pytest.param([made(6.02), held(6.5), lost(7.5)], (1, 0, 0, 0), 0.02, id="taken back too soon"),
        pytest.param([made(6.02), held(6.5), lost(8.99)], (1, 0, 0, 0), 0.02, id="taken back too early"),
        pytest.param([made(6.02), held(6.5), lost(9.0)], (1, 0, 1, 1), 0.02, id="ended as it unloads"),
        pytest.param([made(6.02), held(6.5), lost(10.1)], (1, 0, 1, 0), 0.02, id="ended too late"),
    ],
)
def test_contacts_are_felt_false_held_and_ended(events, counts, delay_s):
    row = row_of(events, TOUCH)
    assert tuple(row[f"{name}_ours"] for name in ("felt", "false", "held", "ended")) == counts
    assert row["delay_s_ours"] == (delay_s if delay_s is None else pytest.approx(delay_s))
    assert (row["touches"], row["truth_contact_s"], row["truth_release_s"]) == (1, 6.0, 9.5)


REPORTED = ("reported", "reported_held", "reported_ended", "reports", "reported_of_nothing")


def reported(row, method="ours"):
    return tuple(row[f"{name}_{method}"] for name in REPORTED)


def test_where_no_touch_is_known_the_reported_contacts_are_counted():
    events = [made(6.02), held(7.0), lost(9.6), made(9.7), made(1.0, "paper"), lost(2.5, "paper")]
    row = row_of(events, truth=None)
    assert reported(row) == (1, 1, 1, 2, 0)
    assert reported(row, "paper") == (0, 0, 0, 0, 1), "in the rest before nothing can touch"
    unknown = ("touches", *(f"{name}_ours" for name in ("felt", "delay_s", "false", "held", "ended")))
    assert [row[name] for name in unknown] == [None] * 6
    assert reported(row_of(events, TOUCH)) == reported(row), "a known touch does not change the reports"
    # persistence and end are those of a contact reported in this approach
    assert reported(row_of([lost(2.5), held(3.0), made(6.0)], truth=None)) == (1, 0, 0, 1, 0)
    assert reported(row_of([made(4.0)], truth=None, thing="none")) == (1, 0, 0, 1, 1)


def test_reports_are_counted_by_approach():
    """A second approach like the first, 14 s later, in which contact is reported but not its end."""
    evidence = approach([made(6.0), lost(9.6), made(20.0)], None, until_s=28.0)
    first = [*evidence.visits[:-1], ("BASELINE", 14.0)]
    evidence.visits = [*first, *((state, t_s + 14.0) for state, t_s in evidence.visits[1:])]
    _, row = aura.measure(evidence, AuraSettings(paths=PATHS), "approached")
    assert row["approaches"] == 2
    assert reported(row) == (2, 0, 1, 2, 0)


def found(events, visits, truth=(), outcome="centered"):
    factors = {"object_x_m": 0.002, "method": "ours"}
    seen = (TrialRecording(1), list(events), dict(visits), list(visits), list(truth))
    evidence = TrialEvidence(factors, *seen)
    return centering.measure(evidence, CenteringSettings(), outcome)[1]


VISITS = [("SEEKING_FORWARD", 6.0), ("SEEKING_BACKWARD", 6.6), ("CENTERING", 8.1), ("RESTING", 9.0)]


def test_the_error_is_where_it_stands_less_where_the_object_is():
    events = [
        PreTouch(6.5, "left_ours", 1.0, 0.5, 0.005),
        PreTouch(8.0, "right_ours", 1.0, 0.5),
        Standstill(8.1, "arm", -0.0016),
        Reached(9.0, "arm", 0.0017),
    ]
    row = found(events, VISITS)
    assert row["error_m"] == pytest.approx(-0.0003)
    assert (row["left_m"], row["right_m"]) == (0.005, -0.0016)
    assert row["search_s"] == pytest.approx(2.1)
    assert row["gripped"] is None


def test_a_search_that_never_ended_has_no_error_and_the_result_before_a_pause_is_discarded():
    truth = [(5.0, True), (5.5, False), (6.2, True)]
    row = found([], [("SEEKING_FORWARD", 6.0), ("LEAVING", 7.0)], truth, outcome="touched")
    assert (row["error_m"], row["touched"]) == (None, 1)
    # Paused on its way to the middle, the search restarts and detects nothing.
    events = [PreTouch(6.5, "left_ours", 1.0, 0.5, 0.005), PreTouch(8.0, "right_ours", 1.0, 0.5, -0.003)]
    again = [("SEEKING_FORWARD", 20.0), ("LEAVING", 24.0)]
    row = found([*events, Reached(24.0, "arm", 0.03)], [*VISITS[:3], *again])
    assert all(row[name] is None for name in ("error_m", "middle_m", "left_m", "right_m", "search_s"))


def test_a_grasp_reports_when_each_finger_felt_it():
    events = [Reached(9.0, "arm", 0.002), Contact(11.4, "left_contact", 9.0, 5.0)]
    events.append(Gripped(12.0, "gripper", True, 0.019, 10.0))
    visits = [*VISITS, ("CLOSING", 11.0), ("RELEASING", 14.0)]
    row = found(events, visits)
    assert row["gripped"] == 1
    assert row["contact_left_s"] == pytest.approx(0.4)
    assert row["contact_right_s"] is None


def test_the_stops_are_timed_from_the_samples_that_saw_the_object():
    events = [
        Sent(6.4, "arm", MoveAt("arm", 0.01, 0.03)),
        Sent(6.509, "gripper", Stop("gripper")),
        Sent(6.512, "arm", Stop("arm")),
        Sent(8.02, "arm", Stop("arm")),
    ]
    visits = [("SEEKING_FORWARD", 6.0), ("TURNING", 6.5), ("SEEKING_BACKWARD", 6.6), ("STOPPING", 8.0)]
    row = found(events, visits)
    assert row["seen_to_stop_left_s"] == pytest.approx(0.012)
    assert row["seen_to_stop_right_s"] == pytest.approx(0.02)
    assert found(events, visits[:1])["seen_to_stop_left_s"] is None
