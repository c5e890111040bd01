"""A picture of a replay: the signal, the detector's number with its threshold, and its events."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from behaviors.events import Detected
from controller.detectors.calibration import Statistic, StatisticCourse, courses_of
from controller.detectors.protocol import NOTHING, Detector
from controller.recording.series import extremes
from controller.recording.tables import ReplayError
from controller.replay import all_readings
from controller.reports.figures import FAINT, FALSE, INK, OURS, Drawing, Figures
from controller.scales import displayed, spaced
from drivers.core.messages import Floats, SampleBlock

if TYPE_CHECKING:
    from matplotlib.axes import Axes


FORMATS = (".png", ".svg", ".pdf")

POINTS = 4000
"""Most points of a curve: two for each of the dots in a row of the picture at 300 dpi."""

LARGEST = 1e300
"""Values beyond this are not drawn: axes around them end beyond the largest number."""

HEIGHT_IN = 1.9
"""Of each panel, inches."""


def draw(
    path: Path, blocks: Sequence[SampleBlock], detector: Detector, events: Sequence[Detected]
) -> Sequence[str]:
    """Draw a detector's input and its events.

    Args:
        path: Of the picture; its suffix is the format.
        detector: Its number is drawn where it has one (`Statistic`) and the recording is regular.

    Returns:
        A line for what could not be drawn, and why.

    Raises:
        ReplayError: no such kind of picture, it cannot be written, or values that are too large to be drawn.
    """
    notes = []
    named = {stream: [b for b in blocks if b.stream == stream] for stream in detector.inputs}
    courses: Sequence[StatisticCourse] = ()
    if isinstance(detector, Statistic) and named[detector.inputs[0]][0].rate_hz is not None:
        try:
            courses = courses_of(detector, blocks)
        except ValueError as error:
            notes.append(f"{path}: the statistic is drawn only where it was compared: {error}")
    shown = NOTHING if courses else all_readings(detector, blocks)
    panels = len(named) + bool(courses or len(shown))
    with Figures(path.parent).figure(HEIGHT_IN * panels, rows=panels, sharex=True) as drawing:
        for axes, (stream, own) in zip(drawing.axes, named.items(), strict=False):
            _signal(axes, stream, own)
        if courses or len(shown):
            axes = drawing.axes[-1]
            for course in courses:
                _line(axes, course.times_s, course.statistic, INK)
            if len(shown):
                _line(axes, shown[:, 0], shown[:, 1], INK)
            axes.set_ylabel(f"{detector.name}: statistic")
        thresholds = [*shown[::-1, 2], *(event.threshold for event in events)]
        threshold = next((each for each in thresholds if np.isfinite(each)), None)
        if threshold is not None:
            drawing.axes[-1].axhline(
                _drawable(threshold), color=FALSE, linestyle="--", label=f"threshold {threshold:.4g}"
            )
        _mark(drawing.axes, events)
        drawing.axes[-1].set_xlabel("time, s")
        handles, labels = drawing.axes[-1].get_legend_handles_labels()
        if handles:
            drawing.figure.legend(handles, labels, loc="outside upper right", ncols=4)
        save(drawing, path)
    return notes


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
    """A stream as it is shown elsewhere: one curve, however it was cut, with a break where samples were lost."""
    parts: list[list[SampleBlock]] = []
    for block in blocks:
        if parts and parts[-1][-1].seq + len(parts[-1][-1]) == block.seq:
            parts[-1].append(block)
        else:
            parts.append([block])
    unit = blocks[0].unit if blocks else ""
    for part in parts:
        times_s = np.concatenate([b.times for b in part])
        values = np.concatenate([b.physical for b in part])
        for channel in range(values.shape[1]):
            shown, unit = displayed(stream, values[:, channel], blocks[0].unit)
            _line(axes, times_s, shown, OURS if channel == 0 else FAINT)
    axes.set_ylabel(f"{stream}, {unit}" if unit else stream)


def _line(axes: Axes, times_s: Floats, values: Floats, colour: str) -> None:
    """A curve through the least and the largest sample of each dot; a break where values are not finite."""
    values = np.where(np.isfinite(values), values, np.nan)
    _drawable(float(np.fmax.reduce(np.abs(values), initial=0.0)))
    kept = extremes(values, POINTS)
    axes.plot(times_s[kept], values[kept], color=colour, linewidth=0.8)


def _drawable(value: float) -> float:
    """The value, where it can be drawn.

    Raises:
        ReplayError: it is too large.
    """
    if abs(value) > LARGEST:
        raise ReplayError(
            f"--plot: {value:.3g} is too large to be drawn; is it the right column, is the sensor alive?"
        )
    return value


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
        panels[-1].plot([], [], color=colour, linestyle=style, linewidth=0.8, label=spaced(kind))
