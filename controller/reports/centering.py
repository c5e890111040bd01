"""The part of the page on C3: how well the middle is found, beside the paper's Fig. 8c."""

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from behaviors.search import SearchFactors
from controller.recording.reader import Run
from controller.reports.counts import (
    METHODS,
    Row,
    every,
    grouped,
    mean_of,
    median,
    quantity,
    rows_of,
    share,
    stop_times,
    title,
    total,
    under,
    values,
)
from controller.reports.figures import FALSE, INK, OURS, PAPER, Figures
from controller.reports.first_screen import listed
from controller.reports.papers import WORST_CENTERING_M, headlines
from controller.reports.section import Headline, Kind, Result, Section, judged, kind_of
from controller.scales import scale_of

WANTED_M = 0.0025
"""Largest error of centering that is aimed at here; ours, not the paper's."""

Groups = Mapping[tuple[str, str, float], Sequence[Row]]


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Errors by method, object and speed; the histogram."""
    rows = rows_of(runs, SearchFactors)
    groups: Groups = grouped(rows, "object", "method", "speed_m_s")
    return Section(
        title="Centering without touching (C3)",
        content={
            "errors": [{**_named(key), **_errors(own)} for key, own in groups.items()],
            "grasps": [{**_named(key), **_grasps(own)} for key, own in groups.items()],
            "stops": stop_times(runs, "audio.fingers", _waits_s),
            "figure": _draw(groups, figures),
            "pipe_alone": {thing for thing, *_ in groups} == {"pipe"},  # the paper draws it alone
            "worst": quantity("error_m", WORST_CENTERING_M, 0),
        },
        template="centering",
        paper="rupavatharam",
        summary=_summary(_pooled(groups), kind_of(runs)),
        headline=_headline(rows),
    )


def _headline(rows: Sequence[Row]) -> Headline | None:
    """Our worst error beside that of the paper's method on the same bench, and beside what the paper prints."""
    found = listed(headlines("centering"), rows)
    rival_m = _worst_m([row for row in rows if row["method"] == "paper"])
    if not found or not found.paper or rival_m is None:
        return found
    rival = f"the paper's method on this bench {quantity('error_m', rival_m)}"
    return found._replace(verdict=f"{found.verdict}; {rival}", source=f"{found.source}; {rival}")


def _pooled(groups: Groups) -> Groups:
    """Trials of several objects together: each has its row in the table."""
    things = {thing for thing, *_ in groups}
    found: dict[tuple[str, str, float], list[Row]] = {}
    for (thing, method, speed_m_s), own in groups.items():
        name = thing if len(things) == 1 else f"{len(things)} objects"
        found.setdefault((name, method, speed_m_s), []).extend(own)
    return found


def _worst_m(own: Sequence[Row]) -> float | None:
    return max(map(abs, values(own, "error_m")), default=None)


def _summary(groups: Groups, kind: Kind) -> list[Result]:
    """Each method's worst error; of ours also beside the paper's method on the same bench."""
    results = []
    for (thing, method, speed_m_s), own in groups.items():
        what = f"{title(thing).capitalize()}, {METHODS[method]}, {quantity('speed_m_s', speed_m_s, 0)}"
        worst_m, found = _worst_m(own), len(values(own, "error_m"))
        if worst_m is None:
            results.append(Result(kind, f"{what}: never centred.", False, goal=True))
            continue
        lost = f"; {len(own) - found} of {len(own)} found no middle" if found < len(own) else ""
        trials = (
            f"worst error {quantity('error_m', worst_m)} in {found} {'trial' if found == 1 else 'trials'}"
        )
        bound_m, whose = (
            (WANTED_M, "{} aimed at") if method == "ours" else (WORST_CENTERING_M, "the paper's {}")
        )
        beside = whose.format(quantity("error_m", bound_m, 1))
        # the paper's method below the paper's own worst is no result of ours, and little of one of the bench
        beyond = sum(abs(error_m) > bound_m for error_m in values(own, "error_m")) + len(own) - found
        good = every(beyond, len(own))
        text = f"{what}: {trials}, {beside}{lost}"
        if method == "paper" and not beyond:
            results.append(Result(kind, f"{text}."))
        else:
            worse = False if worst_m > bound_m else None
            results.append(judged(kind, text, good, len(own), goal=method == "ours", better=worse))
        rival_m = _worst_m(groups.get((thing, "paper", speed_m_s), ())) if method == "ours" else None
        if rival_m and worst_m:
            ratio = max(rival_m, worst_m) / min(rival_m, worst_m)
            word = "smaller" if worst_m <= rival_m else "larger"
            text = f"{what}: worst error {ratio:.1f} times {word} than the paper's method's on this bench."
            results.append(Result(kind, text))
    return results


def _named(key: tuple[str, str, float]) -> Row:
    thing, method, speed_m_s = key
    return {"object": title(thing), "method": METHODS[method], **under("speed_m_s", speed_m_s)}


def _errors(own: Sequence[Row]) -> Row:
    errors_m = values(own, "error_m")
    mean = mean_of(errors_m)
    line: dict[str, Any] = {"trials": len(own), "no middle": len(own) - len(errors_m)}
    middle_m = statistics.median(map(abs, errors_m)) if errors_m else None
    found = {"worst": _worst_m(own), "mean": mean.mean, "sigma": mean.sigma, "median |error|": middle_m}
    for head, value in found.items():
        line |= under("error_m", value, head, 2)
    return line


def _grasps(own: Sequence[Row]) -> Row:
    touched = [row for row in own if row.get("touched") is not None]
    grasped = [row for row in own if row.get("gripped") is not None]
    both = sum(None not in (row.get("contact_left_s"), row.get("contact_right_s")) for row in grasped)
    return under("search_s", median(own, "search_s"), digits=1) | {
        "touched before": str(total(touched, "touched")) if touched else "unknown",
        "contact by both": share(both, len(grasped)) if grasped else "not requested",
    }


def _waits_s(runs: Sequence[Run]) -> Mapping[str, Sequence[float]]:
    """From the sample with which a finger saw the object to the arm's stop command, by method."""
    found = {}
    for (method,), own in grouped(rows_of(runs, SearchFactors), "method").items():
        waits_s = [*values(own, "seen_to_stop_left_s"), *values(own, "seen_to_stop_right_s")]
        if waits_s:
            found[METHODS[method]] = waits_s
    return found


def _draw(groups: Groups, figures: Figures) -> str:
    """One histogram for each method and speed, all objects together."""
    found = {key[1:]: values(own, "error_m") for key, own in _pooled(groups).items()}
    cells = {key: errors for key, errors in found.items() if errors}
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
            for place in (-WORST_CENTERING_M, WORST_CENTERING_M):
                axes.axvline(place * scale.factor, color=FALSE, lw=0.8, ls=(0, (4, 2)))
            axes.axvline(0.0, color=INK, lw=0.5)
            axes.set_title(f"{METHODS[method]}, {quantity('speed_m_s', speed_m_s, 0)}, n = {len(errors)}")
            axes.locator_params(axis="y", integer=True)
        drawing.label_outside(scale.heading, "trials")
        return drawing.save("fig_8c_centering")
