"""The part of the page on B6: gain, hysteresis and resolution of the fingertip's bridges, beside the paper's Fig. 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.measures.bridge_calibration import (
    DETECTED_SIGMA,
    BridgeCalibration,
    Step,
    calibrate,
    steps_of,
)
from controller.reports.counts import Comparison, number
from controller.reports.figures import OURS, PAPER, Figures
from controller.reports.papers import as_printed
from controller.reports.run_account import recorded, setting_of
from controller.reports.section import Kind, Section, kind_of, told
from controller.scales import scale_of

if TYPE_CHECKING:
    from controller.recording.reader import Run

FIGURES = {
    "gain_v_n": (scale_of("gain_v_n").heading, 1.0, 4),
    "hysteresis": ("hysteresis, % of full scale", 100.0, 2),
    "resolution_n": (f"resolution ({DETECTED_SIGMA:g} σ), {scale_of('resolution_n').unit}", 1.0, 4),
}
"""What the paper prints of a bridge: its heading, and the scale and decimals that ours is shown with."""

Bridge = tuple[Mapping[str, str], Sequence[Sequence[Step]], BridgeCalibration]
"""What the paper prints of a bridge; every trial's steps, and their pooled calibration."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and figures of all calibrations of some runs on one kind of bench."""
    bridges, rows, said = read_bridges(runs), [], []
    for paper, _, own in bridges:
        beside = {name: compared(paper, own, name) for name in FIGURES}
        missed = [name.partition("_")[0] for name, each in beside.items() if not each.met]
        said.append((paper["force"], beside["gain_v_n"], missed))
        for name, (heading, scale, digits) in FIGURES.items():
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
    content = {
        "kind": kind_of(runs, Kind.FITTED),
        "said": said,
        "known": sorted({float(setting_of(run, "behavior", "weight_uncertainty") or 0.0) for run in runs}),
        "calibrated": rows,
        "figure_6": _draw(figures, bridges) if bridges else "",
        "sigma": DETECTED_SIGMA,
        "bridges": bridges,
    }
    return told(runs, "Calibration with weights (B6)", "weights", content, paper="fernandez")


def read_bridges(runs: Sequence[Run]) -> list[Bridge]:
    """The bridges that were calibrated, from x to t; trials of one bridge are pooled."""
    uncertainty = max(float(setting_of(run, "behavior", "weight_uncertainty") or 0.0) for run in runs)
    bridges: list[Bridge] = []
    for paper in as_printed("fernandez_bridges"):
        trials = [
            steps_of(
                recording,
                load_stream=str(setting_of(run, "behavior", "load_stream")),
                bridges_stream=str(setting_of(run, "behavior", "bridges_stream")),
                bridge=paper["bridge"],
                preloads=int(setting_of(run, "behavior", "preloads") or 0),
            )
            for run, row, recording in recorded(runs)
            if row.get("bridge") == paper["bridge"] and run.succeeded(row)
        ]
        calibration = calibrate(trials, uncertainty)
        if calibration is not None:
            bridges.append((paper, trials, calibration))
    return bridges


def compared(paper: Mapping[str, str], own: BridgeCalibration, name: str) -> Comparison:
    """A figure of a bridge beside the paper's, which stands for everything that is rounded to it: met where our
    interval holds such a value."""
    printed, ours = float(paper[name]), getattr(own, name)
    half = 0.5 * 10.0 ** -len(paper[name].partition(".")[2])
    met = ours.low <= printed + half and printed - half <= ours.high
    return Comparison(ours.value, printed, met, ours.low, ours.high)


def _draw(figures: Figures, bridges: Sequence[Bridge]) -> str:
    """All voltages of a load, less the empty bridge's, as a bar; the line through them; the paper's."""
    with figures.figure(2.7, columns=len(bridges)) as drawing:
        for axes, (paper, trials, found) in zip(drawing.axes, bridges, strict=True):
            volts: dict[float, list[float]] = {}
            for steps in trials:
                for step in steps[1:]:
                    if step.cycle >= 0 and step.load_n > 0.0:
                        volts.setdefault(step.load_n, []).append(step.mean_v - steps[0].mean_v)
            bars: Any = {"color": OURS, "lw": 2.2, "capstyle": "butt", "label": "data"}
            axes.vlines(list(volts), [*map(min, volts.values())], [*map(max, volts.values())], **bars)
            gain, ends_n = found.gain_v_n, np.array([0.0, found.top_n])
            axes.plot(ends_n, gain.value * ends_n, color=OURS, lw=0.9, label="fitted line")
            theirs: Any = {"color": PAPER, "lw": 0.9, "ls": (0, (4, 3)), "label": "paper"}
            axes.plot(ends_n, float(paper["gain_v_n"]) * ends_n, **theirs)
            axes.set_title(f"{paper['force']}: {gain.value:.4f} ± {(gain.high - gain.low) / 2.0:.4f} V/N")
            symbol = f"V_{{g{paper['gauges']}}}"
            axes.set(xlabel=f"force {paper['force']} (N)", ylabel=f"voltage ${symbol}$ (V)")
            axes.set(xlim=(0.0, 1.04 * found.top_n))
            axes.set_ylim(bottom=0.0)
        drawing.axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 0.98))
        return drawing.save("fig_6_calibration")
