"""A2: delay, extent and force at detection, against the load cell (Backus and Dollar, III.C, Table I)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from behaviors.events import BaselineReady
from controller.detectors.protocol import quantity_of
from controller.measures.trial import STEP_S, Measured, TrialEvidence, not_before
from drivers.core.messages import Floats, Standstill

if TYPE_CHECKING:
    from behaviors.transient import TransientSettings

ONSET_N = 0.005
"""The reference's onset: the load cell rises from 0 to 0.005 N (IV.B)."""

NEAR_S = 1e-4
"""A sample at the edge of a span falls to either side of it by how a device's clock was estimated, which a run learns
over its trials: so spans begin and end so much beside them, a tenth of a sample of the board, s."""

HIGHLIGHTS = ("delay_s", "extent_m", "force_n")
"""Columns shown during a run."""

COLUMNS = {
    "truth_contact_s": "when the probe touched, in truth (simulated benches)",
    "onset_s": "when the load cell reached 0.005 N",
    "detect_s": "when contact was detected",
    "delay_s": "from onset to detection; negative where the touch was lighter than 0.005 N",
    "extent_m": "travel of the probe in that time",
    "force_n": "force at detection: mean over the last oscillation",
    "force_peak_n": "largest force of approach, stop and hold",
    "false_contacts": "detections before contact: the simulated one where it is known, else the load cell's onset",
    "baseline_hz": "frequency learned",
    "threshold_hz": "threshold on it",
    "command_s": "when the stop command's last byte left",
    "standstill_s": "when the probe stood still",
    "stop_travel_m": "how far it went from detection to standstill",
}


def measure(evidence: TrialEvidence, settings: TransientSettings, outcome: str) -> Measured:
    """Measure one approach.

    A detection before contact is false: before the simulated contact where the truth is known, else before the
    load cell's onset. A detection may precede the onset (the touch is lighter than 0.005 N); its delay is
    then negative. A real load cell whose noise reaches 0.005 N by itself shows no onset: there is none then.

    Returns:
        The outcome, which distinguishes false from true contact, and the row's columns; None for what did not occur.
        `wrong_sign` where a real load cell read the push as negative.
    """
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    position = settings.position_stream
    begun_s = evidence.entered_s.get("APPROACH")
    ready = evidence.last(BaselineReady, detector=settings.detector)
    if ready is not None:
        quantity = quantity_of(evidence.detectors.get(settings.detector))
        # a column is named after one quantity: another one is recorded beside its own threshold, not here
        if (quantity.learned or quantity.unit) == "Hz":
            row["baseline_hz"] = ready.value
        if quantity.unit == "Hz":
            row["threshold_hz"] = ready.threshold
    contact = evidence.ending_contact(settings.detector)
    baseline_s = evidence.entered_s.get("BASELINE")
    if baseline_s is not None:
        ended_s = evidence.entered_s.get("STOPPING", evidence.entered_s.get("RETRACTING", math.inf))
        evidence.require_samples(settings.detector, baseline_s, ended_s)
    if begun_s is None:
        if contact is not None:  # before the approach there is nothing to touch
            row.update(detect_s=contact.t_s, false_contacts=1)
            outcome = "false_contact" if outcome == "contact" else outcome
        return outcome, row
    channel = settings.load_cell_channel
    times_s, force_n = tared(evidence, settings.load_cell_stream, begun_s, channel)
    above = np.flatnonzero(force_n >= ONSET_N)
    baseline_n = evidence.series(
        settings.load_cell_stream, -math.inf if baseline_s is None else baseline_s, begun_s, channel
    )[1]
    noise_n = float(baseline_n.std()) if len(baseline_n) else 0.0
    too_noisy = evidence.truth is None and noise_n > ONSET_N / 4.0
    onset_s = float(times_s[above[0]]) if len(above) and not too_noisy else None
    touched_s = evidence.touched_s(begun_s)
    row.update(onset_s=onset_s, truth_contact_s=touched_s, force_peak_n=_largest(force_n), false_contacts=0)
    # the event that stopped the approach may come from samples just before it
    if contact is None or (contact.t_s < begun_s and outcome != "contact"):
        return outcome, row
    detect_s = contact.t_s
    row.update(detect_s=detect_s, **stop_certificate(evidence, settings.mover, position, detect_s))
    if evidence.truth is None and (settings.load_cell_stream is None or too_noisy):
        row["false_contacts"] = None  # nothing on this bench tells a true contact from a false one
        return outcome, row
    if evidence.truth is None and pulls(force_n) and outcome == "contact":
        row["false_contacts"] = None
        return "wrong_sign", row
    reference_s = touch_of(row, evidence)
    if reference_s is None or precedes(detect_s, reference_s, evidence):
        row["false_contacts"] = 1
        return ("false_contact" if outcome == "contact" else outcome), row
    row["force_n"] = _mean_over_oscillation(times_s, force_n, detect_s, _period(evidence, settings, detect_s))
    if onset_s is not None:
        row["delay_s"] = detect_s - onset_s
        at = positions_at(evidence, position, (onset_s, detect_s))
        row["extent_m"] = at[1] - at[0] if at is not None else None
    return outcome, row


def touch_of(row: Mapping[str, Any], evidence: TrialEvidence) -> float | None:
    """When the probe touched: in truth where the bench is simulated here, else the load cell's onset; None if not."""
    found: float | None = row["truth_contact_s" if evidence.truth is not None else "onset_s"]
    return found


def precedes(t_s: float, touch_s: float, evidence: TrialEvidence) -> bool:
    """Whether an event came before the touch, which is known exactly where the finger is simulated here, and else to
    one sample of the load cell."""
    return not not_before(t_s, touch_s, STEP_S if evidence.truth is None else 0.0)


def tared(
    evidence: TrialEvidence, stream: str | None, begun_s: float, channel: int = 0
) -> tuple[Floats, Floats]:
    """Load cell of approach, stop and hold, less its mean over the baseline before."""
    baseline_s = evidence.entered_s.get("BASELINE", -math.inf)
    until_s = evidence.entered_s.get("RETRACTING", math.inf)
    times_s, force_n = evidence.series(stream, baseline_s + NEAR_S, until_s - NEAR_S, channel)
    before = times_s < begun_s - NEAR_S
    zero_n = float(force_n[before].mean()) if before.any() else 0.0
    return times_s[~before], force_n[~before] - zero_n


def pulls(force_n: Floats) -> bool:
    """Whether a push was read as negative: the sensor's sign is wrong."""
    return bool(len(force_n) and force_n[abs(force_n).argmax()] <= -ONSET_N)


def _largest(force_n: Floats) -> float | None:
    return float(force_n.max()) if len(force_n) else None


def _period(evidence: TrialEvidence, settings: TransientSettings, until_s: float) -> float:
    """The last whole period before an instant, in seconds; that of 28 Hz (IV.A) where none was counted."""
    _, periods_s = evidence.series(
        settings.period_stream, evidence.entered_s.get("BASELINE", -math.inf), until_s
    )
    return float(periods_s[-1]) if len(periods_s) else 1.0 / 28.0


def _mean_over_oscillation(times_s: Floats, force_n: Floats, end_s: float, period_s: float) -> float | None:
    """Mean force over the one oscillation that ends at `end_s`."""
    within = (times_s > end_s - period_s) & (times_s <= end_s)
    return float(force_n[within].mean()) if within.any() else None


def positions_at(evidence: TrialEvidence, stream: str, at_s: tuple[float, ...]) -> Floats | None:
    """Mover's positions at some instants, between its reports (the speed between two of them is constant)."""
    positions = evidence.covered(stream, min(at_s), max(at_s))
    if not len(positions):
        return None
    return np.interp(at_s, positions.times_s, positions.values[:, 0])


def stop_certificate(
    evidence: TrialEvidence, mover: str, position: str, detect_s: float
) -> Mapping[str, float | None]:
    """The stop certificate: when the command left, when the mover stood still, how far it went in between."""
    still = evidence.first(Standstill, detect_s, device=mover)
    travel_m = None
    if still is not None:
        at = positions_at(evidence, position, (detect_s, still.t_s))
        travel_m = float(at[1] - at[0]) if at is not None else None
    return {
        "command_s": evidence.stop_sent_s(mover, detect_s),
        "standstill_s": None if still is None else still.t_s,
        "stop_travel_m": travel_m,
    }
