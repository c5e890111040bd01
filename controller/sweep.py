"""A transducer's sweep as a lab measures it: a table of frequencies and responses, its figures and its picture."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controller.recording.run_folder import plain
from controller.recording.tables import ReplayError, read_columns
from controller.signals.transducer import Kind, Sweep, analyse
from drivers.core.messages import Floats

UNITS_HZ = (("mhz", 1e6), ("khz", 1e3), ("hz", 1.0))
"""Units in a column's name; the first that is in it counts."""

KHZ_BELOW = 1000.0
"""A sweep that ends below this number and does not name its unit is in kHz. Assumption: a transducer of ultrasound is
not swept below 1 kHz."""


class Measured(NamedTuple):
    """A sweep.

    Attributes:
        frequencies_hz: Shape (n,).
        response: Shape (n,).
        kind: Of the response.
        figures: What it shows.
        note: What was read.
    """

    frequencies_hz: Floats
    response: Floats
    kind: Kind
    figures: Sweep
    note: str


def read_sweep(path: Path, column: str | None, span_hz: tuple[float, float] | None, kind: Kind) -> Measured:
    """Read a table of two columns, frequency first.

    Args:
        path: As `read_columns` takes it.
        column: Names of the two, with a comma between them; None where there are but two.
        span_hz: Frequencies that count; None is all of them.

    Raises:
        ReplayError: no such table, nothing within the span, or too little for any figures.
    """
    chosen = read_columns(path, column, count=2)
    if chosen.values.shape[1] != 2:
        raise ReplayError(f"{path}: a sweep has two columns, frequency and response: --column F,A")
    frequencies_hz, response = chosen.values.T
    named = next((scale for unit, scale in UNITS_HZ if unit in chosen.name.lower()), None)
    scale = named or (1e3 if np.nanmax(frequencies_hz, initial=0.0) < KHZ_BELOW else 1.0)
    frequencies_hz = scale * frequencies_hz
    low_hz, high_hz = span_hz or (0.0, math.inf)
    inside = (frequencies_hz >= low_hz) & (frequencies_hz <= high_hz)
    if not inside.any():
        raise ReplayError(f"{path}: no frequency from {low_hz:g} to {high_hz:g} Hz")
    frequencies_hz, response = frequencies_hz[inside], response[inside]
    assumed = "" if named else f"; taken for {'kHz' if scale > 1.0 else 'Hz'}, as no name has a unit"
    first, last = 1e-3 * frequencies_hz[0], 1e-3 * frequencies_hz[-1]
    note = f"{path.name}: {len(response)} points, {first:g} to {last:g} kHz, {kind}{assumed}"
    try:
        return Measured(frequencies_hz, response, kind, analyse(frequencies_hz, response, kind), note)
    except ValueError as error:
        raise ReplayError(f"{path}: {error}") from None


def sweep_line(sweep: Sweep) -> Mapping[str, Any]:
    """The figures as one JSON object; None where the sweep does not hold them."""
    found: dict[str, Any] = plain(
        sweep._asdict() | {"resonances": [each._asdict() for each in sweep.resonances]}
    )
    return found


def draw_sweep(path: Path, measured: Measured) -> None:
    """Draw points, the believed model, the peak and the band within 6 dB.

    Raises:
        ReplayError: no such kind of picture, or it cannot be written.
    """
    from controller.replay_plot import save
    from controller.reports.figures import FAINT, INK, OURS, Figures
    from controller.signals.transducer import believed

    sweep = measured.figures
    with Figures(path.parent).figure(2.8) as drawing:
        axes = drawing.axes[0]
        dense_hz = np.linspace(measured.frequencies_hz[0], measured.frequencies_hz[-1], 1000)
        model = believed(sweep, measured.frequencies_hz, measured.response, measured.kind, dense_hz)
        count = "one resonance" if len(sweep.resonances) == 1 else "two resonances"
        axes.plot(1e-3 * dense_hz, model, color=OURS, label=count)
        axes.plot(1e-3 * measured.frequencies_hz, measured.response, "o", color=INK, label="measured")
        axes.axvline(1e-3 * sweep.peak_hz, color=FAINT, label=f"peak {1e-3 * sweep.peak_hz:.2f} kHz")
        if math.isfinite(sweep.low_hz + sweep.high_hz):
            ends = 1e-3 * sweep.low_hz, 1e-3 * sweep.high_hz
            axes.axvspan(*ends, color=FAINT, alpha=0.3, label="within 6 dB")
        axes.set(xlabel="frequency, kHz", ylabel=measured.kind)
        axes.set_ylim(bottom=0.0)
        axes.legend()
        save(drawing, path)
