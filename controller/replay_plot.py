"""A picture of a replay: the signal, the detector's number with its threshold, and what it said."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Detected
from controller.detectors.calibration import Statistic, StatisticCourse, courses_of
from controller.detectors.protocol import Detector
from controller.replay import ReplayError
from controller.reports.figures import FAINT, FALSE, INK, OURS, Drawing, Figures
from drivers.messages import SampleBlock

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

FORMATS = (".png", ".svg", ".pdf")

COLUMNS = 2000
"""Points in a row of the picture: as many as it has dots at 300 dpi. What is denser is drawn from least to largest."""

HEIGHT_IN = 1.9
"""Of each panel, inches."""


def draw(path: Path, blocks: Sequence[SampleBlock], detector: Detector, events: Sequence[Detected]) -> None:
    """Draw what a detector heard and said.

    Args:
        path: Of the picture; its end says the kind.
        blocks: What was heard, all streams.
        detector: Who heard it. Its number is drawn where it has one (`Statistic`) and the recording is regular.
        events: What it said.

    Raises:
        ReplayError: no such kind of picture, or it cannot be written.
    """
    named = {stream: [b for b in blocks if b.stream == stream] for stream in detector.inputs}
    courses: Sequence[StatisticCourse] = ()
    if isinstance(detector, Statistic) and named[detector.inputs[0]][0].rate_hz is not None:
        courses = courses_of(detector, blocks)
    panels = len(named) + bool(courses)
    with Figures(path.parent, simulated=False).figure(
        HEIGHT_IN * panels, rows=panels, sharex=True
    ) as drawing:
        for axes, (stream, heard) in zip(drawing.axes, named.items(), strict=False):
            _signal(axes, stream, heard)
        if courses:
            axes = drawing.axes[-1]
            for course in courses:
                _line(axes, course.times_s, course.statistic, INK)
            axes.set_ylabel(f"{detector.name}: statistic")
        threshold = next((event.threshold for event in events if np.isfinite(event.threshold)), None)
        if threshold is not None:
            drawing.axes[-1].axhline(
                threshold, color=FALSE, linestyle="--", label=f"threshold {threshold:.4g}"
            )
        _mark(drawing.axes, events)
        drawing.axes[-1].set_xlabel("time, s")
        handles, labels = drawing.axes[-1].get_legend_handles_labels()
        if handles:
            drawing.figure.legend(handles, labels, loc="outside upper right", ncols=4)
        save(drawing, path)


def save(drawing: Drawing, path: Path) -> None:
    """Write a picture where the command line asks for it.

    Raises:
        ReplayError: no such kind of picture, or it cannot be written.
    """
    if path.suffix.lower() not in FORMATS:
        raise ReplayError(f"{path}: '{path.suffix}' is no picture; give a file of {', '.join(FORMATS)}")
    try:
        drawing.figure.savefig(path, dpi=150)
    except OSError as error:
        raise ReplayError(f"{path}: cannot be written: {error.strerror or error}") from None


def _signal(axes: Axes, stream: str, blocks: Sequence[SampleBlock]) -> None:
    for block in blocks:
        for channel in range(block.values.shape[1]):
            _line(axes, block.times, block.physical[:, channel], OURS if channel == 0 else FAINT)
    unit = blocks[0].unit if blocks else ""
    axes.set_ylabel(f"{stream}, {unit}" if unit else stream)


def _line(axes: Axes, times_s: Floats, values: Floats, colour: str) -> None:
    """A curve; where it has many samples to a dot, the band that it fills."""
    if len(values) <= 2 * COLUMNS:
        axes.plot(times_s, values, color=colour, linewidth=0.8)
        return
    edges = np.linspace(0, len(values), COLUMNS + 1).astype(int)[:-1]
    with np.errstate(invalid="ignore"):
        low, high = np.fmin.reduceat(values, edges), np.fmax.reduceat(values, edges)
    axes.fill_between(times_s[edges], low, high, color=colour, linewidth=0.5)


def _mark(panels: Sequence[Axes], events: Sequence[Detected]) -> None:
    """A line through all panels for each event, one colour and style a kind."""
    styles = ((OURS, "-"), (INK, ":"), (FALSE, "-."), (FAINT, "-"))
    kinds = list(dict.fromkeys(type(event).__name__ for event in events))
    for event in events:
        place = kinds.index(type(event).__name__)
        colour, style = styles[place % len(styles)]
        for axes in panels:
            axes.axvline(event.t_s, color=colour, linestyle=style, linewidth=0.8)
    for place, kind in enumerate(kinds):
        colour, style = styles[place % len(styles)]
        panels[-1].plot([], [], color=colour, linestyle=style, linewidth=0.8, label=kind)
