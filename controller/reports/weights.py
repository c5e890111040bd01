"""The part of the page on B6: gain, hysteresis and resolution of the fingertip's bridges, beside the paper's Fig. 6."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.measures.bridge_calibration import (
    DETECTED_SIGMA,
    BridgeCalibration,
    Step,
    calibrate,
    steps_of,
)
from controller.reports.counts import Comparison, Row, number, quantity
from controller.reports.figures import OURS, PAPER, Figures
from controller.reports.papers import as_printed
from controller.reports.run_account import recorded, setting_of
from controller.reports.section import Kind, Result, Section, kind_of
from controller.scales import scale_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    uncertainties = {float(setting_of(run, "behavior", "weight_uncertainty") or 0.0) for run in runs}
    bridges = read_bridges(runs)
    tops = [
        f"{own.top_n:g} N on {paper['force']} (the paper {paper['top_n']} N)" for paper, _, own in bridges
    ]
    known = " and ".join(f"{100.0 * value:g} %" for value in sorted(uncertainties))
    return Section(
        title="Calibration with weights (B6)",
        content={
            "known": known,
            "tops": " and ".join(tops) or "the largest weight",
            "trials": sum(len(run.trials) for run in runs),
            "calibrated": [row for bridge in bridges for row in _rows(bridge)],
            "figure_6": _draw(figures, bridges) if bridges else "",
            "sigma": DETECTED_SIGMA,
            "bridges": [(paper["force"], own) for paper, _, own in bridges],
            "number": number,
        },
        template="weights",
        paper="fernandez",
        summary=[_sentence(paper, own, kind_of(runs, Kind.FITTED)) for paper, _, own in bridges],
    )


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


def _sentence(paper: Mapping[str, str], own: BridgeCalibration, kind: Kind) -> Result:
    missed = [name.partition("_")[0] for name in FIGURES if not compared(paper, own, name).met]
    verdict = "the paper's gain, hysteresis and resolution agree with our 95 % intervals"
    if missed:
        lie = "lies outside our 95 % interval" if len(missed) == 1 else "lie outside our 95 % intervals"
        verdict = f"the paper's {' and '.join(missed)} {lie}"
    gain = compared(paper, own, "gain_v_n")
    text = f"{paper['force']}: gain {number(100.0 * abs(gain.ours / gain.paper - 1.0), 1)} % {gain.side} the paper's "
    text += f"{quantity('gain_v_n', gain.paper, 4)}, {quantity('gain_v_n', gain.ours, 4)}; {verdict}."
    return Result(kind, text, not missed)


def _rows(bridge: Bridge) -> Iterator[Row]:
    paper, _, own = bridge
    for name, (heading, scale, digits) in FIGURES.items():
        beside = compared(paper, own, name)
        yield {
            "bridge": paper["force"],
            "": heading,
            "ours": number(beside.ours, digits, scale),
            "95 % interval": f"{number(beside.low, digits, scale)} to {number(beside.high, digits, scale)}",
            "paper": f"{beside.paper * scale:.6g}",
            "agrees": "yes" if beside.met else "no",
        }


def _draw(figures: Figures, bridges: Sequence[Bridge]) -> str:
    with figures.figure(2.7, columns=len(bridges)) as drawing:
        for axes, bridge in zip(drawing.axes, bridges, strict=True):
            _draw_line(axes, *bridge)
        drawing.axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 0.98))
        return drawing.save("fig_6_calibration")


def _draw_line(
    axes: Axes, paper: Mapping[str, str], trials: Sequence[Sequence[Step]], found: BridgeCalibration
) -> None:
    """All voltages of a load, less the empty bridge's, as a bar; the line through them; the paper's."""
    volts: dict[float, list[float]] = {}
    for steps in trials:
        for step in steps[1:]:
            if step.cycle >= 0 and step.load_n > 0.0:
                volts.setdefault(step.load_n, []).append(step.mean_v - steps[0].mean_v)
    bars: Any = {"color": OURS, "lw": 2.2, "capstyle": "butt", "label": "data"}
    axes.vlines(list(volts), [min(v) for v in volts.values()], [max(v) for v in volts.values()], **bars)
    gain, ends_n = found.gain_v_n, np.array([0.0, found.top_n])
    axes.plot(ends_n, gain.value * ends_n, color=OURS, lw=0.9, label="fitted line")
    axes.plot(ends_n, float(paper["gain_v_n"]) * ends_n, color=PAPER, lw=0.9, ls=(0, (4, 3)), label="paper")
    symbol, half = f"V_{{g{paper['gauges']}}}", (gain.high - gain.low) / 2.0
    axes.set_title(f"{paper['force']}: {gain.value:.4f} ± {half:.4f} V/N")
    axes.set(xlabel=f"force {paper['force']} (N)", ylabel=f"voltage ${symbol}$ (V)")
    axes.set(xlim=(0.0, 1.04 * found.top_n))
    axes.set_ylim(bottom=0.0)
