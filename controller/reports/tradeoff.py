"""The part of the page on A5: sensitivity against false contacts for every threshold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from controller.measures.tradeoff import LATER_S, METHODS, SOON_S, WHEN
from controller.recording.reader import Run
from controller.reports.counts import percent
from controller.reports.figures import FALSE, GOOD, INK, OURS, PAPER, RIVAL, Figures
from controller.reports.paper import CITATION, SETTLE
from controller.reports.section import Figure, Kind, Result, Section
from controller.reports.section_texts import SectionTexts
from controller.reports.text import quantity

TEXTS = SectionTexts("tradeoff")

COLORS = dict(zip(METHODS, (PAPER, OURS, GOOD, RIVAL, FALSE), strict=True))

SIGMAS = (2.0, 3.0, 4.5, 6.0)
"""Thresholds of the table; 3 is the paper's (III.B)."""

Scores = dict[str, np.ndarray[Any, Any]]


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """A table of thresholds, and the curves."""
    names = TEXTS.named("names")
    rows = [row for run in runs for row in run.trials]
    scores: dict[str, Scores] = {}
    for method in METHODS:
        own = [[row.get(f"{method}_{when}") for when in WHEN] for row in rows]
        known = np.array([each for each in own if None not in each], dtype=float).reshape(-1, len(WHEN))
        if len(known) > 1:
            scores[method] = dict(zip(WHEN, known.T, strict=True))
    kind = Kind.PREDICTED if runs[0].simulated else Kind.MEASURED
    summary = [Result(None, TEXTS.sentence("none"))] if not scores else []
    n = max((len(each["before"]) for each in scores.values()), default=0)
    if "average" in scores:
        low, high = ((scores["average"]["before"] > sigma).mean() for sigma in (2.0, 3.0))
        text = TEXTS.sentence("tradeoff", low=percent(low), high=percent(high))
        summary.append(Result(kind, text, bool(low > high) if low else None))
    if scores:
        best = ", ".join(
            f"{names[name]} {percent((each['soon'] > each['before'].max()).mean())}"
            for name, each in scores.items()
        )
        summary.append(Result(kind, TEXTS.sentence("best", n=n, best=best)))
    facts: dict[str, Any] = {"soon": quantity("soon_s", SOON_S, 3), "later": quantity("later_s", LATER_S, 1)}
    return Section(
        title="Sensitivity against false contacts (A5)",
        body=[
            TEXTS.text("intro", **facts),
            *([TEXTS.table("thresholds", _rows(scores, names), n=n, **facts)] if scores else []),
            *(
                [Figure(Markup(_draw(figures, scores, names)), TEXTS.sentence("figure", **facts))]
                if scores
                else []
            ),
        ],
        citation=CITATION,
        summary=summary,
        not_the_papers=TEXTS.each("ours"),
        printed=SETTLE,
    )


def _rows(scores: dict[str, Scores], names: Any) -> Iterator[dict[str, Any]]:
    for name, each in scores.items():
        for sigma in (*SIGMAS, float(each["before"].max())):
            yield {
                "method": names[name],
                "sigma": sigma,
                "false": percent((each["before"] > sigma).mean()),
                "soon": percent((each["soon"] > sigma).mean()),
                "later": percent((each["later"] > sigma).mean()),
            }


def _draw(figures: Figures, scores: dict[str, Scores], names: Any) -> str:
    with figures.figure(2.9, columns=2) as drawing:
        left, right = drawing.axes
        for name, each in scores.items():
            sigmas = np.unique(np.concatenate([each["before"], each["soon"], [0.0, 10.0]]))
            false, soon = ((each[when] > sigmas[:, None]).mean(axis=1) for when in ("before", "soon"))
            left.plot(sigmas, 100.0 * soon, color=COLORS[name])
            left.plot(sigmas, 100.0 * false, color=COLORS[name], ls=(0, (2, 2)))
            right.plot(100.0 * false, 100.0 * soon, color=COLORS[name], label=names[name])
        left.axvline(3.0, color=INK, lw=0.6)
        left.set_xlim(0.0, 10.0)
        left.set_xlabel("threshold (deviations of the free finger)")
        left.set_ylabel("approaches (%)")
        right.set_xlim(-1.0, 40.0)
        right.set_xlabel("false contacts (% of approaches)")
        right.set_ylabel("detected in time (%)")
        curves = right.get_legend_handles_labels()
        drawing.figure.legend(*curves, loc="outside upper left", ncols=3, borderaxespad=0.0)
        return drawing.save("tradeoff")
