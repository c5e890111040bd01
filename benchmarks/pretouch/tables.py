"""Tables of the study's page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pretouch.rates import (
    CONTACT,
    OURS,
    OURS_CONTACT,
    PRETOUCH,
    SHORT,
    Chosen,
    best_paper_contact,
    by_kind,
    contact_rates,
    pretouch_rates,
)
from benchmarks.pretouch.study import (
    STATISTICS,
    Verdict,
)
from benchmarks.results import table
from controller.detectors.level import LevelSettings
from controller.detectors.pretouch import PreTouchSettings


def cm(distances: Mapping[str, float | None]) -> str:
    """A distance in centimetres: median (p10 to p90)."""
    if distances["median"] is None:
        return "–"
    low, middle, high = (100.0 * (distances[key] or 0.0) for key in ("p10", "median", "p90"))
    return f"{middle:.1f} ({low:.1f} to {high:.1f})"


def ms(delays: Mapping[str, float | None]) -> str:
    """A delay in milliseconds: median (p10 to p90)."""
    if delays["median"] is None:
        return "–"
    low, middle, high = (1e3 * (delays[key] or 0.0) for key in ("p10", "median", "p90"))
    return f"{middle:.0f} ({low:.0f} to {high:.0f})"


def _threshold(thresholds: Mapping[str, float], name: str) -> str:
    if name in thresholds:
        return f"{thresholds[name]:.3g}"
    own = LevelSettings().threshold if name.startswith("level") else PreTouchSettings().threshold
    return f"{own:.3g}"


def pretouch_table(verdicts: Sequence[Verdict], thresholds: Mapping[str, float]) -> str:
    """All detectors of pre-touch."""
    rows = []
    for name in (*PRETOUCH, *STATISTICS):
        positive, negative, distances = pretouch_rates(verdicts, name)
        rows.append(
            [
                name,
                _threshold(thresholds, name),
                positive,
                positive.of - positive.count,
                negative,
                cm(distances),
            ]
        )
    head = [
        "detector",
        "threshold",
        "TPR, % (95 %)",
        "missed",
        "TNR, % (95 %)",
        "distance, cm: median (p10 to p90)",
    ]
    return table(head, rows)


def pretouch_split(verdicts: Sequence[Verdict], what: str, parts: Mapping[str, Chosen]) -> str:
    """The paper's and ours, by parts."""
    rows = []
    for label, chosen in parts.items():
        row: list[Any] = [label]
        for name in SHORT:
            positive, _, distances = pretouch_rates(verdicts, name, chosen)
            row += [positive, cm(distances)]
        rows.append([*row[:1], pretouch_rates(verdicts, OURS, chosen)[0].of, *row[1:]])
    head = [what, "approaches"]
    for name in ("paper", "ours"):
        head += [f"{name}: TPR, %", f"{name}: distance, cm"]
    return table(head, rows)


def contact_table(verdicts: Sequence[Verdict], thresholds: Mapping[str, float]) -> str:
    """All detectors of contact."""
    rows = []
    for name in CONTACT:
        positive, negative, more, delays = contact_rates(verdicts, name)
        shares = [f"{100 * more[key].share:.1f}" for key in ("early", "held", "ended")]
        rows.append([name, _threshold(thresholds, name), positive, negative, *shares, ms(delays)])
    head = [
        "detector",
        "threshold",
        "TPR, % (95 %)",
        "TNR, % (95 %)",
        "too early, %",
        "held, %",
        "end told, %",
    ]
    return table([*head, "delay, ms: median (p10 to p90)"], rows)


def contact_split(verdicts: Sequence[Verdict], what: str, parts: Mapping[str, Chosen]) -> str:
    """The paper's best window and ours, by parts."""
    paper = best_paper_contact(verdicts)
    rows = []
    for label, chosen in parts.items():
        of_paper, of_ours = (contact_rates(verdicts, name, chosen)[0] for name in (paper, OURS_CONTACT))
        rows.append([label, of_ours.of, of_paper, of_ours])
    return table([what, "touches", f"{paper}: TPR, %", "ours: TPR, %"], rows)


def quiet_table(verdicts: Sequence[Verdict], paper: str) -> str:
    """True negatives by kind of passage."""
    rows = []
    for kind, chosen in by_kind().items():
        rows.append(
            [
                kind,
                *(pretouch_rates(verdicts, name, chosen)[1] for name in SHORT),
                *(contact_rates(verdicts, name, chosen)[1] for name in (paper, OURS_CONTACT)),
            ]
        )

    def near(verdict: Verdict) -> bool:
        return verdict.event.kind == "near"

    rows.append(["near", "–", "–", *(contact_rates(verdicts, n, near)[1] for n in (paper, OURS_CONTACT))])
    return table(["passages", *(f"{name}: TNR, %" for name in (*SHORT, paper, OURS_CONTACT))], rows)
