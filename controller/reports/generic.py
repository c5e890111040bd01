"""The part of the page on an experiment that has none of its own: every measured column by factor, and drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from markupsafe import Markup

from controller.recording.reader import Run
from controller.reports.approaches import Mean, mean_of
from controller.reports.counts import rate
from controller.reports.figures import OURS, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Block, Column, Figure, ReportTable, Result, Section, Text
from controller.reports.text import title
from controller.scales import NOTHING, figure, scale_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = Mapping[str, Any]

PANELS = 24
"""Most columns that are drawn: as many as one page holds. The table has them all."""


def section(experiment: str, runs: Sequence[Run], figures: Figures) -> Section:
    """Trials, their outcomes, and each measured column's mean and spread."""
    rows = [row for run in runs for row in run.trials]
    names = list(dict.fromkeys(name for row in rows for name in row))
    factors = [name for name in names if any(name in run.factors for run in runs)]
    measured = [name for name in names if name not in ("trial", "outcome", *factors)]
    numbers = [name for name in measured if any(is_number(row.get(name)) for row in rows)]
    groups = grouped(rows, factors)
    body: list[Block] = [
        Text("This experiment has no section of its own: these are its trials and what was measured in them.")
    ]
    if numbers:
        body.append(_table(groups, factors, numbers))
        body.append(Figure(Markup(_draw(figures, groups, numbers[:PANELS])), _caption(numbers, groups)))
    outcomes = sorted({str(row.get("outcome")) for row in rows})
    summary = [
        Result(
            None,
            f"{title(name).capitalize()}: {rate(sum(row.get('outcome') == name for row in rows), len(rows))}.",
        )
        for name in outcomes
    ]
    good = sum(run.succeeded(row) for run in runs for row in run.trials)
    if len(outcomes) == 1 and good:
        summary.clear()  # it would say the same
    summary.insert(0, Result(None, f"Succeeded: {rate(good, len(rows))}."))
    name = title(experiment.rpartition(":")[2])
    return Section(
        str(setting_of(runs[0], "title") or name or "trials"),
        body,
        summary=[*summary, *_spreads(rows, numbers)],
    )


def grouped(rows: Sequence[Row], factors: Sequence[str]) -> list[tuple[tuple[str, ...], list[Row]]]:
    """Trials of equal factors together, in the order of the factors' values."""

    def order(row: Row) -> list[tuple[int, float, str]]:
        cells = [row.get(name) for name in factors]
        return [(0, float(cell), "") if is_number(cell) else (1, 0.0, str(cell)) for cell in cells]

    ordered = sorted(rows, key=order)
    return [
        (tuple(scale_of(name).cell(own[0].get(name)) for name in factors), own)
        for _, group in groupby(ordered, key=order)
        if (own := list(group))
    ]


def is_number(value: object) -> TypeGuard[float]:
    """Whether a cell holds a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _mean(rows: Sequence[Row], name: str) -> Mean:
    return mean_of(row[name] if is_number(row.get(name)) else None for row in rows)


def with_spread(mean: Mean, factor: float) -> str:
    """`0.1396 ± 0.021 (3)`: mean, standard deviation (n - 1), n."""
    if not mean.n:
        return NOTHING
    spread = f" ± {mean.sigma * factor:.2g}" if mean.n > 1 else ""
    return f"{figure(mean.mean * factor)}{spread} ({mean.n})"


def _table(
    groups: Sequence[tuple[tuple[str, ...], Sequence[Row]]], factors: Sequence[str], numbers: Sequence[str]
) -> ReportTable:
    """One line a measured column, one column a set of factors, or the other way where there are more sets."""
    columns = [Column(scale_of(name).label, name) for name in (*factors, "n", *numbers)]
    rows = [
        [*values, str(len(own)), *(with_spread(_mean(own, name), scale_of(name).factor) for name in numbers)]
        for values, own in groups
    ]
    caption = "Mean ± standard deviation (n − 1) of each measured column, and in brackets of how many trials."
    return ReportTable(columns, rows, caption, left=len(factors))


def _spreads(rows: Sequence[Row], numbers: Sequence[str]) -> list[Result]:
    scales = {name: scale_of(name) for name in numbers[:3]}
    return [
        Result(None, f"{scale.heading}: {with_spread(_mean(rows, name), scale.factor)}.")
        for name, scale in scales.items()
    ]


def _caption(numbers: Sequence[str], groups: Sequence[Any]) -> str:
    left_out = f" {len(numbers) - PANELS} more columns are in the table." if len(numbers) > PANELS else ""
    return (
        "Every trial as a dot, by its factors in the order of the table above; bars are mean ± standard deviation "
        f"(n − 1).{left_out}"
    )


def _draw(
    figures: Figures, groups: Sequence[tuple[tuple[str, ...], Sequence[Row]]], numbers: Sequence[str]
) -> str:
    across = min(3, len(numbers))
    down = -(-len(numbers) // across)
    with figures.figure(1.7 * down + 0.4, rows=down, columns=across) as drawing:
        for axes, name in zip(drawing.axes, numbers, strict=False):
            _draw_panel(axes, groups, name)
        for axes in drawing.axes[len(numbers) :]:
            axes.set_visible(False)
        return drawing.save("measured")


def _draw_panel(axes: Axes, groups: Sequence[tuple[tuple[str, ...], Sequence[Row]]], name: str) -> None:
    scale = scale_of(name)
    for place, (_, own) in enumerate(groups, start=1):
        known = [float(row[name]) * scale.factor for row in own if is_number(row.get(name))]
        axes.plot([place] * len(known), known, ".", color=OURS, alpha=0.5, mew=0)
        mean = mean_of(known)
        if mean.n > 1:
            axes.errorbar(place, mean.mean, mean.sigma, fmt="o", ms=3.0, color=OURS)
    axes.set_title(scale.heading)
    axes.set_xticks(range(1, len(groups) + 1) if len(groups) <= 8 else [1, len(groups)])
    axes.set_xlim(0.4, len(groups) + 0.6)
    axes.locator_params(axis="y", nbins=4)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.7g}")  # whole: no offset beside the title
