"""A3: false contacts while the finger is flexed, with a fixed threshold and with one that follows the tendon."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from behaviors.events import Contact, ContactLost
from behaviors.flexion import FlexionSettings
from controller.measures import transient
from controller.measures.trial import Measured, TrialEvidence, delay_s

HIGHLIGHTS = ("contact_false", "following_false", "free_rise_hz")
"""Columns shown during a run."""

LISTENERS = ("contact", "following", "ours")
"""Names that the profile gives: the paper's fixed threshold, the one that follows, the waveform's detector."""

_EACH = {
    "false": "contacts reported while the tendon moved and nothing was touched, by {}",
    "share": "share of that time in contact by {}",
    "blind": "1 where {} was in contact already when the probe touched",
    "event_s": "from the touch to the event of {}",
}

COLUMNS = {
    **transient.COLUMNS,
    "flexed_s": "how long the tendon moved with nothing touched after the baseline",
    "free_rise_hz": "how much higher the free finger oscillates fully flexed than extended",
    **{f"{name}_{what}": meaning.format(name) for name in LISTENERS for what, meaning in _EACH.items()},
}


def measure(evidence: TrialEvidence, settings: FlexionSettings, outcome: str) -> Measured:
    """Measure one approach to a finger that is being flexed.

    Returns:
        As `measures.transient`, with more columns.
    """
    outcome, row = transient.measure(evidence, settings, outcome)
    row |= dict.fromkeys(name for name in COLUMNS if name not in row)
    begun_s, touch_s = evidence.entered_s.get("FLEXING"), transient.touch_of(row, evidence)
    if begun_s is None:
        return outcome, row
    until_s = touch_s or evidence.entered_s.get("RETRACTING", evidence.ended_s)
    row |= {"flexed_s": until_s - begun_s, "free_rise_hz": _rise_hz(evidence, settings, begun_s)}
    for name in LISTENERS:
        if name not in evidence.detectors or evidence.unlearnt(name):
            continue
        scores = _scores(evidence, name, begun_s, until_s, touch_s)
        row |= {f"{name}_{what}": value for what, value in scores}
    if evidence.truth is None or outcome not in ("contact", "false_contact"):
        return outcome, row
    if settings.detector in LISTENERS:
        row["false_contacts"] = row[f"{settings.detector}_false"]
    return outcome, row


def _scores(
    evidence: TrialEvidence, name: str, begun_s: float, until_s: float, touch_s: float | None
) -> list[tuple[str, float | None]]:
    evidence.require_samples(name, begun_s, until_s)
    changes = [
        (event.t_s, isinstance(event, Contact))
        for event in evidence.events
        if isinstance(event, Contact | ContactLost) and event.detector == name
    ]
    before = [made for t_s, made in changes if t_s < begun_s]
    inside = [
        (t_s, made) for t_s, made in changes if begun_s <= t_s and transient.precedes(t_s, until_s, evidence)
    ]
    edges = [(begun_s, bool(before and before[-1])), *inside, (until_s, False)]
    contact_s = sum(b[0] - a[0] for a, b in pairwise(edges) if a[1])
    after = [
        t_s
        for t_s, made in changes
        if made and touch_s is not None and not transient.precedes(t_s, touch_s, evidence)
    ]
    return [
        ("false", float(sum(made for _, made in inside))),
        ("share", contact_s / (until_s - begun_s)),
        ("blind", float(edges[-2][1]) if touch_s is not None else None),
        ("event_s", delay_s(after[0], touch_s) if after and touch_s is not None else None),
    ]


TimedValues = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]


def curve(periods: TimedValues, tendon: TimedValues) -> Mapping[str, Any]:
    """Frequency of each period against where the tendon was, and the parabola through it."""
    at_m = np.interp(periods[0], *tendon)
    hz = 1.0 / periods[1]
    return {"at_m": at_m, "hz": hz, "terms": np.polynomial.polynomial.polyfit(at_m, hz, 2)}


def _rise_hz(evidence: TrialEvidence, settings: FlexionSettings, until_s: float) -> float | None:
    since_s = evidence.entered_s.get("BASELINE", -math.inf)
    periods = evidence.periods(settings.period_stream, since_s, until_s)
    tendon = evidence.series(settings.tendon_stream, since_s, until_s)
    if len(periods[0]) < 10 or not len(tendon[0]):
        return None
    terms = curve(periods, tendon)["terms"]
    flexed = np.polynomial.polynomial.polyval([0.0, settings.flexed_m], terms)
    return float(flexed[1] - flexed[0])
