"""A4: which link was touched, from an accelerometer on each (Backus and Dollar, V.C)."""

import math

import numpy as np

from behaviors.proximal import ProximalSettings
from controller.measures import transient
from controller.measures.trial import Measured, TrialEvidence

HIGHLIGHTS = ("identified", "ratio_db", "delay_s")
"""Columns shown during a run."""

COLUMNS = {
    **transient.COLUMNS,
    "identified": "the link that was touched, proximal or distal",
    "ratio_db": "growth of the ratio of the distal to the proximal accelerometer's standard deviation",
}

LISTENS_S = 0.3
"""Time after the detection over which the two swings are compared, eight periods. Assumption: from 0.07 to 0.3 s after
the touch it made little difference on 240 other approaches, to a kind and a hard finger."""


def measure(evidence: TrialEvidence, settings: ProximalSettings, outcome: str) -> Measured:
    """Measure one approach, and identify the link touched.

    Contact holds a link: its accelerometer measures the knocks, and the other link swings on. The distal swing is
    divided by the proximal one; if that ratio has grown since the baseline, the distal link was touched. Nothing is
    fitted.

    Returns:
        As `measures.transient`, with more columns; they are empty where no contact was detected, or the probe went
        back within `LISTENS_S` of it.
    """
    outcome, row = transient.measure(evidence, settings, outcome)
    row |= {"identified": None, "ratio_db": None}
    detect_s, begun_s = row["detect_s"], evidence.entered_s.get("APPROACH")
    if outcome != "contact" or detect_s is None or begun_s is None:
        return outcome, row
    if evidence.entered_s.get("RETRACTING", math.inf) < detect_s + LISTENS_S:
        return outcome, row
    levels = []
    for stream in settings.waveform_streams:
        _, free = evidence.series(stream, evidence.entered_s["BASELINE"], begun_s)
        _, held = evidence.series(stream, detect_s, detect_s + LISTENS_S)
        levels.append(math.log10(float(np.std(held)) / float(np.std(free))))
    row["ratio_db"] = 20.0 * (levels[1] - levels[0])
    row["identified"] = "distal" if row["ratio_db"] > 0.0 else "proximal"
    return outcome, row
