"""The part of the page on A5: sensitivity against false contacts for every threshold."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from controller.measures.tradeoff import LATER_S, METHODS, SOON_S, WHEN
from controller.recording.reader import Run
from controller.reports.counts import Row, Trials, decided, number, paired, percent, quantity
from controller.reports.figures import FALSE, GOOD, INK, OURS, PAPER, RIVAL, Figures
from controller.reports.section import Section, rated, told

NAMES = {
    "average": "averaged frequency (the paper's)",
    "all": "phase and amplitude",
    "phase": "phase",
    "amplitude": "amplitude",
    "frequency": "frequency, two periods",
}
COLORS = dict(zip(METHODS, (PAPER, OURS, GOOD, RIVAL, FALSE), strict=True))

SIGMAS = (2.0, 3.0, 4.5, 6.0)
"""Thresholds of the table; 3 is the paper's (III.B)."""

SOON, LATER = quantity("soon_s", SOON_S, 3), quantity("later_s", LATER_S, 1)

Scores = Mapping[str, np.ndarray[Any, Any]]


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """A table of thresholds, and the curves."""
    rows = Trials.of(runs)
    scores: dict[str, Scores] = {}
    for method in METHODS:
        own = [[row.get(f"{method}_{when}") for when in WHEN] for row in rows]
        known = np.array([each for each in own if None not in each], dtype=float).reshape(-1, len(WHEN))
        if len(known) > 1:
            scores[method] = dict(zip(WHEN, known.T, strict=True))
    # at the lowest threshold without a false contact
    hits = {name: int((each["soon"] > each["before"].max()).sum()) for name, each in scores.items()}
    content: dict[str, Any] = {
        "soon": SOON,
        "later": LATER,
        "n": max((len(each["before"]) for each in scores.values()), default=0),
        "found": {NAMES[name]: hits[name] / len(each["soon"]) for name, each in scores.items()},
        "alarmed": [],
        "met": None,
        "thresholds": list(_rows(scores)),
        "figure": _draw(figures, scores) if scores else "",
    }
    if "average" in scores:
        low, high = alarmed = [scores["average"]["before"] > sigma for sigma in (2.0, 3.0)]
        only, fewer = int((low & ~high).sum()), int((high & ~low).sum())
        content["alarmed"] = [each.mean() for each in alarmed]
        content["met"] = decided(only, only + fewer, 0.5) if only + fewer else None
    headline = None
    if "average" in scores and len(scores) > 1:
        # the most sensitive signal of ours beside the paper's
        best = max((name for name in hits if name != "average"), key=lambda name: hits[name])
        what = f"contacts detected within {SOON} without one false contact, by {NAMES[best]}"
        source = "the paper's averaged frequency (these approaches)"
        of, theirs = (len(scores[name]["before"]) for name in (best, "average"))
        least = {f"{name}_soon": scores[name]["before"].max() for name in (best, "average")}
        above = paired([row[name] > least[name] for name in least] for row in rows.known(*least))
        headline = rated(what, hits[best], of, hits["average"] / theirs, source, above=above)
    heading = "Sensitivity against false contacts (A5)"
    more: dict[str, Any] = {"headline": headline, "shows_trials": not scores}
    return told(runs, heading, "tradeoff", content, paper="backus", **more)


def _rows(scores: Mapping[str, Scores]) -> Iterator[Row]:
    heads = dict(zip(WHEN, ("false", f"within {SOON}", f"within {LATER}"), strict=True))
    for name, each in scores.items():
        for sigma in (*SIGMAS, float(each["before"].max())):
            shares = {head: percent((each[when] > sigma).mean()) for when, head in heads.items()}
            yield {"signal": NAMES[name], "threshold, sigmas": number(sigma, 1), **shares}


def _draw(figures: Figures, scores: Mapping[str, Scores]) -> str:
    with figures.figure(2.9, columns=2) as drawing:
        left, right = drawing.axes
        for name, each in scores.items():
            sigmas = np.unique(np.concatenate([each["before"], each["soon"], [0.0, 10.0]]))
            false, soon = ((each[when] > sigmas[:, None]).mean(axis=1) for when in ("before", "soon"))
            left.plot(sigmas, 100.0 * soon, color=COLORS[name])
            left.plot(sigmas, 100.0 * false, color=COLORS[name], ls=(0, (2, 2)))
            right.plot(100.0 * false, 100.0 * soon, color=COLORS[name], label=NAMES[name])
        left.axvline(3.0, color=INK, lw=0.6)
        label = "threshold (deviations of the free finger)"
        left.set(xlim=(0.0, 10.0), xlabel=label, ylabel="approaches (%)")
        right.set(
            xlim=(-2.0, 102.0), xlabel="false contacts (% of approaches)", ylabel="detected in time (%)"
        )
        drawing.legend(right, 3)
        return drawing.save("tradeoff")
