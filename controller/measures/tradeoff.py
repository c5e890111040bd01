"""A5: what each threshold would have detected, on approaches without a stop (Backus and Dollar, III.B, V.C)."""

import math

from behaviors.transient import TransientSettings
from controller.detectors.resonance import DIRECTIONS, ResonanceDetector
from controller.detectors.resonance_paper import ResonancePaperDetector
from controller.measures import transient
from controller.measures.trial import Measured, TrialEvidence

METHODS = ("average", *DIRECTIONS)
"""The paper's averaged frequency, and what the waveform's detector can be set to sense."""

SOON_S, LATER_S = 0.07, 0.3
"""Spans after the touch: two periods, and the paper's own mean delay (V.B)."""

WHEN = {
    "before": "from the approach's start to the touch: a threshold below it is a false contact",
    "soon": "within 0.07 s after the touch: a threshold below it detects the contact in time",
    "later": "within 0.3 s after the touch: likewise",
}

RENAMED = {"no_contact": "recorded", "contact": "stopped"}
"""What the behavior concludes, and what that means where no detection is wanted."""

HIGHLIGHTS = ("average_before", "average_later", "all_soon")
"""Columns shown during a run."""

COLUMNS = {
    **transient.COLUMNS,
    **{
        f"{method}_{when}": f"largest {method} in deviations of the free finger, {span}"
        for method in METHODS
        for when, span in WHEN.items()
    },
}


def measure(evidence: TrialEvidence, settings: TransientSettings, outcome: str) -> Measured:
    """Measure one approach that goes to its full depth whatever is detected.

    Returns:
        The outcome, `recorded` where the probe touched and went to its depth, `stopped` where a detection ended that;
        and the columns.
    """
    outcome, row = transient.measure(evidence, settings, outcome)
    row |= dict.fromkeys(name for name in COLUMNS if name not in row)
    begun_s, touch_s = evidence.entered_s.get("APPROACH"), transient.touch_of(row, evidence)
    if begun_s is None or touch_s is None:
        return outcome, row
    for detector in evidence.detectors.values():
        if not isinstance(detector, ResonanceDetector | ResonancePaperDetector):
            continue
        until_s = evidence.entered_s.get("RETRACTING", math.inf)
        waveform = evidence.series(detector.settings.input, evidence.entered_s["BASELINE"], until_s)
        times_s, deviations = detector.deviations(*waveform)
        spans = (
            (times_s >= begun_s) & (times_s < touch_s),
            (times_s >= touch_s) & (times_s <= touch_s + SOON_S),
            (times_s >= touch_s) & (times_s <= touch_s + LATER_S),
        )
        for method, values in deviations.items():
            for when, span in zip(WHEN, spans, strict=True):
                row[f"{method}_{when}"] = float(values[span].max()) if span.any() else None
    return RENAMED.get(outcome, outcome), row
