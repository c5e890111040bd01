"""B7: the angle of the contact against the true angle (Fernandez et al., Fig. 2 and 11)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from behaviors.events import Resumed
from behaviors.pointer import PointerSettings
from controller.measures import Column
from controller.measures.touches import RECORDED, ZERO, errors_of, spans_of, touches_of
from controller.measures.trial import TrialEvidence

HIGHLIGHTS = ("theta_rms_rad", "theta_max_rad", "force_n")
"""Columns shown during a run."""

COLUMNS = {
    "touches": Column("touches recorded"),
    "force_n": Column("their mean normal force", 2),
    "theta_bias_rad": Column("mean error of the angle over all of them", 2),
    "theta_sd_rad": Column("its standard deviation", 2),
    "theta_rms_rad": Column("its root mean square", 2),
    "theta_max_rad": Column("the largest of either sign", 2),
    "theta_hysteresis_rad": Column("largest difference between an angle going up and going down", 2),
    "theta_spread_rad": Column("mean standard deviation of the angle from sample to sample", 2),
}


def measure(evidence: TrialEvidence, settings: PointerSettings, outcome: str) -> tuple[str, dict[str, Any]]:
    """Compare the fingertip's angle with the arm's, touch by touch.

    Returns:
        The outcome, and the columns.
    """
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    for state in (ZERO, RECORDED):
        for begin_s, end_s in spans_of(evidence.visits, state):
            evidence.covered(settings.pose_stream, begin_s, end_s)
            if state == RECORDED:
                evidence.covered(settings.forces_stream, begin_s, end_s)
    touches = touches_of(
        evidence.recording,
        evidence.visits,
        forces_stream=settings.forces_stream,
        pose_stream=settings.pose_stream,
        angles=len(settings.angles_rad),
        broken_s=frozenset(event.t_s for event in evidence.events if isinstance(event, Resumed)),
    )
    row["touches"] = len(touches)
    if touches:
        errors = errors_of(touches)
        row.update(
            force_n=float(np.mean([touch.force_n for touch in touches])),
            theta_bias_rad=errors.bias,
            theta_sd_rad=_known(errors.sd),
            theta_rms_rad=errors.rms,
            theta_max_rad=errors.largest,
            theta_hysteresis_rad=_known(errors.hysteresis),
            theta_spread_rad=float(np.mean([touch.spread_rad for touch in touches])),
        )
    return outcome, row


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
