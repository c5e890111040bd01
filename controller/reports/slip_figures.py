"""The figures of B8: Fig. 8 to 11, 13, 15, 17 and 19 of the paper on slip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from controller.measures.slip import BLOCK_S, PaperBlocks, paper_blocks
from controller.recording.reader import Run
from controller.recording.series import Series
from controller.reports.counts import Row
from controller.reports.figures import FAINT, FALSE, GOOD, INK, OURS, PAPER, Figures
from controller.reports.run_account import setting_of
from controller.reports.slip_scores import drawn_in

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]


def draw_run(figures: Figures, run: Run, row: Row, sensor: str) -> str:
    """One trial: the signal (forces and angle of a fingertip), peak and frequency of each block, their product; ""
    where it was not recorded."""
    settings = setting_of(run, "behavior", "sensors", sensor) or {}
    recording = run.readable(int(row["trial"]))
    if recording is None:
        return ""
    stream, channel = str(settings.get("stream")), settings.get("channel")
    zero_s = float(row.get("clock_s") or 0.0)
    # Lifting off shakes the tip as nothing else does: it is not part of the paper's runs.
    own = [event for event in run.events if event.get("trial") == row["trial"]]
    lifted_s = next((float(event["t_s"]) for event in own if event.get("next") == "LIFTING"), np.inf)
    series = recording.stream(stream).between(zero_s, lifted_s)
    if len(series) < 2:
        return ""
    forces = recording.stream(str(settings.get("forces_stream") or "")).between(zero_s, lifted_s)
    blocks = paper_blocks(recording.blocks(stream), channel, row.get("listen_s"))
    shown = (blocks.begin_s >= zero_s) & (blocks.end_s < lifted_s)
    blocks = PaperBlocks(*(column[shown] for column in blocks))
    unit, factor = drawn_in(sensor, series.unit)
    panels = 5 if len(forces) else 4
    with figures.figure(1.15 * panels + 0.6, rows=panels, sharex=True) as drawing:
        axes = drawing.axes
        if len(forces):
            _draw_forces(axes[0], axes[1], forces, zero_s)
        else:  # the channel that slip is looked for in; of many the one that is loaded most
            column = int(np.argmax(series.values.mean(axis=0))) if channel is None else channel
            axes[0].plot(series.times_s - zero_s, factor * series.values[:, column], color=OURS, lw=0.6)
            axes[0].set_ylabel(f"signal ({unit})")
        products = factor**2 * blocks.product
        for panel, values, label in (
            (axes[-3], factor**2 * blocks.power, f"peak ({unit}²)"),
            (axes[-2], blocks.frequency_hz, "frequency (Hz)"),
            (axes[-1], products, f"product ({unit}² Hz)"),
        ):
            panel.step(*_broken(blocks, values, zero_s), where="pre", color=OURS, lw=0.8)
            panel.set_ylabel(label)
        threshold = setting_of(run, "detectors", str(settings.get("paper")), "threshold")
        if isinstance(threshold, int | float):
            axes[-1].axhline(factor**2 * threshold, color=FALSE, lw=0.8, ls=(0, (4, 2)))
        top = 1.1 * float(np.nanmax(products, initial=0.0))
        looks: Mapping[Any, Any] = {
            settings.get("ours"): {"marker": "o", "mfc": "none", "color": GOOD},
            settings.get("paper"): {"marker": "x", "color": FALSE},
        }
        for event in own:
            if event.get("event") == "SlipStarted" and event.get("detector") in looks:
                look = looks[event["detector"]]
                axes[-1].plot(float(event["t_s"]) - zero_s, top, ms=4.0, ls="none", clip_on=False, **look)
        for panel in axes:
            if row.get("slip_s") is not None and row.get("slip_end_s") is not None:
                slip = row["slip_s"] - zero_s, row["slip_end_s"] - zero_s
                panel.axvspan(*slip, color=FAINT, alpha=0.35, lw=0)
            panel.set_xlim(left=max(0.0, float(series.times_s[0]) - zero_s))
        axes[-1].set_xlabel("time (s)")
        drawing.figure.align_ylabels()
        return drawing.save(f"slip_{sensor}")


def draw_fingertip_spectra(figures: Figures, run: Run, row: Row) -> str:
    """Fig. 9: the spectrum of one block of Ft before contact, while it rolls, while it slips and at rest after it; ""
    where it was not recorded."""
    settings = setting_of(run, "behavior", "sensors", "fingertip") or {}
    recording = run.readable(int(row["trial"]))
    slip_s, end_s, touch_s = row.get("slip_s"), row.get("slip_end_s"), row.get("touch_s")
    if recording is None or slip_s is None or end_s is None or touch_s is None:
        return ""
    series = recording.stream(str(settings.get("stream")))
    if len(series) < 2:
        return ""
    rate_hz = 1.0 / float(np.median(np.diff(series.times_s)))
    size = round(BLOCK_S * rate_hz)
    instants = {
        "before contact": touch_s - 0.3,
        "rolling": 0.5 * (touch_s + slip_s),
        "slipping": 0.5 * (slip_s + end_s),
        "at rest": end_s + 1.0,
    }
    with figures.panels(4, 2, 1.55, sharex=True) as drawing:
        for axes, (name, at_s) in zip(drawing.axes, instants.items(), strict=True):
            first = int(np.searchsorted(series.times_s, at_s))
            block = series.values[first : first + size, int(settings.get("channel") or 0)]
            if len(block) < size:
                continue
            power = np.abs(np.fft.rfft(block)[1:]) ** 2 / size
            axes.vlines(np.arange(1, len(power) + 1) * rate_hz / size, 0.0, power, color=OURS, lw=1.4)
            axes.set_ylim(bottom=0.0)
            axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
            axes.set_title(f"{name}, t = {at_s - float(row.get('clock_s') or 0.0):.1f} s")
        drawing.label_outside("frequency (Hz)", f"power ({series.unit}²)")
        return drawing.save("fig_9_spectra")


def _broken(blocks: PaperBlocks, values: Floats, zero_s: float) -> tuple[Floats, Floats]:
    """Ends of blocks and values, with a NaN at the beginning of each block that does not follow on the one before."""
    # half a block is longer than rounding and shorter than any gap that makes a new block matter
    half_s = 0.5 * (blocks.end_s - blocks.begin_s)[1:]
    apart = np.flatnonzero(blocks.begin_s[1:] - blocks.end_s[:-1] > half_s) + 1
    return np.insert(blocks.end_s, apart, blocks.begin_s[apart]) - zero_s, np.insert(values, apart, np.nan)


def _draw_forces(forces: Axes, angle: Axes, series: Series, zero_s: float) -> None:
    """Fig. 8a and 11: Fx, Fy, Ft, and below Fn with theta."""
    times_s = series.times_s - zero_s
    looks = (("Fx", PAPER), ("Fy", FAINT), ("Ft", OURS))
    for column, (name, color) in zip(series.values[:, :3].T, looks, strict=True):
        forces.plot(times_s, column, color=color, lw=0.8, label=name)
    forces.set_ylabel("force (N)")
    forces.legend(ncols=3, loc="upper right")
    angle.plot(times_s, series.values[:, 3], color=INK, lw=0.8, label="Fn")
    angle.set_ylabel("Fn (N)")
    pressed = series.values[:, 3] > 0.5
    theta = np.where(pressed, np.degrees(series.values[:, 4]), np.nan)
    other = angle.twinx()
    other.plot(times_s, theta, color=GOOD, lw=0.8)
    other.set_ylabel("θ (°)", color=GOOD)
    other.spines["right"].set_visible(True)
