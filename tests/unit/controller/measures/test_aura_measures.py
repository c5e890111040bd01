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
SPEED_M_S = 0.01


def approach(events, truth, thing="pipe", per_cm=2.33, until_s=14.0):
    """Rest 0 to 2 s, approach 2 to 7 s at 1 cm/s, hold to 9 s, back to 14 s; an envelope with `per_cm` undulations."""
    recording = TrialRecording(1)
    times_s = np.arange(0.0, until_s, 0.002)
    x_m = np.interp(times_s, [0.0, 2.0, 7.0, 9.0, 14.0], [0.0, 0.0, 0.05, 0.05, 0.0])
    pose = np.column_stack([x_m, *[np.zeros_like(x_m)] * 5])
    recording.add(SampleBlock("arm.pose", 0, 0.0, pose, rate_hz=500.0, unit="m"))
    fine_s = np.arange(0.0, until_s, 0.001)
    z = np.exp(2j * np.pi * 100.0 * per_cm * np.interp(fine_s, times_s, x_m))
    recording.add(
        SampleBlock("signals.right", 0, 0.0, np.column_stack([z.real, z.imag]), rate_hz=1000.0, unit="FS")
    )
    return TrialEvidence(
        {"object": thing},
        recording,
        events=sorted(events, key=lambda event: event.t_s),
        visits=[
            ("BASELINE", 0.0),
            ("APPROACHING", 2.0),
            ("HOLDING", 7.0),
            ("RETRACTING", 9.0),
            ("LEAVING", 14.0),
        ],
        truth=truth,
    )


def row_of(events, truth=(), **extra):
    gap_m = extra.pop("end_gap_m", 0.0)
    settings = AuraSettings(paths=PATHS, end_gap_m=gap_m, methods=extra.pop("methods", ("paper", "ours")))
    known = None if truth is None else list(truth)
    return aura.measure(approach(events, known, **extra), settings, "approached")[1]


def near(t_s, method="ours"):
    return PreTouch(t_s, f"pretouch_{method}", 1.0, 0.5)


TOUCH = ((6.0, True), (9.5, False))


def test_undulations_are_counted_along_the_way():
    assert row_of([])["undulations_per_cm"] == pytest.approx(2.33, abs=0.02)
    assert row_of([], per_cm=1.5)["undulations_per_cm"] == pytest.approx(1.5, abs=0.02)


def test_pre_touch_in_time_is_seen_and_its_distance_is_to_the_touch():
    row = row_of([near(4.0)], TOUCH)
    assert (row["seen_ours"], row["alarms_ours"]) == (1, 0)
    assert row["distance_m_ours"] == pytest.approx(0.02, abs=1e-4)
    assert row["seen_paper"] == 0, "it reported nothing"
    assert row_of([near(4.0)], TOUCH, methods=("ours",))["seen_paper"] is None, "it was not asked"


def test_without_a_touch_the_distance_counts_from_beyond_the_ways_end():
    row = row_of([near(4.0)], end_gap_m=0.004)
    assert row["distance_m_ours"] == pytest.approx(0.034, abs=1e-4)


def test_pre_touch_after_the_touch_or_before_the_approach_is_not_seen():
    assert row_of([near(6.5)], TOUCH)["seen_ours"] == 0
    early = row_of([near(1.0)], TOUCH)
    assert (early["seen_ours"], early["alarms_ours"]) == (0, 1)


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


def test_pre_touch_before_nothing_is_an_alarm():
    row = row_of([near(4.0)], thing="none")
    assert (row["alarms_ours"], row["seen_ours"]) == (1, None)


def test_a_touch_is_felt_held_and_ended():
    events = [
        Contact(6.02, "contact_ours", 9.0, 5.0),
        ContactHeld(7.0, "contact_ours", 9.0, 5.0),
        ContactLost(9.6, "contact_ours", 1.0, 5.0),
    ]
    row = row_of(events, TOUCH)
    assert (row["touches"], row["felt_ours"], row["held_ours"], row["ended_ours"]) == (1, 1, 1, 1)
    assert row["delay_s_ours"] == pytest.approx(0.02)
    assert row["false_ours"] == 0


@pytest.mark.parametrize(
    ("before_s", "felt", "false"), [(-0.02, 1, 0), (0.0, 1, 0), (0.0009, 1, 0), (0.0011, 0, 1), (0.05, 0, 1)]
)
def test_a_contact_more_than_a_step_before_the_touch_is_false_and_no_hit(before_s, felt, false):
    row = row_of([Contact(6.0 - before_s, "contact_ours", 9.0, 5.0)], TOUCH)
    assert (row["felt_ours"], row["false_ours"]) == (felt, false)
    assert row["delay_s_ours"] == (pytest.approx(max(0.0, -before_s)) if felt else None)


def test_a_touch_that_follows_a_false_contact_of_its_approach_is_no_hit():
    touch = Contact(6.01, "contact_ours", 9.0, 5.0)
    in_the_rest, on_the_way = (
        row_of([Contact(t_s, "contact_ours", 9.0, 5.0), touch], TOUCH) for t_s in (1.0, 5.99)
    )
    assert (in_the_rest["felt_ours"], in_the_rest["false_ours"]) == (1, 1), "it stops nothing"
    assert (on_the_way["felt_ours"], on_the_way["false_ours"]) == (0, 1)


def test_a_contact_reported_after_the_force_is_gone_is_false():
    within, after = (row_of([Contact(t_s, "contact_ours", 9.0, 5.0)], TOUCH) for t_s in (9.49, 9.51))
    assert (within["false_ours"], after["false_ours"]) == (0, 1)


def test_a_contact_may_end_from_the_return_on_while_the_foam_unloads():
    felt = [Contact(6.02, "contact_ours", 9.0, 5.0), ContactHeld(6.5, "contact_ours", 9.0, 5.0)]
    for lost_s, counts in ((8.99, (0, 0)), (9.0, (1, 1)), (9.45, (1, 1)), (10.1, (1, 0))):
        row = row_of([*felt, ContactLost(lost_s, "contact_ours", 1.0, 5.0)], TOUCH)
        assert (row["held_ours"], row["ended_ours"]) == counts, lost_s
    assert (row["truth_contact_s"], row["truth_release_s"]) == (6.0, 9.5)


def test_a_contact_that_is_taken_back_too_soon_is_not_held():
    events = [
        Contact(6.02, "contact_ours", 9.0, 5.0),
        ContactHeld(6.5, "contact_ours", 9.0, 5.0),
        ContactLost(7.5, "contact_ours", 1.0, 5.0),
    ]
    row = row_of(events, TOUCH)
    assert (row["felt_ours"], row["held_ours"], row["ended_ours"]) == (1, 0, 0)


def test_contact_where_nothing_touches_is_false():
    assert row_of([Contact(4.0, "contact_ours", 9.0, 5.0)], TOUCH)["false_ours"] == 1
    late = row_of([Contact(6.9, "contact_ours", 9.0, 5.0)], TOUCH)
    assert (late["felt_ours"], late["false_ours"]) == (0, 0), "late, yet true"


REPORTED = ("reported", "reported_held", "reported_ended", "reports", "reported_of_nothing")


def reported(row, method="ours"):
    return tuple(row[f"{name}_{method}"] for name in REPORTED)


def test_where_no_touch_is_known_the_reported_contacts_are_counted():
    events = [
        Contact(6.02, "contact_ours", 9.0, 5.0),
        ContactHeld(7.0, "contact_ours", 9.0, 5.0),
        ContactLost(9.6, "contact_ours", 1.0, 5.0),
        Contact(9.7, "contact_ours", 9.0, 5.0),
        Contact(1.0, "contact_paper", 9.0, 5.0),
        ContactLost(2.5, "contact_paper", 1.0, 5.0),
    ]
    row = row_of(events, truth=None)
    assert reported(row) == (1, 1, 1, 2, 0)
    assert reported(row, "paper") == (0, 0, 0, 0, 1), "in the rest before nothing can touch"
    unknown = ("touches", *(f"{name}_ours" for name in ("felt", "delay_s", "false", "held", "ended")))
    assert [row[name] for name in unknown] == [None] * 6
    assert reported(row_of(events, TOUCH)) == reported(row), "a known touch does not change the reports"


def test_persistence_and_end_are_those_of_a_contact_reported_in_this_approach():
    events = [
        ContactLost(2.5, "contact_ours", 1.0, 5.0),
        ContactHeld(3.0, "contact_ours", 9.0, 5.0),
        Contact(6.0, "contact_ours", 9.0, 5.0),
    ]
    assert reported(row_of(events, truth=None)) == (1, 0, 0, 1, 0)


def test_contact_without_an_object_is_counted():
    assert reported(row_of([Contact(4.0, "contact_ours", 9.0, 5.0)], truth=None, thing="none")) == (
        1,
        0,
        0,
        1,
        1,
    )


def test_reports_are_counted_by_approach():
    """A second approach like the first, 14 s later, in which contact is reported but not its end."""
    events = [
        Contact(6.0, "contact_ours", 9.0, 5.0),
        ContactLost(9.6, "contact_ours", 1.0, 5.0),
        Contact(20.0, "contact_ours", 9.0, 5.0),
    ]
    evidence = approach(events, None, until_s=28.0)
    first = [*evidence.visits[:-1], ("BASELINE", 14.0)]
    evidence.visits = [*first, *((state, t_s + 14.0) for state, t_s in evidence.visits[1:])]
    _, row = aura.measure(evidence, AuraSettings(paths=PATHS), "approached")
    assert row["approaches"] == 2
    assert reported(row) == (2, 0, 1, 2, 0)


def search(events, visits, truth=(), **factors):
    given = {"object_x_m": 0.002, "method": "ours", **factors}
    return TrialEvidence(given, TrialRecording(1), list(events), dict(visits), list(visits), list(truth))


VISITS = [("SEEKING_FORWARD", 6.0), ("SEEKING_BACKWARD", 6.6), ("CENTERING", 8.1), ("RESTING", 9.0)]


def test_the_error_is_where_it_stands_less_where_the_object_is():
    events = [
        PreTouch(6.5, "left_ours", 1.0, 0.5, 0.005),
        PreTouch(8.0, "right_ours", 1.0, 0.5),
        Standstill(8.1, "arm", -0.0016),
        Reached(9.0, "arm", 0.0017),
    ]
    _, row = centering.measure(search(events, VISITS), CenteringSettings(), "centered")
    assert row["error_m"] == pytest.approx(-0.0003)
    assert (row["left_m"], row["right_m"]) == (0.005, -0.0016)
    assert row["search_s"] == pytest.approx(2.1)
    assert row["gripped"] is None


def test_a_search_that_never_ended_has_no_error_and_counts_touches():
    truth = [(5.0, True), (5.5, False), (6.2, True)]
    _, row = centering.measure(
        search([], [("SEEKING_FORWARD", 6.0), ("LEAVING", 7.0)], truth), CenteringSettings(), "touched"
    )
    assert (row["error_m"], row["touched"]) == (None, 1)


def test_the_result_of_a_search_before_a_pause_is_discarded():
    """Paused on its way to the middle, the search restarts and detects nothing."""
    events = [PreTouch(6.5, "left_ours", 1.0, 0.5, 0.005), PreTouch(8.0, "right_ours", 1.0, 0.5, -0.003)]
    again = [("SEEKING_FORWARD", 20.0), ("LEAVING", 24.0)]
    _, row = centering.measure(
        search([*events, Reached(24.0, "arm", 0.03)], [*VISITS[:3], *again]),
        CenteringSettings(),
        "centered",
    )
    assert all(row[name] is None for name in ("error_m", "middle_m", "left_m", "right_m", "search_s"))


def test_a_grasp_reports_when_each_finger_felt_it():
    events = [
        Reached(9.0, "arm", 0.002),
        Contact(11.4, "left_contact", 9.0, 5.0),
        Gripped(12.0, "gripper", True, 0.019, 10.0),
    ]
    visits = [*VISITS, ("CLOSING", 11.0), ("RELEASING", 14.0)]
    _, row = centering.measure(search(events, visits), CenteringSettings(), "centered")
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
    _, row = centering.measure(search(events, visits), CenteringSettings(), "centered")
    assert row["seen_to_stop_left_s"] == pytest.approx(0.012)
    assert row["seen_to_stop_right_s"] == pytest.approx(0.02)
    _, unseen = centering.measure(search(events, visits[:1]), CenteringSettings(), "centered")
    assert unseen["seen_to_stop_left_s"] is None
