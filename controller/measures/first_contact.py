"""The first touch on a new bench: where contact was detected, how hard it pressed, how far the mover went on."""

from typing import Any

from behaviors.events import Contact
from behaviors.first_contact import FirstContactSettings
from controller.measures.transient import positions_at, stop_certificate, tared
from controller.measures.trial import Measured, TrialEvidence

HIGHLIGHTS = ("position_m", "force_peak_n", "stop_travel_m")

COLUMNS = {
    "detect_s": "when contact was detected",
    "position_m": "where the mover was then",
    "force_peak_n": "largest force from the approach until it went back",
    "command_s": "when the stop command's last byte left",
    "standstill_s": "when the mover stood still",
    "stop_travel_m": "how far it went from detection to standstill",
}


def measure(evidence: TrialEvidence, settings: FirstContactSettings, outcome: str) -> Measured:
    """Measure one touch; None for what did not occur. Pressing reads positive: if not, the sensor's sign is wrong."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    begun_s = evidence.entered_s.get("APPROACH")
    if begun_s is None:
        return outcome, row
    _, force_n = tared(evidence, settings.load_cell_stream, begun_s, settings.load_cell_channel)
    if len(force_n):
        peak_n = float(force_n[abs(force_n).argmax()])
        row["force_peak_n"] = abs(peak_n)
        if outcome == "contact" and peak_n < 0.0:
            outcome = "wrong_sign"
    contact = evidence.last(Contact, detector=settings.detector)
    if contact is not None:
        at_m = positions_at(evidence, settings.position_stream, (contact.t_s,))
        row.update(detect_s=contact.t_s, position_m=None if at_m is None else float(at_m[0]))
        row.update(stop_certificate(evidence, settings.mover, settings.position_stream, contact.t_s))
    return outcome, row
