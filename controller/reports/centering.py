"""The part of the page on C3: how well the middle is found, beside the paper's Fig. 8c."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from behaviors.search import SearchFactors
from controller.measures.centering import CENTERED_M
from controller.recording.reader import Run
from controller.reports.counts import METHODS, Trials, every, quantity, tails, title, under
from controller.reports.figures import FALSE, INK, OURS, PAPER, Figures
from controller.reports.first_screen import listed
from controller.reports.papers import headlines
from controller.reports.section import Headline, Section, measured, told
from controller.scales import scale_of

WANTED_M = 0.0025
"""Largest error of centering that is aimed at here; ours, not the paper's."""

SEEN_TO_STOP = ("seen_to_stop_left_s", "seen_to_stop_right_s")
"""From the sample with which a finger saw the object to the arm's stop command."""

FACTORS = ("object", "method", "speed_m_s")

COLUMNS = ("error_m", "search_s", "touched", "gripped", "contact_left_s", "contact_right_s")
"""Of a search that the table has."""

Groups = Mapping[tuple[str, str, float], Trials]


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Errors by method, object and speed; the histogram."""
    rows = Trials.of(runs, SearchFactors)
    groups: Groups = rows.by(*FACTORS)
    things = {thing for thing, *_ in groups}
    pooled: dict[tuple[str, str, float], Trials] = {}  # of several objects: each has its row in the table
    for (thing, method, speed_m_s), own in groups.items():
        name = thing if len(things) == 1 else f"{len(things)} objects"
        pooled.setdefault((name, method, speed_m_s), Trials()).extend(own)
    content: dict[str, Any] = {
        "said": list(_said(pooled)),
        "searches": [],
        "stops": tails(rows, *SEEN_TO_STOP),
        "figure": _draw(pooled, figures),
        "pipe_alone": things == {"pipe"},  # the paper draws it alone
        "worst": quantity("error_m", CENTERED_M, 0),
    }
    for line, own in zip(measured(groups.values(), FACTORS, COLUMNS), groups.values(), strict=True):
        content["searches"].append({**line, **under("error_m", _worst_m(own), "worst error", 2)})
    headline = _headline(rows)
    return told(
        runs, "Centering without touching (C3)", "centering", content, paper="rupavatharam", headline=headline
    )


def _headline(rows: Trials) -> Headline | None:
    """Our worst error beside that of the paper's method on the same bench, and beside what the paper prints."""
    found = listed(headlines("centering"), rows)
    rival_m = _worst_m(rows.where(method="paper"))
    if not found or not found.paper or rival_m is None:
        return found
    rival = f"the paper's method on this bench {quantity('error_m', rival_m)}"
    return found._replace(verdict=f"{found.verdict}; {rival}", source=f"{found.source}; {rival}")


def _worst_m(own: Trials) -> float | None:
    return max(map(abs, own.values("error_m")), default=None)


def _said(groups: Groups) -> Iterator[dict[str, Any]]:
    """Each method's worst error; of ours also beside the paper's method on the same bench."""
    for (thing, method, speed_m_s), own in groups.items():
        ours, found, worst_m = method == "ours", own.values("error_m"), _worst_m(own)
        bound_m = WANTED_M if ours else CENTERED_M
        beyond = sum(abs(error_m) > bound_m for error_m in found) + len(own) - len(found)
        yield {
            "what": f"{title(thing).capitalize()}, {METHODS[method]}, {quantity('speed_m_s', speed_m_s, 0)}",
            "ours": ours,
            "worst_m": worst_m,
            "found": len(found),
            "n": len(own),
            "bound": quantity("error_m", bound_m, 1),
            # the paper's method below the paper's own worst is no result of ours, and little of one of the bench
            "judged": ours or beyond,
            "met": every(beyond, len(own)),
            "worse": False if worst_m is not None and worst_m > bound_m else None,
            "rival_m": _worst_m(groups.get((thing, "paper", speed_m_s), Trials())) if ours else None,
        }


def _draw(groups: Groups, figures: Figures) -> str:
    """One histogram for each method and speed, all objects together."""
    cells = {key[1:]: errors_m for key, own in groups.items() if (errors_m := own.values("error_m"))}
    if not cells:
        return ""
    scale = scale_of("error_m")
    largest_m = max(abs(error) for errors in cells.values() for error in errors)
    reach = np.ceil(scale.factor * max(0.009, largest_m + 0.001))
    with figures.panels(len(cells), 2 if len(cells) > 1 else 1, 1.7, sharex=True, sharey=True) as drawing:
        for axes, ((method, speed_m_s), errors) in zip(drawing.axes, sorted(cells.items()), strict=True):
            color = OURS if method == "ours" else PAPER
            edges = np.arange(-reach, reach + 0.5, 0.5)
            axes.hist(np.array(errors) * scale.factor, bins=edges, color=color, edgecolor="white", lw=0.3)  # type: ignore[arg-type]
            for place in (-CENTERED_M, CENTERED_M):
                axes.axvline(place * scale.factor, color=FALSE, lw=0.8, ls=(0, (4, 2)))
            axes.axvline(0.0, color=INK, lw=0.5)
            axes.set_title(f"{METHODS[method]}, {quantity('speed_m_s', speed_m_s, 0)}, n = {len(errors)}")
            axes.locator_params(axis="y", integer=True)
        drawing.label_outside(scale.heading, "trials")
        return drawing.save("fig_8c_centering")
