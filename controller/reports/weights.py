"""The part of the page on B6: gain, hysteresis and resolution of the fingertip's bridges, beside the paper's Fig. 6."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.measures.bridge_calibration import DETECTED_SIGMA, Step, steps_of
from controller.reports.counts import Comparison, Row, Trials, number
from controller.reports.figures import OURS, PAPER, Figures
from controller.reports.papers import as_printed
from controller.reports.run_account import recorded, setting_of
from controller.reports.section import Kind, Section, kind_of, told
from controller.scales import scale_of

if TYPE_CHECKING:
    from controller.recording.reader import Run

FIGURES = {
    "gain_v_n": ("gain_{}_v_n", scale_of("gain_v_n").heading, 1.0, 4),
    "hysteresis": ("hysteresis_{}", "hysteresis, % of full scale", 100.0, 2),
    "resolution_n": (
        "resolution_{}_n",
        f"resolution ({DETECTED_SIGMA:g} σ), {scale_of('resolution_n').unit}",
        1.0,
        4,
    ),
}
"""What the paper prints of a bridge: the columns of its ends, its heading, and the scale and decimals of ours."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and figures of all calibrations of some runs on one kind of bench."""
    calibrated = Trials(
        row for run in runs for row in Trials.of([run]).known("gain_v_n") if run.succeeded(row)
    )
    bridges = {
        paper["bridge"]: (paper, own)
        for paper in as_printed("fernandez_bridges")
        if (own := calibrated.where(bridge=paper["bridge"]))
    }
    rows, said = [], []
    for paper, row in ((paper, row) for paper, own in bridges.values() for row in own):
        beside = {name: compared(paper, row, name) for name in FIGURES}
        missed = [name.partition("_")[0] for name, each in beside.items() if not each.met]
        said.append((paper["force"], beside["gain_v_n"], missed))
        for name, (_, heading, scale, digits) in FIGURES.items():
            ours, theirs, met, low, high = beside[name][:5]
            rows.append(
                {
                    "bridge": paper["force"],
                    "": heading,
                    "ours": number(ours, digits, scale),
                    "95 % interval": f"{number(low, digits, scale)} to {number(high, digits, scale)}",
                    "paper": f"{theirs * scale:.6g}",
                    "agrees": "yes" if met else "no",
                }
            )
    hung = {
        bridge: setting_of(runs[0], "behavior", f"weights_{bridge}_n") or [math.nan] for bridge in bridges
    }
    content = {
        "kind": kind_of(runs, Kind.FITTED),
        "said": said,
        "known": sorted({float(setting_of(run, "behavior", "weight_uncertainty") or 0.0) for run in runs}),
        "calibrated": rows,
        "figure_6": _draw(figures, bridges, _steps(runs)) if bridges else "",
        "sigma": DETECTED_SIGMA,
        "tops": [(paper, max(hung[bridge])) for bridge, (paper, _) in bridges.items()],
    }
    return told(runs, "Calibration with weights (B6)", "weights", content, paper="fernandez")


def compared(paper: Mapping[str, str], row: Row, name: str) -> Comparison:
    """A figure of a bridge beside the paper's, which stands for everything that is rounded to it: met where our
    interval holds such a value."""
    printed, ours = float(paper[name]), float(row[name])
    ends = (row.get(FIGURES[name][0].format(end)) for end in ("low", "high"))
    low, high = (math.nan if end is None else float(end) for end in ends)
    half = 0.5 * 10.0 ** -len(paper[name].partition(".")[2])
    return Comparison(ours, printed, low <= printed + half and printed - half <= high, low, high)


def _steps(runs: Sequence[Run]) -> Mapping[str, Sequence[Sequence[Step]]]:
    """What hung in each trial that calibrated a bridge, by bridge."""
    found: dict[str, list[Sequence[Step]]] = {}
    for run, row, recording in recorded(runs):
        if run.succeeded(row):
            steps = steps_of(
                recording,
                load_stream=str(setting_of(run, "behavior", "load_stream")),
                bridges_stream=str(setting_of(run, "behavior", "bridges_stream")),
                bridge=str(row["bridge"]),
                preloads=int(setting_of(run, "behavior", "preloads") or 0),
            )
            found.setdefault(str(row["bridge"]), []).append(steps)
    return found


def _draw(
    figures: Figures,
    bridges: Mapping[str, tuple[Mapping[str, str], Trials]],
    steps_by: Mapping[str, Sequence[Sequence[Step]]],
) -> str:
    """All voltages of a load, less the empty bridge's, as a bar; the line through them; the paper's."""
    with figures.figure(2.7, columns=len(bridges)) as drawing:
        for axes, (bridge, (paper, own)) in zip(drawing.axes, bridges.items(), strict=True):
            volts: dict[float, list[float]] = {}
            for steps in steps_by.get(bridge, ()):
                for step in steps[1:]:
                    if step.cycle >= 0 and step.load_n > 0.0:
                        volts.setdefault(step.load_n, []).append(step.mean_v - steps[0].mean_v)
            bars: Any = {"color": OURS, "lw": 2.2, "capstyle": "butt", "label": "data"}
            axes.vlines(list(volts), [*map(min, volts.values())], [*map(max, volts.values())], **bars)
            gain_v_n, low, high = (own.mean(f"gain_{end}v_n").mean for end in ("", "low_", "high_"))
            ends_n = np.array([0.0, max(volts, default=float(paper["top_n"]))])
            axes.plot(ends_n, gain_v_n * ends_n, color=OURS, lw=0.9, label="fitted line")
            theirs: Any = {"color": PAPER, "lw": 0.9, "ls": (0, (4, 3)), "label": "paper"}
            axes.plot(ends_n, float(paper["gain_v_n"]) * ends_n, **theirs)
            axes.set_title(f"{paper['force']}: {gain_v_n:.4f} ± {(high - low) / 2.0:.4f} V/N")
            symbol = f"V_{{g{paper['gauges']}}}"
            axes.set(xlabel=f"force {paper['force']} (N)", ylabel=f"voltage ${symbol}$ (V)")
            axes.set(xlim=(0.0, 1.04 * ends_n[1]))
            axes.set_ylim(bottom=0.0)
        drawing.axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 0.98))
        return drawing.save("fig_6_calibration")
