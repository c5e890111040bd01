"""The part of the page on B6: gain, hysteresis and resolution of the fingertip's bridges, beside the paper's Fig. 6."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from controller.measures.ladder import DETECTED_SIGMA, BridgeCalibration, Estimate, Step, calibrate, steps_of
from controller.reports.fernandez import BRIDGES, CITATION, PrintedFigure
from controller.reports.figures import FAINT, FALSE, GOOD, OURS, PAPER, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Block, Figure, Kind, Result, Section
from controller.reports.section_texts import SectionTexts
from controller.reports.text import number, quantity
from controller.scales import scale_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from controller.recording.reader import Run
    from controller.recording.series import TrialRecording

TEXTS = SectionTexts("weights")


@dataclass(frozen=True, slots=True)
class Bridge:
    """One bridge: every trial's steps and their pooled calibration."""

    name: str
    trials: Sequence[Sequence[Step]]
    calibration: BridgeCalibration


def read_bridges(runs: Sequence[Run]) -> list[Bridge]:
    """The bridges that were calibrated, from x to t; trials of one bridge are pooled."""
    found: dict[str, list[list[Step]]] = {}
    uncertainty = 0.0
    for run in runs:
        uncertainty = max(uncertainty, float(setting_of(run, "behavior", "weight_uncertainty") or 0.0))
        for row in run.trials:
            trial, name = int(row["trial"] or 0), str(row.get("bridge"))
            if name in BRIDGES and run.succeeded(row):
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
    body: list[Block] = [TEXTS.text("intro", tops=_tops(bridges))]
    if bridges:
        body.append(TEXTS.table("ladders", [row for bridge in bridges for row in _rows(bridge)]))
        body.append(Figure(Markup(_draw(figures, bridges)), TEXTS.sentence("figure_6")))
    else:
        body.append(TEXTS.text("nothing", trials=sum(len(run.trials) for run in runs)))
    rest = [TEXTS.sentence("detected", sigma=DETECTED_SIGMA), *map(_note, bridges)]
    uncertainties = sorted({float(setting_of(run, "behavior", "weight_uncertainty") or 0.0) for run in runs})
    known = " and ".join(f"{100.0 * value:g} %" for value in uncertainties)
    ours = [TEXTS.sentence("ours"), TEXTS.sentence("weights", shown=known)]
    return Section(
        title="Calibration with weights (B6)",
        body=[*body, TEXTS.notes("notes", rest)],
        citation=CITATION,
        summary=[_sentence(bridge, simulated) for bridge in bridges],
        not_the_papers=[*ours, TEXTS.sentence("simulated")] if simulated else ours,
    )


def _tops(bridges: Sequence[Bridge]) -> str:
    tops = [(bridge.calibration.top_n, BRIDGES[bridge.name]) for bridge in bridges]
    ranges = [f"{top_n:g} N on {paper.force} (the paper {paper.top_n:g} N)" for top_n, paper in tops]
    return " and ".join(ranges) or "the ladder's top"


def _estimates(bridge: Bridge) -> Sequence[tuple[Estimate, PrintedFigure, float, int]]:
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
    text = f"{paper.force}: gain {number(abs(off), 1)} % {'below' if off < 0.0 else 'above'} the paper's "
    text += (
        f"{quantity('gain_v_n', paper.gain_v_n.value, 4)}, {quantity('gain_v_n', gain.value, 4)}; {verdict}."
    )
    return Result(Kind.FITTED if simulated else Kind.MEASURED, text, not missed)


def _rows(bridge: Bridge) -> Iterator[Mapping[str, Any]]:
    names = (
        scale_of("gain_v_n").heading,
        "hysteresis, % of full scale",
        f"resolution ({DETECTED_SIGMA:g} σ), {scale_of('resolution_n').unit}",
    )
    for name, (estimate, printed, scale, digits) in zip(names, _estimates(bridge), strict=True):
        yield {
            "bridge": BRIDGES[bridge.name].force,
            "what": name,
            "ours": number(estimate.value, digits, scale),
            "interval": f"{number(estimate.low, digits, scale)} to {number(estimate.high, digits, scale)}",
            "paper": f"{printed.value * scale:.6g}",
            "agrees": "yes" if printed.meets(estimate.low, estimate.high) else "no",
        }


def _note(bridge: Bridge) -> str:
    found = bridge.calibration
    return TEXTS.sentence(
        "bridge",
        force=BRIDGES[bridge.name].force,
        cycles=found.cycles,
        steps=found.steps,
        top_n=found.top_n,
        repeat=number(100.0 * found.repeat_v_n / found.gain_v_n.value, 3),
        nonlinearity=number(100.0 * found.nonlinearity, 1),
        zero=quantity("zero_v", found.zero_v, 5),
        remanence=number(100.0 * found.remanence, 1),
    )


# --- figures -----------------------------------------------------------------------------------------


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
