"""A6, A4b: frequency and phase of the driven finger, and its own frequency after (Backus and Dollar, II, V.A, V.C)."""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING

import numpy as np

from controller.measures import static
from controller.measures.transient import ONSET_N
from controller.measures.trial import Measured, TrialEvidence
from drivers.core.messages import Floats

if TYPE_CHECKING:
    from behaviors.stiffness import StiffnessSettings

HIGHLIGHTS = ("frequency_hz", "ring_hz", "force_n")
"""Columns shown during a run."""

COLUMNS = {
    **static.COLUMNS,
    "touching": "share of the recording in which the force is above 0.005 N: 1 in full contact",
    "ring_hz": "frequency of the ringing after the drive went off, free or in full contact",
    "phase_rad": "phase of the distal accelerometer before the proximal one, 0 to a full turn",
}

RING_S = (0.01, 0.3)
"""Span after the drive went off from which the ringing is read. Assumption: the command has arrived, and noise does not
yet stand above what is left."""

BAND_HZ = (20.0, 300.0)
"""Where the ringing is sought: above the proximal link's own swing, below the board's half rate."""


def measure(evidence: TrialEvidence, settings: StiffnessSettings, outcome: str) -> Measured:
    """Measure one contact as A1 does, and what is to be known of stiffness and location.

    Returns:
        As `measures.static`, with more columns; `ring_hz` is empty where the probe bounces, for nothing rings at one
        frequency there, `phase_rad` where there is no second accelerometer.
    """
    outcome, row = static.measure(evidence, settings, outcome)
    row |= dict.fromkeys(name for name in COLUMNS if name not in row)
    begun_s, off_s = evidence.entered_s.get("RECORDING"), evidence.entered_s.get("RINGING")
    if begun_s is None or off_s is None:
        return outcome, row
    times_s, near = evidence.series(settings.accelerometer_stream, begun_s, off_s)
    _, far = evidence.series(settings.distal_stream, begun_s, off_s)
    if len(near) and len(near) == len(far):
        turned = phasor(times_s, far, row["frequency_hz"]) / phasor(times_s, near, row["frequency_hz"])
        row["phase_rad"] = cmath.phase(turned) % (2.0 * math.pi)
    force_n = static.tared(evidence, settings, begun_s, off_s)
    if len(force_n):
        row["touching"] = float((force_n > ONSET_N).mean())
    if row["touching"] in (0.0, 1.0):
        stream, channel = settings.accelerometer_stream, 0
        if row["touching"]:
            stream, channel = str(settings.load_cell_stream), settings.load_cell_channel
        rung_s, rings = evidence.series(stream, off_s + RING_S[0], off_s + RING_S[1], channel)
        if len(rings) > 50:
            row["ring_hz"] = ringing(rings, (len(rings) - 1) / (rung_s[-1] - rung_s[0]))
    return outcome, row


def phasor(times_s: Floats, x: Floats, at_hz: float) -> complex:
    """Amplitude and phase of a record at a frequency, under a Hann window, in the record's unit."""
    window = np.hanning(len(x))
    turns = np.exp(-2j * np.pi * at_hz * (times_s - times_s[0]))
    return complex(2.0 * np.sum(window * (x - x.mean()) * turns) / window.sum())


def ringing(x: Floats, rate_hz: float) -> float | None:
    """Frequency of the strongest decaying oscillation of a record within `BAND_HZ`, Hz; None without one.

    Two oscillations and a constant are taken out of it by the matrix pencil (Y. Hua and T. K. Sarkar, IEEE Trans.
    Acoust., Speech, Signal Process. 38, 1990): a spectrum cannot tell two that decay within their own few periods.
    """
    order, length = 5, len(x) // 3
    rows = np.lib.stride_tricks.sliding_window_view(x, length)
    _, sizes, vectors = np.linalg.svd(rows, full_matrices=False)
    # what is beyond the record's rank is rounding, and rings anywhere
    rank = int(np.sum(sizes > sizes[0] * len(x) * np.finfo(float).eps))
    basis = vectors[: min(order, rank)].T
    poles = np.linalg.eigvals(np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0])
    powers = poles[None, :] ** np.arange(len(x))[:, None]
    sizes = np.abs(np.linalg.lstsq(powers, x.astype(complex), rcond=None)[0])
    at_hz = np.angle(poles) * rate_hz / (2.0 * np.pi)
    found = [(size, hz) for size, hz in zip(sizes, at_hz, strict=True) if BAND_HZ[0] < hz < BAND_HZ[1]]
    return float(max(found)[1]) if found else None
