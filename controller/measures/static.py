"""A1: dominant frequency and amplitude at rest (Backus and Dollar, IV.A, Fig. 4)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.measures import Column
from controller.measures.trial import Measured, TrialEvidence
from controller.signals.spectrum import dominant_frequency

if TYPE_CHECKING:
    from behaviors.static import StaticSettings

HIGHLIGHTS = ("frequency_hz", "amplitude_m", "force_n")
"""Columns shown during a run."""

COLUMNS = {
    "frequency_hz": Column("dominant frequency of the acceleration", 2),
    "frequency_sd_hz": Column(
        "standard deviation of the frequency from period to period: large means erratic", 2
    ),
    "amplitude_m_s2": Column("root two times the standard deviation of the acceleration", 2),
    "amplitude_m": Column("the same over the angular frequency squared: the accelerometer's motion", 3),
    "force_n": Column("mean force", 3),
    "force_peak_n": Column("peak force", 3),
}


def measure(evidence: TrialEvidence, settings: StaticSettings, outcome: str) -> Measured:
    """Measure one static contact over the whole representative sample."""
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
    _, force_n = evidence.series(settings.load_cell_stream, begun_s, ended_s)
    if len(force_n):
        row.update(force_n=float(force_n.mean()), force_peak_n=float(force_n.max()))
    return outcome, row
