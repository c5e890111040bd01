"""The figures of A2: Fig. 5, 7, 8 and 9 of the paper, with the paper's points, and what noise and rate do."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from controller.recording.series import DETECTOR, Series
from controller.reports.approaches import (
    NOISE,
    SAMPLE_HZ,
    TABLE_1,
    Approach,
    TableRow,
    figure_rows,
)
from controller.reports.counts import Row
from controller.reports.figures import FAINT, FALSE, INK, OURS, PAPER, Figures
from controller.reports.run_account import series_of, statistic_of
from controller.scales import scale_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEFORE_S, AFTER_S = 2.2, 0.35
"""What Fig. 5 shows before onset and after standstill, seconds."""


class Trace(NamedTuple):
    """One approach, ready to be drawn; times in seconds of the trial's bench time.

    Attributes:
        force: Of the load cell.
        period: Of the finger.
        statistic: What the acting detector compared, and its threshold, decision by decision; empty where it was not
            recorded.
        label: What that is.
        zero_n: The load cell before the approach.
        contact_s: When the detector's contact began and ended.
    """

    approach: Approach
    force: Series
    period: Series
    statistic: Series
    label: str
    zero_n: float
    contact_s: Sequence[tuple[float, bool]]


def representative(approaches: Sequence[Approach]) -> Approach | None:
    """The approach to draw: a recorded contact at the distal end (d), as in Fig. 5, of median delay."""
    seen = [each for each in approaches if each.detected and each["trial"] in each.run.recorded_trials]
    like = [each for each in seen if each.location == "d"] or seen
    like.sort(key=lambda each: each["delay_s"] or 0.0)
    return like[len(like) // 2] if like else None


def trace_of(approach: Approach) -> Trace | None:
    """Read an approach's recording; None where it cannot be read, or has no load cell or no period counts."""
    run, acting = approach.run, approach.acting
    recording = run.readable(approach["trial"])
    if recording is None:
        return None
    force, period = series_of(recording, "load_cell"), series_of(recording, "period")
    if not len(force) or not len(period):
        return None
    mine = [event for event in run.events if event.get("trial") == approach["trial"]]
    name, unit = statistic_of(run, acting)
    begun_s = next((event["t_s"] for event in mine if event.get("next") == "APPROACH"), force.times_s[-1])
    before = force.between(-math.inf, float(begun_s)).values
    switches = [
        (float(event["t_s"]), event["event"] == "Contact")
        for event in mine
        if event.get("event") in ("Contact", "ContactLost") and event.get("detector") == acting
    ]
    return Trace(
        approach,
        force,
        period,
        recording.stream(f"{DETECTOR}{acting}"),
        f"{name} ({unit})" if unit else name,
        float(before.mean()) if len(before) else 0.0,
        switches,
    )


def draw_trial(figures: Figures, trace: Trace) -> str:
    """Fig. 5: force, what the detector compares with its threshold (beside the raw frequency, where it is one), contact
    state."""
    approach = trace.approach
    onset_s, detect_s = approach["onset_s"] or 0.0, approach["detect_s"] or 0.0
    start_s = max(float(trace.force.times_s[0]), onset_s - BEFORE_S)
    end_s = min(float(trace.force.times_s[-1]), (approach["standstill_s"] or detect_s) + AFTER_S)
    force = trace.force.between(start_s, end_s)
    with figures.figure(4.6, rows=3, sharex=True, height_ratios=[3, 4, 1]) as drawing:
        top, middle, bottom = drawing.axes
        top.plot(force.times_s, force.values[:, 0] - trace.zero_n, color=OURS, lw=0.7)
        top.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
        top.set_ylabel("force (N)")
        _draw_statistic(middle, trace, start_s, end_s)
        times = np.maximum.accumulate([start_s, *(t_s for t_s, _ in trace.contact_s), end_s])
        state = [0.0, *(float(on) for _, on in trace.contact_s)]
        bottom.stairs(state, times, fill=True, color=OURS, alpha=0.25)
        bottom.stairs(state, times, color=OURS, lw=1.0, baseline=None)
        bottom.set(ylim=(-0.15, 1.25), yticks=[0, 1], yticklabels=["none", "contact"], ylabel="state")
        for axes in drawing.axes:
            axes.axvline(onset_s, color=INK, lw=0.7, ls=(0, (4, 2)))
            axes.axvline(detect_s, color=FALSE, lw=0.9)
        above: Any = {"y": 1.02, "va": "bottom", "fontsize": 8.5, "transform": top.get_xaxis_transform()}
        top.text(onset_s, s="0.005 N reached", ha="right", **above)
        top.text(detect_s, s=f"detected {detect_s - onset_s:.2f} s later", ha="left", color=FALSE, **above)
        bottom.set(xlim=(start_s, end_s), xlabel="time since the trial began (s)")
        drawing.figure.align_ylabels()
        return drawing.save("fig_5_trial")


def _draw_statistic(axes: Axes, trace: Trace, start_s: float, end_s: float) -> None:
    period, held = trace.period.between(start_s, end_s), trace.statistic.between(start_s, end_s)
    frequency = trace.statistic.unit == "Hz" or not len(trace.statistic)
    if frequency:
        raw: Any = {"color": FAINT, "lw": 0.8, "marker": ".", "ms": 3, "mec": PAPER, "mfc": PAPER}
        axes.plot(period.times_s, 1.0 / period.values[:, 0], **raw, label="frequency, raw")
    if len(held):
        style: Any = {"drawstyle": "steps-post"}  # it stands until the next decision
        axes.plot(held.times_s, held.values[:, 0], color=OURS, marker="o", ms=2.6, label=trace.label, **style)
        dashed: Any = style | {"ls": (0, (5, 2)), "lw": 0.9, "label": "threshold"}
        axes.plot(held.times_s, held.values[:, 1], color=FALSE, **dashed)
    axes.set_ylabel("frequency (Hz)" if frequency else f"statistic ({trace.statistic.unit})")
    axes.legend(loc="upper left", ncols=3)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.12 * (high - low))  # room for the legend


def draw_locations(figures: Figures, rows: Sequence[TableRow], side: str) -> str:
    """Fig. 7 (pad) or Fig. 8 (back): force and extent against where the finger is touched."""
    papers = figure_rows(side)
    length_m = max(float(paper["micrometer_m"]) for paper in papers)

    def along(paper: Row) -> float:
        return float(paper["micrometer_m"]) / length_m

    name = "fig_7_pad" if side == "pad" else "fig_8_back"
    heading = f"place on the {side}, distal (0) to proximal (1)"
    return _draw_pair(figures, rows, papers, along, (-0.08, 1.1), heading, name, letters=True)


def draw_speeds(figures: Figures, rows: Sequence[TableRow]) -> str:
    """Fig. 9: force and extent against speed, at the middle of the pad."""
    scale = scale_of("speed_m_s")
    papers = [paper for paper in TABLE_1 if paper["location"] == "f"]

    def along(paper: Row) -> float:
        return float(paper["speed_m_s"]) * scale.factor

    return _draw_pair(figures, rows, papers, along, (0.0, 13.5), scale.heading, "fig_9_speed")


def _draw_pair(
    figures: Figures,
    rows: Sequence[TableRow],
    papers: Sequence[Row],
    along: Callable[[Row], float],
    limits: tuple[float, float],
    heading: str,
    name: str,
    letters: bool = False,
) -> str:
    """Force on the left, extent on the right, at `along` of each row of the paper: the paper's means a little to the
    left of their place, this run's to the right, single approaches beside them."""
    mine = [(along(row.paper), row) for row in rows if row.paper in papers and row.paper]
    shift = 0.009 * (limits[1] - limits[0])
    with figures.figure(2.8, columns=2) as drawing:
        for axes, column in zip(drawing.axes, ("force_n", "extent_m"), strict=True):
            scale = scale_of(column)
            theirs = np.array([(along(p), p[column], p[f"{column}.sd"]) for p in papers]).T
            squares: Any = {"fmt": "s", "mfc": "white", "color": PAPER, "lw": 0.8, "label": "paper, mean ± σ"}
            axes.errorbar(theirs[0] - shift, theirs[1] * scale.factor, theirs[2] * scale.factor, **squares)
            means = [(x + shift, row.mean(column)) for x, row in mine]
            sigmas = np.nan_to_num([mean.sigma for _, mean in means]) * scale.factor
            circles: Any = {"fmt": "o", "color": OURS, "lw": 1.0, "label": "this run, mean ± σ"}
            axes.errorbar(
                [x for x, _ in means], [mean.mean * scale.factor for _, mean in means], sigmas, **circles
            )
            single = [(x + 3.0 * shift, each[column]) for x, row in mine for each in row.contacts]
            known = [(x, value * scale.factor) for x, value in single if value is not None]
            dots: Any = {"alpha": 0.45, "ms": 4.5, "mew": 0, "label": "this run, single approaches"}
            axes.plot(*zip(*known, strict=True), ".", color=OURS, **dots)
            at_detection = ", at detection" if column == "force_n" else ""
            axes.set(xlabel=heading, ylabel=f"{scale.heading}{at_detection}", xlim=limits)
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        for paper in papers if letters else ():
            look: Any = {"ha": "center", "va": "bottom", "style": "italic", "color": PAPER}
            place = (along(paper), 1.0)
            drawing.axes[0].annotate(paper["location"], place, xycoords=("data", "axes fraction"), **look)
        drawing.legend(drawing.axes[0], 3)
        return drawing.save(name)


def draw_study(figures: Figures, cells: Sequence[Row]) -> str:
    """Delay and false contacts against noise, one line for each rate of frequency samples; all else alike."""
    rates = sorted({cell[SAMPLE_HZ] for cell in cells})
    with figures.figure(2.7, columns=2) as drawing:
        left, right = drawing.axes
        for index, rate in enumerate(rates):
            mine = [cell for cell in cells if cell[SAMPLE_HZ] == rate]
            apart = 1.0 + 0.03 * (index - (len(rates) - 1) / 2.0)
            x = np.array([cell[NOISE] for cell in mine]) * apart
            style: Any = {
                "color": OURS,
                "alpha": 1.0 - 0.7 * index / len(rates),
                "marker": "os^Dv"[index % 5],
                "label": f"{rate:g} samples/s",
            }
            sigmas = np.nan_to_num([cell["delay_s"].sigma for cell in mine])
            left.errorbar(x, [cell["delay_s"].mean for cell in mine], sigmas, **style)
            right.plot(x, [100.0 * cell["false"] / cell["n"] for cell in mine], **style)
        scales = sorted({cell[NOISE] for cell in cells})
        for axes, label in ((left, "delay (s), mean ± σ"), (right, "false contacts (%)")):
            axes.set(xscale="log", xlabel="noise, relative to the plant's own", ylabel=label)
            axes.set_xticks(scales, [f"{scale:g}" for scale in scales])
            axes.set_xticks([], minor=True)
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        drawing.legend(left, len(rates))
        return drawing.save("delay_noise_rate")
