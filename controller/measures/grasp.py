"""A grasp: what the search came to, what was felt, and how the object was held."""

import math
from collections.abc import Mapping
from typing import Any

from behaviors.events import SlipStarted
from behaviors.grasp import GraspSettings
from controller.measures import Column, centering
from controller.measures.trial import TrialEvidence
from drivers.core.messages import Grip, Sent

OFF_TABLE_M = 0.001
"""An object that is higher than this is off the table; below, it may be the fingers that give. Assumption."""

CARRIED = 0.9
"""An object of whose weight at least this share is carried does not stand on the table. Assumption."""

_OWN = {
    "rise_m": Column("how far the object was off the table at the end of the hold (simulated benches)"),
    "carried": Column("what share of its weight was carried there (simulated benches)"),
    "carried_n": Column("what the arm's sensor says it carried"),
    "lifted_m": Column("how far the tool was lifted"),
    "held_s": Column("how long it was held there"),
    "slips": Column("how often slip was detected meanwhile"),
    "slipped": Column("how often it really slipped (simulated benches)"),
    "grip_n": Column("the last commanded grip force"),
}
COLUMNS = {**_OWN, **centering.COLUMNS}  # what decides first


def measure(evidence: TrialEvidence, settings: GraspSettings, outcome: str) -> tuple[str, dict[str, Any]]:
    """Measure one grasp.

    Whether the object was lifted and held is known from the truth of a simulated bench, whatever the fingers feel;
    else, where they still feel it, from the arm's force and the object's weight. Where neither is known it is `felt`.

    Returns:
        The outcome, and the columns.
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
        row["carried_n"] = _carried_n(evidence, settings, holding_s, over_s)
        lifts = [lift for lift in evidence.lifts or () if holding_s <= lift[0] <= over_s]
        row["rise_m"], row["carried"] = lifts[-1][1:] if lifts else (None, None)
    risen = any(rise_m > OFF_TABLE_M for t_s, rise_m, _ in evidence.lifts or () if lifting_s <= t_s <= over_s)
    return _judged(evidence, settings, outcome, row, risen), row


def _carried_n(
    evidence: TrialEvidence, settings: GraspSettings, holding_s: float, over_s: float
) -> float | None:
    """What the arm carries while it holds, less what it carried at rest in the middle, N."""
    resting_s, closing_s = evidence.entered_s.get("RESTING"), evidence.entered_s.get("CLOSING")
    if resting_s is None or closing_s is None:
        return None
    spans = (resting_s, closing_s), (holding_s, over_s)
    before, held = (evidence.stream(settings.force_stream, *span).values for span in spans)
    return float(before[:, 2].mean() - held[:, 2].mean()) if len(before) and len(held) else None


def _judged(
    evidence: TrialEvidence, settings: GraspSettings, outcome: str, row: Mapping[str, Any], risen: bool
) -> str:
    """Whether what the fingers felt, or no longer felt, was lifted and held.

    Args:
        risen: Whether the object was really off the table at any time.
    """
    if outcome not in ("held", "dropped"):
        return outcome
    if evidence.lifts is not None:
        held = row["rise_m"] is not None and row["rise_m"] > OFF_TABLE_M and row["carried"] >= CARRIED
        return "held" if held else "dropped" if risen else "not_lifted"
    if outcome == "dropped":
        return outcome
    if settings.weight_n is None or row["carried_n"] is None:
        return "felt"
    return "held" if row["carried_n"] >= CARRIED * settings.weight_n else "not_lifted"
