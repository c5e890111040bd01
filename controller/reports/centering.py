"""The part of the page on C3: how well the middle is found, beside the paper's Fig. 8c."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from behaviors.search import SearchFactors
from controller.recording.reader import Run
from controller.reports.approaches import mean_of
from controller.reports.counts import beside_bound, factor_of, of_benches, percentiles, total, values
from controller.reports.figures import FALSE, INK, OURS, PAPER, Figures
from controller.reports.section import Block, Figure, Kind, Result, Section
from controller.reports.section_texts import SectionTexts
from controller.reports.sonicfinger import (
    ASSUMED,
    CITATION,
    METHOD_NAMES,
    WANTED_CENTERING_M,
    WORST_CENTERING_M,
    printed_of,
    rows_of,
)
from controller.reports.text import quantity, share, title
from controller.scales import scale_of

Key = tuple[str, str, float]


TEXTS = SectionTexts("centering")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Errors by method, object and speed; the histogram."""
    groups = _groups(rows_of(runs))
    stops = _stops(runs)
    body: list[Block] = [
        TEXTS.text("intro"),
        TEXTS.table("errors", [_errors(key, rows) for key, rows in groups.items()]),
        TEXTS.table("grasps", [_grasps(key, rows) for key, rows in groups.items()]),
        *([TEXTS.table("stops", stops)] if stops else []),
    ]
    if any(values(rows, "error_m") for rows in groups.values()):
        body.append(
            Figure(
                _draw(groups, figures),
                (
                    "Fig. 8c. " if {thing for thing, *_ in groups} == {"pipe"} else ""
                )  # the paper draws it alone
                + TEXTS.sentence("figure", worst=quantity("error_m", WORST_CENTERING_M, 0)),
            )
        )
    return Section(
        title="Centering without touching (C3)",
        body=body,
        citation=CITATION,
        summary=_summary(groups, runs[0].simulated),
        not_the_papers=[*(ASSUMED if runs[0].simulated else ()), *TEXTS.each("ours")],
        printed=printed_of(runs[0]),
    )


def factor(row: Mapping[str, Any], name: str) -> Any:
    """See `factor_of`."""
    return factor_of(row, name, SearchFactors)


def _groups(rows: Sequence[Any]) -> Mapping[Key, Sequence[Any]]:
    groups: dict[Key, list[Any]] = {}
    for row in rows:
        key = (
            str(factor(row, "object")),
            str(factor(row, "method")),
            float(factor(row, "speed_m_s")),
        )
        groups.setdefault(key, []).append(row)
    return dict(sorted(groups.items()))


def _summary(groups: Mapping[Key, Sequence[Any]], simulated: bool) -> list[Result]:
    """Each method's worst error; of ours also beside the paper's method on the same bench."""
    worst_m = {key: max(map(abs, values(rows, "error_m")), default=None) for key, rows in groups.items()}
    results = []
    for key, rows in groups.items():
        thing, method, speed_m_s = key
        what = f"{title(thing).capitalize()}, {METHOD_NAMES[method]}, {quantity('speed_m_s', speed_m_s, 0)}"
        kind = Kind.PREDICTED if simulated else Kind.MEASURED
        own_m, found = worst_m[key], len(values(rows, "error_m"))
        if own_m is None:
            results.append(Result(kind, f"{what}: never centred.", False))
            continue
        lost = f"; {len(rows) - found} of {len(rows)} found no middle" if found < len(rows) else ""
        trials = f"worst error {quantity('error_m', own_m)} in {found} {'trial' if found == 1 else 'trials'}"
        rival_m = worst_m.get((thing, "paper", speed_m_s)) if method == "ours" else None
        bound_m = WANTED_CENTERING_M if method == "ours" else WORST_CENTERING_M
        whose = (
            f"{quantity('error_m', bound_m, 1)} {'aimed at' if method == 'ours' else 'that the paper has'}"
        )
        beside = f"{beside_bound(own_m, bound_m)} the {whose}"
        # the paper's method below the paper's own worst is no result of ours, and little of one of the bench
        good = own_m <= bound_m and not lost
        results.append(
            Result(kind, f"{what}: {beside}: {trials}{lost}.", good if method == "ours" or not good else None)
        )
        if rival_m and own_m:
            ratio, word = (
                max(rival_m, own_m) / min(rival_m, own_m),
                "smaller" if own_m <= rival_m else "larger",
            )
            text = f"{what}: worst error {ratio:.1f} times {word} than the paper's method's on this bench."
            results.append(Result(kind, text))
    return results


def _names(key: Key) -> dict[str, Any]:
    thing, method, speed_m_s = key
    return {"thing": title(thing), "method": METHOD_NAMES[method], "speed_m_s": speed_m_s}


def _errors(key: Key, rows: Sequence[Any]) -> dict[str, Any]:
    errors_m = values(rows, "error_m")
    sizes_m, mean = [abs(error) for error in errors_m], mean_of(errors_m)
    return _names(key) | {
        "n": len(rows),
        "lost": len(rows) - len(errors_m),
        "worst_m": max(sizes_m, default=None),
        "mean_m": mean.mean,
        "sigma_m": mean.sigma,
        "median_m": statistics.median(sizes_m) if sizes_m else None,
    }


def _grasps(key: Key, rows: Sequence[Any]) -> dict[str, Any]:
    search_s = values(rows, "search_s")
    touched = [row for row in rows if row.get("touched") is not None]
    grasped = [row for row in rows if row.get("gripped") is not None]
    both = sum(
        row.get("contact_left_s") is not None and row.get("contact_right_s") is not None for row in grasped
    )
    return _names(key) | {
        "search_s": statistics.median(search_s) if search_s else None,
        "touched": total(touched, "touched") if touched else "unknown",
        "both": share(both, len(grasped)) if grasped else "not requested",
    }


def _stops(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """From the sample with which a finger saw the object to the arm's stop command, by bench and method."""
    found = []
    for bench, there, lost in of_benches(runs, "audio.fingers"):
        rows = rows_of(there)
        for method in sorted({str(factor(row, "method")) for row in rows}):
            own = [row for row in rows if str(factor(row, "method")) == method]
            waits_s = [*values(own, "seen_to_stop_left_s"), *values(own, "seen_to_stop_right_s")]
            if waits_s:
                named = {"bench": bench, "method": METHOD_NAMES[method], "lost": lost}
                found.append(named | percentiles(waits_s))
    return found


def _draw(groups: Mapping[Key, Sequence[Any]], figures: Figures) -> Markup:
    """One histogram for each method and speed, all objects together."""
    cells: dict[tuple[str, float], list[float]] = {}
    for (_, method, speed_m_s), rows in groups.items():
        cells.setdefault((method, speed_m_s), []).extend(values(rows, "error_m"))
    cells = {key: errors for key, errors in sorted(cells.items()) if errors}
    scale = scale_of("error_m")
    reach = scale.factor * max(
        0.009, max(abs(error) for errors in cells.values() for error in errors) + 0.001
    )
    edges: list[float] = np.arange(-np.ceil(reach), np.ceil(reach) + 0.5, 0.5).tolist()
    columns = 2 if len(cells) > 1 else 1
    rows_count = -(-len(cells) // columns)
    with figures.figure(
        1.7 * rows_count + 0.5, rows=rows_count, columns=columns, sharex=True, sharey=True
    ) as drawing:
        for axes, ((method, speed_m_s), errors) in zip(drawing.axes, cells.items(), strict=False):
            color = OURS if method == "ours" else PAPER
            axes.hist(np.array(errors) * scale.factor, bins=edges, color=color, edgecolor="white", lw=0.3)
            for place in (-WORST_CENTERING_M, WORST_CENTERING_M):
                axes.axvline(place * scale.factor, color=FALSE, lw=0.8, ls=(0, (4, 2)))
            axes.axvline(0.0, color=INK, lw=0.5)
            axes.set_title(
                f"{METHOD_NAMES[method]}, {quantity('speed_m_s', speed_m_s, 0)}, n = {len(errors)}"
            )
        for axes in drawing.axes[len(cells) :]:
            axes.set_visible(False)
        for axes in drawing.axes[-columns:]:
            axes.set_xlabel(scale.heading)
        for axes in drawing.axes[::columns]:
            axes.set_ylabel("trials")
            axes.locator_params(axis="y", integer=True)
        return Markup(drawing.save("fig_8c_centering"))
