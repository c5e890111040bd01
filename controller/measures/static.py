"""A1: dominant frequency and amplitude at rest (Backus and Dollar, IV.A, Fig. 4)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.measures.transient import ONSET_N
from controller.measures.trial import Measured, TrialEvidence, spans_of
from controller.signals.spectrum import dominant_frequency
from drivers.core.messages import Floats

if TYPE_CHECKING:
    from behaviors.static import StaticSettings

HIGHLIGHTS = ("frequency_hz", "amplitude_m", "force_n")
"""Columns shown during a run."""

COLUMNS = {
    "frequency_hz": "dominant frequency of the acceleration",
    "frequency_sd_hz": "standard deviation of the frequency from period to period: large means erratic",
    "amplitude_m_s2": "root two times the standard deviation of the acceleration",
    "amplitude_m": "the same over the angular frequency squared: the accelerometer's motion",
    "force_n": "mean force",
    "force_peak_n": "peak force",
}


def measure(evidence: TrialEvidence, settings: StaticSettings, outcome: str) -> Measured:
    """Measure one static contact over the whole representative sample; `no_contact` where the load cell felt none."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    begun_s = evidence.entered_s.get("RECORDING")
    if begun_s is None:
        return outcome, row
    # The drive goes off, or the guard subscribes to the load cell while the probe retracts: not part of the sample.
    ended_s = min(evidence.entered_s.get(state, math.inf) for state in ("RINGING", "RETRACTING"))
    times_s, acceleration_m_s2 = evidence.series(settings.accelerometer_stream, begun_s, ended_s)
    if len(times_s) > 1:
        rate_hz = (len(times_s) - 1) / (times_s[-1] - times_s[0])
        frequency_hz = dominant_frequency(acceleration_m_s2, rate_hz)
        amplitude_m_s2 = math.sqrt(2.0) * float(np.std(acceleration_m_s2))
        row.update(
            frequency_hz=frequency_hz,
            amplitude_m_s2=amplitude_m_s2,
            amplitude_m=amplitude_m_s2 / (2.0 * math.pi * frequency_hz) ** 2,
        )
    _, periods_s = evidence.periods(settings.period_stream, begun_s, ended_s)
    if len(periods_s) > 1:
        row["frequency_sd_hz"] = float(np.std(1.0 / periods_s, ddof=1))
    force_n = tared(evidence, settings, begun_s, ended_s)
    if len(force_n):
        row.update(force_n=float(force_n.mean()), force_peak_n=float(force_n.max()))
        # light contact is lost in every period, and its mean is small
        pressed_n = {"full": abs(row["force_n"]), "light": row["force_peak_n"]}
        if outcome == "recorded" and pressed_n.get(evidence.factors["condition"], ONSET_N) < ONSET_N:
            outcome = "no_contact"
    return outcome, row


def tared(evidence: TrialEvidence, settings: StaticSettings, begun_s: float, ended_s: float) -> Floats:
    """Force of a span, N, less its mean before the probe was placed, shape (n,); none without a load cell."""
    stream, channel = settings.load_cell_stream, settings.load_cell_channel
    zero = spans_of(evidence.visits, "ZEROING")[-1]
    (_, at_rest_n), (_, force_n) = (
        evidence.series(stream, *span, channel) for span in (zero, (begun_s, ended_s))
    )
    return force_n - at_rest_n.mean() if len(at_rest_n) else force_n
