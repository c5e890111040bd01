"""C2, C4, C5: each detector's events on approaches, touches and empty space (Rupavatharam et al., IV)."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from behaviors.aura import AuraSettings
from behaviors.events import Contact, ContactHeld, ContactLost, Detected, PreTouch
from controller.measures.trial import Measured, TrialEvidence, delay_s, not_before, spans_within
from controller.recording.series import Series

Span = tuple[float, float]
"""From when to when, s."""

METHODS = ("paper", "ours")
"""Detectors are named `pretouch_METHOD` and `contact_METHOD`."""

LATE_S = 0.5
"""How long after a contact began or ended an event still counts for it. Assumption: half a finger's hold."""

OURS_AND_PAPERS = {
    "alarms": "approaches with pre-touch where nothing was near: in the rest before, or without an object",
    "seen": "approaches to an object with pre-touch in time",
    "distance_m": "its median distance",
    "felt": "detected touches (simulated benches)",
    "delay_s": "their median delay",
    "false": "approaches with a contact reported before the touch or after its end (simulated benches)",
    "held": "touches reported to persist and not revoked before the return (simulated benches)",
    "ended": "touches whose end was reported after it (simulated benches)",
    "reported": "approaches with a reported contact",
    "reported_held": "those whose persistence was then reported",
    "reported_ended": "those whose end was then reported",
    "reports": "contacts reported in them",
    "reported_of_nothing": "approaches with a contact where nothing can touch: before, in the rest, or no object",
}
"""Of each method."""

HIGHLIGHTS = ("seen_ours", "distance_m_ours", "felt_ours")
"""Columns shown during a run."""

COLUMNS = {
    "approaches": "approaches completed",
    "undulations_per_cm": "dominant spatial frequency of the last one's envelope",
    "touches": "touches that really happened (simulated benches)",
    "truth_contact_s": "when the first began (simulated benches)",
    "truth_release_s": "when its force was gone (simulated benches)",
    **{f"{name}_{method}": meaning for method in METHODS for name, meaning in OURS_AND_PAPERS.items()},
}


class Passage(NamedTuple):
    """One approach: start of the rest before it, of the motion, of the rest after it and of the return; and its end."""

    rest_s: float
    begun_s: float
    arrived_s: float
    back_s: float
    over_s: float


def measure(evidence: TrialEvidence, settings: AuraSettings, outcome: str) -> Measured:
    """Measure all approaches of a trial.

    Returns:
        The outcome, which is false contact where the approach was stopped and nothing touched (simulated benches
        only), and the columns.
    """
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    passages = _passages(evidence)
    row["approaches"] = len(passages)
    if not passages:
        return outcome, row
    there = evidence.factors.get("object", "pipe") != "none"
    contacts = None if evidence.truth is None else spans_within(evidence.truth)
    for passage in passages:
        pose = evidence.covered(settings.pose_stream, passage.rest_s, passage.over_s)
        for method in settings.methods:
            for what in ("pretouch", "contact"):
                evidence.require_samples(f"{what}_{method}", passage.rest_s, passage.over_s)
    row["undulations_per_cm"] = _undulations(evidence, settings, passages[-1]) if there else None
    if contacts is not None:
        row["touches"] = len(contacts)
        if outcome == "contact" and not contacts:
            outcome = "false_contact"
    if contacts:
        row["truth_contact_s"], over_s = contacts[0]
        row["truth_release_s"] = over_s if math.isfinite(over_s) else None
    for method in settings.methods:
        detected = (event for event in evidence.events if isinstance(event, Detected))
        events = [event for event in detected if event.detector.endswith(f"_{method}")]
        seen = [_seen(events, passage, contacts, there) for passage in passages]
        distances_m = [
            _distance(pose, t_s, passage, contacts, settings.end_gap_m)
            for (t_s, _), passage in zip(seen, passages, strict=True)
            if t_s is not None and len(pose)
        ]
        row[f"alarms_{method}"] = sum(alarm for _, alarm in seen)
        if there:
            row[f"seen_{method}"] = sum(t_s is not None for t_s, _ in seen)
        if distances_m:
            row[f"distance_m_{method}"] = float(np.median(distances_m))
        row.update(_reported_columns(events, passages, there, method))
        if contacts is not None:
            row.update(_contact_columns(events, passages, contacts, method))
    return outcome, row


def _passages(evidence: TrialEvidence) -> list[Passage]:
    """The completed approaches."""
    passages = []
    visits = evidence.visits
    for place, (state, begun_s) in enumerate(visits):
        if state != "APPROACHING" or place == 0:
            continue
        after: dict[str, float] = {}
        over_s: float | None = None
        for name, t_s in visits[place + 1 :]:
            # an approach interrupted by a pause returns at once, and ends where the next one's rest begins
            if name in ("BASELINE", "LEAVING"):
                over_s = t_s
                break
            after.setdefault(name, t_s)
        arrived_s, back_s = after.get("STOPPING", after.get("HOLDING")), after.get("RETRACTING")
        if arrived_s is not None and back_s is not None and over_s is not None:
            passages.append(Passage(visits[place - 1][1], begun_s, arrived_s, back_s, over_s))
    return passages


def _within(spans: Sequence[Span] | None, passage: Passage) -> Span | None:
    """The first contact of an approach."""
    return next((span for span in spans or () if passage.begun_s <= span[0] < passage.over_s), None)


def _seen(
    events: Sequence[Any], passage: Passage, contacts: Sequence[Span] | None, there: bool
) -> tuple[float | None, bool]:
    """Time of the first pre-touch in an approach to an object, and whether there was a false one."""
    contact = _within(contacts, passage)
    until_s = passage.arrived_s if contact is None else min(contact[0], passage.arrived_s)
    seen = [event.t_s for event in events if isinstance(event, PreTouch)]
    first = next((t_s for t_s in seen if passage.begun_s <= t_s <= until_s), None)
    early = any(passage.rest_s <= t_s < passage.begun_s for t_s in seen)
    return (first, early) if there else (None, early or first is not None)


def _distance(
    pose: Series, t_s: float, passage: Passage, contacts: Sequence[Span] | None, end_gap_m: float
) -> float:
    """How far the finger was from the object at an instant, along its way."""
    contact = _within(contacts, passage)
    end_s, gap_m = (passage.arrived_s, end_gap_m) if contact is None else (contact[0], 0.0)

    here, there = (
        np.array([np.interp(at_s, pose.times_s, c) for c in pose.values[:, :3].T]) for at_s in (t_s, end_s)
    )
    return float(np.linalg.norm(there - here)) + gap_m


def _reported_columns(
    events: Sequence[Detected], passages: Sequence[Passage], there: bool, method: str
) -> dict[str, Any]:
    """The reported contacts, whether true or not."""
    approaches = held = ended = contacts = of_nothing = 0
    begun_s = [event.t_s for event in events if isinstance(event, Contact)]
    for passage in passages:
        own = [event for event in events if passage.begun_s <= event.t_s < passage.over_s]
        begins = [t_s for t_s in begun_s if passage.begun_s <= t_s < passage.over_s]
        early = any(passage.rest_s <= t_s < passage.begun_s for t_s in begun_s)
        of_nothing += early or bool(begins and not there)
        if not begins:
            continue
        approaches += 1
        contacts += len(begins)
        held += any(isinstance(event, ContactHeld) and event.t_s > begins[0] for event in own)
        ended += any(isinstance(event, ContactLost) and event.t_s > begins[0] for event in own)
    return {
        f"reported_{method}": approaches,
        f"reported_held_{method}": held,
        f"reported_ended_{method}": ended,
        f"reports_{method}": contacts,
        f"reported_of_nothing_{method}": of_nothing,
    }


def _contact_columns(
    events: Sequence[Detected], passages: Sequence[Passage], contacts: Sequence[Span], method: str
) -> dict[str, Any]:
    begins, holds, ends = (
        [event.t_s for event in events if isinstance(event, kind)]
        for kind in (Contact, ContactHeld, ContactLost)
    )
    delays_s, held, ended = [], 0, 0
    for begun_s, over_s in contacts:
        own = next((each for each in passages if each.begun_s <= begun_s < each.over_s), None)
        set_out_s, back_s = (begun_s, over_s) if own is None else (own.begun_s, min(own.back_s, over_s))
        # the first report decides: one before the touch would have stopped the arm
        felt = next((t_s for t_s in begins if t_s >= set_out_s or not_before(t_s, begun_s)), math.inf)
        if not not_before(felt, begun_s) or felt > min(over_s, begun_s + LATE_S):
            continue
        delays_s.append(delay_s(felt, begun_s))
        lost = next((t_s for t_s in ends if t_s > felt), math.inf)
        # the end has no instant: the foam unloads from the return until the force is gone
        kept = not_before(lost, back_s)
        held += kept and any(felt < t_s <= over_s for t_s in holds)
        ended += kept and lost <= over_s + LATE_S
    false = [t_s for t_s in begins if not any(not_before(t_s, a_s) and t_s <= b_s for a_s, b_s in contacts)]
    return {
        f"felt_{method}": len(delays_s),
        f"delay_s_{method}": float(np.median(delays_s)) if delays_s else None,
        f"false_{method}": sum(any(each.rest_s <= t_s < each.over_s for t_s in false) for each in passages),
        f"held_{method}": held,
        f"ended_{method}": ended,
    }


def _undulations(evidence: TrialEvidence, settings: AuraSettings, passage: Passage) -> float | None:
    """Dominant spatial frequency of the envelope along one approach, cycles per cm."""
    envelope = evidence.stream(settings.finger_stream, passage.begun_s, passage.arrived_s)
    pose = evidence.stream(settings.pose_stream, passage.rest_s, passage.over_s)
    if len(envelope) < 64 or len(pose) < 2 or envelope.values.shape[1] < 2:
        return None
    places_m = np.column_stack([np.interp(envelope.times_s, pose.times_s, c) for c in pose.values[:, :3].T])
    way_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(places_m, axis=0), axis=1))))
    moving = np.concatenate(([True], np.diff(way_m) > 0.0))
    length_m = float(way_m[-1])
    count = int(moving.sum())
    if length_m < 0.01 or count < 64:
        return None
    grid_m = np.linspace(0.0, length_m, count)
    i, q = (np.interp(grid_m, way_m[moving], column) for column in envelope.values[moving, :2].T)
    z = i + 1j * q
    s = np.linspace(-1.0, 1.0, count)
    z = z - np.polyval(np.polyfit(s, z, 2), s)
    padded = 8 * count
    power = np.abs(np.fft.fft(z * np.hanning(count), padded)) ** 2
    per_cm = np.abs(np.fft.fftfreq(padded, length_m / (count - 1))) / 100.0
    power[(per_cm < 0.5) | (per_cm > 10.0)] = 0.0
    return float(per_cm[int(np.argmax(power))])
