"""C1: transmission of each frequency of a sweep (Rupavatharam et al., III.A.2)."""

from typing import Any

import numpy as np

from behaviors.chirp import ChirpSettings
from controller.measures.trial import Measured, TrialEvidence
from controller.signals.transducer import peak
from drivers.core.messages import Floats

STEP_HZ = 250.0
"""Width of the bands in which the sweep is averaged: a hundred in a sweep of 26 kHz, each well above a millisecond."""

ECHO_DB = 3.0
"""How far the best band must be above the silence to be an echo. Assumption: the strongest of a hundred bands of noise
alone is some 0.3 dB above its mean."""

LATENCY_UNSURE_S = 0.001
"""Error of the latency that a device reports, s. Assumption: converters' filters, which it does not include, take some
0.4 ms each."""

HIGHLIGHTS = ("best_hz", "unsure_hz", "over_noise_db")
"""Columns shown during a run."""

COLUMNS = {
    "best_hz": "frequency of the largest echo of both fingers, their powers added",
    "best_right_hz": "the right finger's own",
    "best_left_hz": "the left finger's own",
    "band_low_hz": "lower end of the band around it with at least half the power",
    "band_high_hz": "its upper end",
    "unsure_hz": "error of these: half a band, and the latency's",
    "over_noise_db": "the best band's power over that of the silence before",
}


def measure(evidence: TrialEvidence, settings: ChirpSettings, outcome: str) -> Measured:
    """Measure one sweep.

    Returns:
        The outcome, `no_echo` where nothing came back, and the columns: all empty if the sweep was not completed, all
        but `over_noise_db` without an echo.
    """
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    ended_s, asked_s = evidence.entered_s.get("RINGING"), evidence.entered_s.get("SWEEPING")
    if ended_s is None or asked_s is None:
        return outcome, row
    begun_s = beginning(ended_s, settings)
    # a sweep that was paused and begun again is not silence
    silent_s = evidence.entered_s.get("SILENT", -np.inf)
    series = evidence.covered(settings.fingers_stream, min(silent_s, begun_s), ended_s)
    frequencies_hz, power = transfer(series.times_s - begun_s, series.values, settings)
    if not len(frequencies_hz):
        return outcome, row
    together = power.sum(axis=1)
    order = np.argsort(frequencies_hz)
    best = int(np.argmax(together))
    best_hz, low_hz, high_hz = peak(frequencies_hz[order], together[order], 0.5)
    silence = series.values[(series.times_s >= silent_s) & (series.times_s < min(asked_s, begun_s))]
    noise = float((silence - silence.mean(axis=0)).var(axis=0).sum()) if len(silence) else 0.0
    over_db = 10.0 * float(np.log10(together[best] / noise)) if noise > 0.0 and together[best] > 0.0 else None
    row["over_noise_db"] = over_db
    if together[best] == 0.0 or (over_db is not None and over_db < ECHO_DB):
        return ("no_echo" if outcome == "swept" else outcome), row
    per_finger = [peak(frequencies_hz[order], column[order], 0.5)[0] for column in power.T]
    row.update(
        best_hz=best_hz,
        best_right_hz=per_finger[0],
        best_left_hz=per_finger[-1],
        band_low_hz=low_hz if np.isfinite(low_hz) else None,
        band_high_hz=high_hz if np.isfinite(high_hz) else None,
        unsure_hz=0.5 * STEP_HZ + abs(_slope_hz_s(settings)) * LATENCY_UNSURE_S,
    )
    return outcome, row


def beginning(ended_s: float, settings: ChirpSettings) -> float:
    """When the sweep was first received, s: counted back from its end, which the device reports by frame.

    The time of the command does not do: the sweep begins a buffer later and comes back after the card's latency, at the
    default 6.5 Hz for each millisecond.
    """
    return ended_s - settings.duration_s


def _slope_hz_s(settings: ChirpSettings) -> float:
    return (settings.to_hz - settings.from_hz) / settings.duration_s


def transfer(times_s: Floats, values: Floats, settings: ChirpSettings) -> tuple[Floats, Floats]:
    """Mean square of the received signal, less its mean, while the sweep passes through each band.

    Args:
        times_s: Since the sweep was first received, shape (n,).
        values: Of the fingers, shape (n, fingers).

    Returns:
        The bands' middles in Hz, shape (m,), and the mean squares, shape (m, fingers); bands without a sample are
        left out.
    """
    inside = (times_s >= 0.0) & (times_s < settings.duration_s)
    slope_hz_s = _slope_hz_s(settings)
    swept_hz = abs(slope_hz_s) * times_s[inside]
    cells = np.floor(swept_hz / STEP_HZ).astype(np.int64)
    count = np.bincount(cells) if len(cells) else np.empty(0, dtype=np.int64)
    fingers = values[inside].T
    if len(cells):
        fingers = fingers - fingers.mean(axis=1, keepdims=True)  # a card's offset is no echo
    squares = np.column_stack([np.bincount(cells, weights=x**2, minlength=len(count)) for x in fingers])
    filled = count > 0
    middles_hz = settings.from_hz + np.sign(slope_hz_s) * (np.arange(len(count)) + 0.5) * STEP_HZ
    return middles_hz[filled], squares[filled] / count[filled, None]
