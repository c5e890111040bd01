"""The part of the page on B6: gain, hysteresis and resolution of the fingertip's bridges, beside the paper's Fig. 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from controller.measures.ladder import DETECTED_SIGMA, Calibration, Estimate, Step, calibrate, steps_of
from controller.reports.fernandez import BRIDGES, CITATION, Printed
from controller.reports.figures import FAINT, FALSE, GOOD, OURS, PAPER, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Kind, Result, Section
from controller.reports.text import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from controller.recording.reader import Run
    from controller.recording.series import TrialRecording

_SIMULATED = (
    "Gain, hysteresis and noise of the simulated bridges were set from the figures that the paper prints. "
    "That they come back says that ladder, recording and statistics are right; it says nothing about the "
    "paper's sensor."
)


@dataclass(frozen=True, slots=True)
class Bridge:
    """One bridge: every trial's steps, and what they tell together."""

    name: str
    trials: Sequence[Sequence[Step]]
    calibration: Calibration


def read_bridges(runs: Sequence[Run]) -> list[Bridge]:
    """The bridges that were calibrated, from x to t; trials of one bridge are pooled."""
    found: dict[str, list[list[Step]]] = {}
    uncertainty = 0.0
    for run in runs:
        uncertainty = max(uncertainty, float(setting_of(run, "behavior", "weight_uncertainty") or 0.0))
        for row in run.trials:
            trial, name = int(row["trial"] or 0), str(row.get("bridge"))
            if name in BRIDGES and row.get("outcome") == "contact":
                recording = run.readable(trial)
                if recording is not None:
                    found.setdefault(name, []).append(_steps(run, recording, name))
    bridges = []
    for name in BRIDGES:
        calibration = calibrate(found.get(name, ()), uncertainty)
        if calibration is not None:
            bridges.append(Bridge(name, found[name], calibration))
    return bridges


def _steps(run: Run, recording: TrialRecording, bridge: str) -> list[Step]:
    return steps_of(
        recording,
        load_stream=str(setting_of(run, "behavior", "load_stream")),
        bridges_stream=str(setting_of(run, "behavior", "bridges_stream")),
        bridge=bridge,
        preloads=int(setting_of(run, "behavior", "preloads") or 0),
    )


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and figures of all calibrations of some runs on one kind of bench."""
    bridges = read_bridges(runs)
    simulated = all(run.simulated for run in runs)
    told = sum(len(run.trials) for run in runs)
    paragraphs = [
        f"Known weights hang on one bridge at a time, up to {_tops(bridges)} and down again. Each "
        "voltage is the mean of a load that hung still, less that of the empty bridge before the first "
        "load; the line goes through zero and, by least squares, through the means over all cycles of "
        "each load and direction."
    ]
    if not bridges:
        paragraphs.append(f"No bridge was calibrated to the end ({told} trials began).")
    return Section(
        title="Calibration with weights (B6)",
        template="plain.html.j2",
        citation=CITATION,
        summary=[_sentence(bridge, simulated) for bridge in bridges],
        not_the_papers=_not_the_papers(runs, simulated),
        context={
            "paragraphs": paragraphs,
            "tables": [_table(bridges)] if bridges else [],
            "figures": _drawn(figures, bridges) if bridges else [],
            "notes": _notes(bridges),
        },
    )


def _tops(bridges: Sequence[Bridge]) -> str:
    tops = [(bridge.calibration.top_n, BRIDGES[bridge.name]) for bridge in bridges]
    said = [f"{top_n:g} N on {paper.force} (the paper {paper.top_n:g} N)" for top_n, paper in tops]
    return " and ".join(said) or "the ladder's top"


def _estimates(bridge: Bridge) -> Sequence[tuple[Estimate, Printed, float, int]]:
    """Ours, the paper's, the scale that both are shown with, and decimals."""
    ours, paper = bridge.calibration, BRIDGES[bridge.name]
    return (
        (ours.gain_v_n, paper.gain_v_n, 1.0, 4),
        (ours.hysteresis, paper.hysteresis, 100.0, 2),
        (ours.resolution_n, paper.resolution_n, 1.0, 4),
    )


def _sentence(bridge: Bridge, simulated: bool) -> Result:
    gain, paper = bridge.calibration.gain_v_n, BRIDGES[bridge.name]
    held = [printed.meets(estimate.low, estimate.high) for estimate, printed, _, _ in _estimates(bridge)]
    missed = [name for name, good in zip(("gain", "hysteresis", "resolution"), held, strict=True) if not good]
    verdict = (
        "the paper's gain, hysteresis and resolution agree with our 95 % intervals"
        if not missed
        else f"the paper's {' and '.join(missed)} {'lies' if len(missed) == 1 else 'lie'} outside our 95 % interval"
        f"{'' if len(missed) == 1 else 's'}"
    )
    off = 100.0 * (gain.value / paper.gain_v_n.value - 1.0)
    said = f"{paper.force}: gain {number(abs(off), 1)} % {'below' if off < 0.0 else 'above'} the paper's "
    said += f"{paper.gain_v_n.value:.4f} V/N, {number(gain.value, 4)} V/N; {verdict}."
    return Result(Kind.FITTED if simulated else Kind.MEASURED, said, not missed)


def _table(bridges: Sequence[Bridge]) -> Mapping[str, Any]:
    rows = []
    for bridge in bridges:
        paper = BRIDGES[bridge.name]
        names = ("gain, V/N", "hysteresis, % of full scale", f"resolution ({DETECTED_SIGMA:g} σ), N")
        for name, (estimate, printed, scale, digits) in zip(names, _estimates(bridge), strict=True):
            interval = f"{number(estimate.low, digits, scale)} to {number(estimate.high, digits, scale)}"
            met = "yes" if printed.meets(estimate.low, estimate.high) else "no"
            rows.append(
                [
                    paper.force,
                    name,
                    number(estimate.value, digits, scale),
                    interval,
                    f"{printed.value * scale:.6g}",
                    met,
                ]
            )
    return {
        "caption": "What the ladders tell of each bridge, with 95 % intervals, beside what the paper prints.",
        "head": ["bridge", "", "ours", "95 % interval", "paper", "agrees"],
        "rows": rows,
        "left": 2,
    }


def _notes(bridges: Sequence[Bridge]) -> list[str]:
    notes = [
        "The interval of the gain holds the residuals about the line, which are the loop's own far more "
        "than noise, and the weights' uncertainty; those of hysteresis and resolution hold the gain's. "
        "Hysteresis is the largest difference between unloading and loading at one of the ladder's loads, "
        "so that a coarser ladder would find less.",
        "The empty bridge is taken before the preloads, as a balanced amplifier would; taken after them, "
        "what a loop leaves behind would tilt every line.",
        "A printed figure stands for everything that is rounded to it: ours agrees where its interval "
        "holds such a value. The resolutions are printed to one or two digits, the hysteresis of Fx and "
        "Ft to one.",
        "The paper calls resolution the smallest change detected and does not say what counts as "
        f"detected; here it is {DETECTED_SIGMA:g} standard deviations of one sample.",
    ]
    for bridge in bridges:
        found, paper = bridge.calibration, BRIDGES[bridge.name]
        notes.append(
            f"{paper.force}: {found.cycles} cycles, {found.steps} loads up to {found.top_n:g} N; gain from "
            f"cycle to cycle {number(100.0 * found.repeat_v_n / found.gain_v_n.value, 3)} % (standard "
            f"deviation); middle of the loop off the line by up to {number(100.0 * found.nonlinearity, 1)} "
            f"% of full scale; empty bridge at {number(1000.0 * found.zero_v, 2)} mV before the first "
            f"load, {number(100.0 * found.remanence, 1)} % of full scale above that after a cycle."
        )
    return notes


def _not_the_papers(runs: Sequence[Run], simulated: bool) -> list[str]:
    said = [
        "The steps of the ladders, the number of cycles and the preloads (ISO 376 asks for three) are "
        "ours; the paper prints ranges and “several experiments”.",
    ]
    uncertainties = sorted({float(setting_of(run, "behavior", "weight_uncertainty") or 0.0) for run in runs})
    shown = " and ".join(f"{100.0 * value:g} %" for value in uncertainties)
    said.append(
        f"The weights are taken to be known to {shown} (standard uncertainty, common to all): an assumption."
    )
    return [*said, _SIMULATED] if simulated else said


# --- figures -----------------------------------------------------------------------------------------


def _drawn(figures: Figures, bridges: Sequence[Bridge]) -> list[Mapping[str, Any]]:
    return [
        {
            "svg": Markup(_draw(figures, bridges)),
            "caption": "Fig. 6. Above: voltage against load; a vertical bar spans all voltages that a "
            "load gave, loading and unloading, in all cycles; the line is the fit through zero, dashed is "
            "the paper's. Below, which the paper does not draw: the departure from our line, in % of full "
            "scale, loading and unloading.",
        }
    ]


def _draw(figures: Figures, bridges: Sequence[Bridge]) -> str:
    with figures.figure(4.1, rows=2, columns=len(bridges), sharex="col", height_ratios=[1.7, 1.0]) as drawing:
        for column, bridge in enumerate(bridges):
            above, below = drawing.axes[column], drawing.axes[len(bridges) + column]
            _draw_line(above, bridge)
            _draw_loop(below, bridge)
            below.set_xlabel(f"force {BRIDGES[bridge.name].force} (N)")
            if column == 0:
                below.set_ylabel("departure (% FS)")
                above.legend(loc="upper left", bbox_to_anchor=(0.0, 0.98))
                below.legend(
                    loc="lower right", ncols=2, columnspacing=1.0, handlelength=1.2, borderaxespad=0.1
                )
        return drawing.save("fig_6_calibration")


def _draw_line(axes: Axes, bridge: Bridge) -> None:
    found, paper = bridge.calibration, BRIDGES[bridge.name]
    volts: dict[float, list[float]] = {}
    for step, volt in _points(bridge):
        volts.setdefault(step.load_n, []).append(volt)
    for index, (load_n, values) in enumerate(sorted(volts.items())):
        axes.plot(
            [load_n, load_n],
            [min(values), max(values)],
            color=OURS,
            lw=2.2,
            solid_capstyle="butt",
            label="data" if index == 0 else None,
        )
    ends_n = np.array([0.0, found.top_n])
    axes.plot(ends_n, found.gain_v_n.value * ends_n, color=OURS, lw=0.9, label="fitted line")
    axes.plot(ends_n, paper.gain_v_n.value * ends_n, color=PAPER, lw=0.9, ls=(0, (4, 3)), label="paper")
    half = (found.gain_v_n.high - found.gain_v_n.low) / 2.0
    axes.set_title(f"$V_{{g{paper.gauges}}}$ = ({found.gain_v_n.value:.4f} ± {half:.4f}) {paper.force}")
    axes.set_ylabel(f"voltage $V_{{g{paper.gauges}}}$ (V)")
    axes.set_xlim(0.0, 1.04 * found.top_n)
    axes.set_ylim(bottom=0.0)


def _draw_loop(axes: Axes, bridge: Bridge) -> None:
    found = bridge.calibration
    full_v = found.gain_v_n.value * found.top_n
    axes.axhline(0.0, color=FAINT, lw=0.7, zorder=0)
    for going, color, marker, label in (("up", GOOD, "^", "loading"), ("down", FALSE, "v", "unloading")):
        own: dict[float, list[float]] = {}
        for step, volt in _points(bridge):
            if step.going == going or step.load_n == found.top_n:
                own.setdefault(step.load_n, []).append(volt - found.gain_v_n.value * step.load_n)
        loads_n = sorted(own)
        means = [100.0 * float(np.mean(own[load_n])) / full_v for load_n in loads_n]
        axes.plot(loads_n, means, color=color, marker=marker, ms=3.2, lw=0.8, label=label)
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.35 * (high - low), high)


def _points(bridge: Bridge) -> list[tuple[Step, float]]:
    """Every load of every cycle with its voltage less the empty bridge's."""
    return [
        (step, step.mean_v - steps[0].mean_v)
        for steps in bridge.trials
        for step in steps[1:]
        if step.cycle >= 0 and step.load_n > 0.0
    ]
