"""A grasp: what the search came to, what was felt, and how the object was held."""

from __future__ import annotations

import math
from typing import Any

from behaviors.events import SlipStarted
from behaviors.grasp import GraspSettings
from controller.measures import centering
from controller.measures.trial import TrialEvidence
from drivers.messages import Grip, Sent

_OWN = ("lifted_m", "held_s", "slips", "slipped", "grip_n")
COLUMNS = (*centering.COLUMNS, *_OWN)


def measure(evidence: TrialEvidence, settings: GraspSettings, outcome: str) -> tuple[str, dict[str, Any]]:
    """Measure one grasp.

    Returns:
        The outcome, and the columns of centering with five more: how far the tool was lifted, how long the object was
        held there, how often slip was detected meanwhile, how often it really slipped (simulated benches only), and the
        last commanded grip force.
    """
    outcome, row = centering.measure(evidence, settings, outcome)
    row |= dict.fromkeys(_OWN)
    lifting_s, holding_s = (evidence.entered_s.get(state) for state in ("LIFTING", "HOLDING"))
    if lifting_s is None or lifting_s < evidence.entered_s.get("CLOSING", math.inf):
        return outcome, row
    over_s = evidence.entered_s.get("LOWERING", math.inf)
    for detector in settings.slip:
        evidence.require_samples(detector, lifting_s, over_s)
    slips = [event for event in evidence.events if isinstance(event, SlipStarted)]
    row["slips"] = sum(e.detector in settings.slip and lifting_s <= e.t_s <= over_s for e in slips)
    if evidence.slips is not None:
        row["slipped"] = sum(began and lifting_s <= t_s <= over_s for t_s, began in evidence.slips)
    sent = [event.command for event in evidence.events if isinstance(event, Sent)]
    row["grip_n"] = next((command.force_n for command in reversed(sent) if isinstance(command, Grip)), None)
    if holding_s is not None and math.isfinite(over_s):
        heights_m = evidence.stream(settings.pose_stream, lifting_s, over_s).values[:, 2]
        row["lifted_m"], row["held_s"] = float(heights_m[-1] - heights_m[0]), over_s - holding_s
    return outcome, row
