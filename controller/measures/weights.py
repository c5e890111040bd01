"""B6: a bridge's gain, hysteresis and resolution from weights (Fernandez et al., 4.2, Fig. 6)."""

import math
from typing import Any

from behaviors.weights import WeightsSettings
from controller.measures import Column
from controller.measures.bridge_calibration import BridgeCalibration, calibrate, steps_of
from controller.measures.trial import Measured, MissingDataError, TrialEvidence, spans_of

HIGHLIGHTS = ("gain_v_n", "hysteresis", "resolution_n")
"""Columns shown during a run."""

COLUMNS = {
    "gain_v_n": Column("slope of the line through zero", 4),
    "gain_low_v_n": Column("lower end of its 95 % interval", 4),
    "gain_high_v_n": Column("upper end", 4),
    "hysteresis": Column("largest difference between unloading and loading, as a share of full scale"),
    "hysteresis_low": Column("lower end of its 95 % interval"),
    "hysteresis_high": Column("upper end"),
    "resolution_n": Column("smallest change detected", 4),
    "resolution_low_n": Column("lower end of its 95 % interval", 4),
    "resolution_high_n": Column("upper end", 4),
    "zero_v": Column("the empty bridge before the first load", 5),
    "nonlinearity": Column("largest departure of the mean from the line, as a share of full scale"),
    "remanence": Column("what is left after a cycle, as a share of full scale"),
    "gain_repeat_v_n": Column("standard deviation of the gain from cycle to cycle"),
    "loads": Column("how many loads this rests on"),
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
    calibration = calibrate([steps], settings.weight_uncertainty)
    # a gain that is noise: the largest weight is less than the smallest change detected
    if calibration is None or calibration.resolution_n.value >= calibration.top_n:
        return ("not_calibrated" if outcome == "calibrated" else outcome), row
    row |= {name: None if math.isnan(value) else value for name, value in _columns(calibration).items()}
    return outcome, row


def _columns(calibration: BridgeCalibration) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, unit in (("gain", "_v_n"), ("hysteresis", ""), ("resolution", "_n")):
        value, low, high = getattr(calibration, f"{name}{unit}")
        found |= {f"{name}{unit}": value, f"{name}_low{unit}": low, f"{name}_high{unit}": high}
    found |= {name: getattr(calibration, name) for name in ("zero_v", "nonlinearity", "remanence")}
    return found | {"gain_repeat_v_n": calibration.repeat_v_n, "loads": calibration.steps}
