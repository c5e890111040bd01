"""Slip located by the contact's angle, and whether the contact stays on the tip (Fernandez et al., 4.3)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from behaviors.border import BorderTrialSettings
from behaviors.events import BorderNear, SlipStarted
from controller.measures.trial import Measured, TrialEvidence, delay_s
from drivers.core.messages import Floats

LATEST_S = 0.02
"""Over which the angle at a detection is taken, s: as the detector's running mean."""

ANGLE_DECIMALS = 12
"""Of an angle in rad: the product of two turns leaves some 1e-16, no arm tells 1e-12."""

HIGHLIGHTS = ("farthest_rad", "slip_at_rad", "turned_back")
"""Columns shown during a run."""

COLUMNS = {
    "slip_s": "when the first slip began, in truth (simulated benches)",
    "ours_delay_s": "from there until our detector reported it",
    "slip_at_rad": "angle of the contact where it slipped, by the forces",
    "slip_at_true_rad": "the same, by the arm",
    "near_s": "when the contact was reported near the border",
    "turned_back": "whether the tip was turned back",
    "farthest_rad": "the contact's farthest angle from the middle, by the arm",
    "end_rad": "its angle when the tip was lifted, by the arm",
}


def measure(evidence: TrialEvidence, settings: BorderTrialSettings, outcome: str) -> Measured:
    """Measure one trial; `kept` where the contact stayed within `border_rad`, else `lost`."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    pressed_s, lifted_s = (evidence.entered_s.get(state) for state in ("PRESSING", "LIFTING"))
    run = settings.sensors["fingertip"]
    if outcome != "contact" or pressed_s is None or lifted_s is None or run.forces_stream is None:
        return outcome, row
    times_s, angles_rad = _true_angles(evidence, settings, pressed_s, lifted_s)
    row["farthest_rad"], row["end_rad"] = float(np.abs(angles_rad).max()), float(angles_rad[-1])
    row["turned_back"] = int("TURNING_BACK" in evidence.entered_s)
    near = evidence.first(BorderNear, detector=settings.border)
    row["near_s"] = None if near is None else near.t_s
    slipping_s = evidence.entered_s.get("SLIPPING", lifted_s)
    begins_s = [t_s for t_s, began in evidence.slips or () if began and slipping_s <= t_s < lifted_s]
    row["slip_s"] = begins_s[0] if begins_s else None
    found = evidence.first(SlipStarted, since_s=slipping_s, until_s=lifted_s, detector=run.ours)
    if found is not None:
        row["ours_delay_s"] = (
            delay_s(found.t_s, begins_s[0]) if begins_s and found.t_s >= begins_s[0] else None
        )
        forces_n = evidence.stream(run.forces_stream, found.t_s - LATEST_S, found.t_s).values.mean(axis=0)
        row["slip_at_rad"] = float(np.arctan2(forces_n[0], forces_n[1]))
        row["slip_at_true_rad"] = float(np.interp(found.t_s, times_s, angles_rad))
    return "kept" if row["farthest_rad"] <= settings.border_rad else "lost", row


def _true_angles(
    evidence: TrialEvidence, settings: BorderTrialSettings, since_s: float, until_s: float
) -> tuple[Floats, Floats]:
    """Times (n,) and the tip's angles about its own axis (n,), rad: the contact's on a flat table."""
    from scipy.spatial.transform import Rotation

    start = evidence.stream(settings.pose_stream, evidence.entered_s["RESTING"], since_s).values[0, 3:]
    poses = evidence.stream(settings.pose_stream, since_s, until_s)
    turns = Rotation.from_rotvec(poses.values[:, 3:]) * Rotation.from_rotvec(start).inv()
    begins_rad = float(evidence.factors["begins_rad"])
    roll_rad = math.copysign(settings.roll_rad, begins_rad or evidence.factors.get("turn_rad_s") or 0.0)
    angles_rad = turns.as_rotvec()[:, 1] + begins_rad - roll_rad
    return poses.times_s, np.round(angles_rad, ANGLE_DECIMALS)
