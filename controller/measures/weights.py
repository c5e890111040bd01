"""B6: a bridge's gain, hysteresis and resolution from weights (Fernandez et al., 4.2, Fig. 6)."""

import math
from typing import Any

from behaviors.weights import WeightsSettings
from controller.measures.bridge_calibration import calibrate, steps_of
from controller.measures.trial import Measured, MissingDataError, TrialEvidence, spans_of

HIGHLIGHTS = ("gain_v_n", "hysteresis", "resolution_n")
"""Columns shown during a run."""

COLUMNS = {
    "gain_v_n": "slope of the line through zero",
    "gain_low_v_n": "lower end of its 95 % interval",
    "gain_high_v_n": "upper end",
    "hysteresis": "largest difference between unloading and loading, as a share of full scale",
    "hysteresis_low": "lower end of its 95 % interval",
    "hysteresis_high": "upper end",
    "resolution_n": "smallest change detected",
    "resolution_low_n": "lower end of its 95 % interval",
    "resolution_high_n": "upper end",
    "zero_v": "the empty bridge before the first load",
    "nonlinearity": "largest departure of the mean from the line, as a share of full scale",
    "remanence": "what is left after a cycle, as a share of full scale",
    "gain_repeat_v_n": "standard deviation of the gain from cycle to cycle",
    "loads": "how many loads this rests on",
}


def measure(evidence: TrialEvidence, settings: WeightsSettings, outcome: str) -> Measured:
    """Calibrate one bridge; `not_calibrated` where it does not show the weights."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    for begin_s, end_s in spans_of(evidence.visits, "RECORDING"):
        evidence.covered(settings.bridges_stream, begin_s, end_s)
    steps = steps_of(
        evidence.recording,
        load_stream=settings.load_stream,
        bridges_stream=settings.bridges_stream,
        bridge=str(evidence.factors["bridge"]),
        preloads=settings.preloads,
    )
    if any(math.isnan(step.load_n) for step in steps):
        raise MissingDataError(f"{settings.load_stream}: a load that hung is no number; run this trial again")
    calibration = calibrate(steps, settings.weight_uncertainty)
    if not calibration:
        return ("not_calibrated" if outcome == "calibrated" else outcome), row
    return outcome, row | {name: None if math.isnan(value) else value for name, value in calibration.items()}
