"""C3: the middle found, and the time taken (Rupavatharam et al., III.D, IV.A.2, Fig. 8c)."""

import math
from collections.abc import Mapping
from typing import Any

from behaviors.events import Contact, PreTouch
from behaviors.search import SearchSettings
from controller.measures.trial import Measured, TrialEvidence
from drivers.core.messages import Gripped, Reached, Standstill

HIGHLIGHTS = ("error_m", "search_s", "touched")
"""Columns shown during a run."""

CENTERED_M = 0.008
"""Largest error of a middle that was found: the paper's largest (IV.A.2, Fig. 8c)."""

COLUMNS = {
    "error_m": "the final position less the object's middle, positive if too far forward",
    "middle_m": "the final position",
    "left_m": "where the left finger detected the object",
    "right_m": "where the right finger did",
    "seen_to_stop_left_s": "from its deciding sample to the stop command",
    "seen_to_stop_right_s": "likewise",
    "search_s": "duration of the search",
    "touched": "true touches during it (simulated benches)",
    "gripped": "1 where the jaws held it",
    "contact_left_s": "from the grip's beginning to the left finger's contact",
    "contact_right_s": "to the right finger's",
}


def measure(evidence: TrialEvidence, settings: SearchSettings, outcome: str) -> Measured:
    """Measure one search.

    The outcome is judged by what is known. A search that a contact ended is `touched`, or `false_contact` where in
    truth nothing touched (simulated benches only). One that came to a middle is `touched` where in truth it touched on
    the way, and `off_center` where the middle is not the object's.
    """
    row = _measured(evidence, settings)
    touches = None if evidence.truth is None else sum(made for _, made in evidence.truth)
    if outcome == "touched" and touches == 0:
        outcome = "false_contact"
    if outcome == "centered" and row["touched"]:
        outcome = "touched"
    known = "object_x_m" in evidence.factors and row["error_m"] is not None
    if outcome == "centered" and known and abs(row["error_m"]) > CENTERED_M:
        outcome = "off_center"
    return outcome, row


def _measured(evidence: TrialEvidence, settings: SearchSettings) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    begun_s = evidence.entered_s.get("RUNNING_UP", evidence.entered_s.get("SEEKING_FORWARD"))
    if begun_s is None:
        return row
    # after a pause the search restarts: the result of the one before is discarded
    entered_s = {state: t_s for state, t_s in evidence.entered_s.items() if t_s >= begun_s}
    # of a search on both sides of a half turn the last places count, and the time of both
    first_s, turned_s = evidence.notes.get("turned_s", (begun_s, math.inf))
    ended_s = None if begun_s < turned_s < math.inf else entered_s.get("CENTERING")
    over_s = ended_s if ended_s is not None else entered_s.get("LEAVING", math.inf)
    if evidence.truth is not None:
        row["touched"] = sum(made and first_s <= t_s < over_s for t_s, made in evidence.truth)
    method = evidence.factors.get("method", "ours")
    forward, backward = ("left", "right") if turned_s > begun_s else ("right", "left")
    seeking = ((forward, "SEEKING_FORWARD", "TURNING"), (backward, "SEEKING_BACKWARD", "STOPPING"))
    for finger, state, following in seeking:
        if state in entered_s:
            evidence.require_samples(f"{finger}_{method}", entered_s[state], entered_s.get(following, over_s))
        row[f"{finger}_m"] = _seen_at(evidence, settings, finger, entered_s.get(state))
    for finger, state in ((forward, "TURNING"), (backward, "STOPPING")):
        row[f"seen_to_stop_{finger}_s"] = _stopped_after(evidence, settings, entered_s.get(state))
    if ended_s is None:
        return row
    row["search_s"] = ended_s - first_s
    # the turn back, if any, was reached as this state was entered
    arrived = evidence.first(Reached, math.nextafter(ended_s, math.inf), device=settings.mover)
    if arrived is not None:
        row["middle_m"] = arrived.position_m
        if evidence.truth is not None or "object_x_m" in evidence.factors:  # else nobody knows where it is
            row["error_m"] = arrived.position_m - float(evidence.factors.get("object_x_m", 0.0))
    return row | dict(_grasp(evidence, settings))


def _seen_at(
    evidence: TrialEvidence, settings: SearchSettings, finger: str, since_s: float | None
) -> float | None:
    """The mover's position at a finger's detection, or at standstill if the event has none."""
    if since_s is None:
        return None
    detector = f"{finger}_{evidence.factors.get('method', 'ours')}"
    seen = evidence.first(PreTouch, since_s, detector=detector)
    if seen is None:
        return None
    if math.isfinite(seen.position_m):
        return seen.position_m
    still = evidence.first(Standstill, seen.t_s, device=settings.mover)
    return None if still is None else still.position_m


def _stopped_after(evidence: TrialEvidence, settings: SearchSettings, seen_s: float | None) -> float | None:
    """From a finger's detection, when the state was entered, to the last byte of Stop."""
    if seen_s is None:
        return None
    sent_s = evidence.stop_sent_s(settings.mover, seen_s)
    return None if sent_s is None else sent_s - seen_s


def _grasp(evidence: TrialEvidence, settings: SearchSettings) -> Mapping[str, Any]:
    closing_s = evidence.entered_s.get("CLOSING")
    if closing_s is None:
        return {}
    held = evidence.first(Gripped, device=settings.gripper, object=True)
    found: dict[str, Any] = {"gripped": int(held is not None)}
    until_s = evidence.entered_s.get("RELEASING", math.inf)
    for finger in ("left", "right"):
        evidence.require_samples(f"{finger}_contact", closing_s, until_s)
        felt = evidence.first(Contact, closing_s, until_s, detector=f"{finger}_contact")
        found[f"contact_{finger}_s"] = None if felt is None else felt.t_s - closing_s
    return found
