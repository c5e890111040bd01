"""The part of the page on an experiment that has none of its own: every measured column by factor, and drawn."""

from collections.abc import Sequence
from typing import Any

from controller.recording.reader import Run
from controller.reports.counts import Trials, is_number, mean_of, rate, title, with_spread
from controller.reports.figures import OURS, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Figure, Result, Section, measured
from controller.scales import scale_of

PANELS = 24
"""Most columns that are drawn: as many as one page holds. The table has them all."""


def section(experiment: str, runs: Sequence[Run], figures: Figures) -> Section:
    """Trials, their outcomes, and each measured column's mean and spread."""
    rows = Trials.of(runs)
    names = list(dict.fromkeys(name for row in rows for name in row))
    factors = [name for name in names if any(name in run.factors for run in runs)]
    taken = ("trial", "outcome", *factors)
    numbers = [name for name in names if name not in taken and any(is_number(row.get(name)) for row in rows)]
    groups = list(rows.by(*factors).values())
    what = "This experiment has no section of its own: these are its trials and what was measured in them."
    content: dict[str, Any] = {"what": what}
    if numbers:
        content["caption"] = (
            "Mean ± standard deviation (n − 1) of each measured column, in brackets of how many trials where some "
            "have none."
        )
        content["measured"] = measured(groups, factors, numbers)
        left_out = f" {len(numbers) - PANELS} more columns are in the table." if len(numbers) > PANELS else ""
        shown = (
            "Every trial as a dot, by its factors in the order of the table above; bars are mean ± standard"
        )
        drawn = _draw(figures, groups, numbers[:PANELS])
        content["drawn"] = Figure(drawn, f"{shown} deviation (n − 1).{left_out}")
    good = sum(run.succeeded(row) for run in runs for row in Trials.of([run]))
    counts = {name: len(own) for (name,), own in rows.by("outcome", order=str).items()}
    if len(counts) == 1 and good:
        counts.clear()  # it would say the same
    said = [f"Succeeded: {rate(good, len(rows))}."]
    said += [f"{title(str(name)).capitalize()}: {rate(n, len(rows))}." for name, n in counts.items()]
    for name in numbers[:3]:
        scale = scale_of(name)
        said.append(f"{scale.heading}: {with_spread(rows.mean(name), scale.factor)}.")
    heading = str(setting_of(runs[0], "title") or title(experiment.rpartition(":")[2]) or "trials")
    return Section(heading, content, summary=[Result(None, each) for each in said])


def _draw(figures: Figures, groups: Sequence[Trials], numbers: Sequence[str]) -> str:
    with figures.panels(len(numbers), min(3, len(numbers)), 1.7) as drawing:
        for axes, name in zip(drawing.axes, numbers, strict=True):
            scale = scale_of(name)
            for place, own in enumerate(groups, start=1):
                known = [value * scale.factor for value in own.values(name)]
                axes.plot([place] * len(known), known, ".", color=OURS, alpha=0.5, mew=0, ms=7.0)
                mean = mean_of(known)
                if mean.n > 1:
                    axes.errorbar(place, mean.mean, mean.sigma, fmt="o", ms=3.0, color=OURS)
            axes.set_title(scale.heading)
            axes.set_xticks(range(1, len(groups) + 1) if len(groups) <= 8 else [1, len(groups)])
            axes.set_xlim(0.4, len(groups) + 0.6)
            axes.locator_params(axis="y", nbins=4)
            axes.yaxis.set_major_formatter(
                lambda value, _: f"{value:.7g}"
            )  # whole: no offset beside the title
        return drawing.save("measured")
