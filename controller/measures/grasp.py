"""A grasp: what the search came to, how the object was held, and with how much more than the least force."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from behaviors.grasp import GraspSettings
from controller.measures import centering
from controller.measures.trial import Measured, TrialEvidence, not_before, spans_within
from drivers.core.messages import Grip, Sent

OFF_TABLE_M = 0.001
"""An object that is higher than this is off the table; below, it may be the fingers that give. Assumption."""

CARRIED = 0.9
"""An object of whose weight at least this share is carried does not stand on the table. Assumption."""

DROPPED_M = 0.02
"""An object that is so much lower than the tool has lifted it has slid out, or fallen. Assumption: a third of a pad."""

LATE_S = 0.15
"""How long after a slip its report still counts for it. Assumption: longer than the slowest detector takes."""

FRICTION_90 = (0.84, 1.03)
"""Ends of the friction's 90 % interval, over the estimate: so much was truth over estimate on the 180 objects that
chose the rule's settings (benchmarks/grasp), but for the lowest and the highest 5 %."""

UP = ("LOADING", "LIFTING", "SHAKING", "HOLDING")

_OWN = {
    "rise_m": "how far the object was off the table at the end of the hold (simulated benches)",
    "carried": "what share of its weight was carried there (simulated benches)",
    "carried_n": "what the arm's sensor says it carried",
    "lifted_m": "how far the tool was lifted",
    "held_s": "how long it was held there",
    "cycle_s": "from the search's beginning to the jaws' release",
    "felt_n": "with how much force the jaws pressed when both fingers had felt it (simulated benches)",
    "push_n": "the greatest force with which one finger alone pushed it (simulated benches)",
    "slips": "how often the jaws were made to press harder by a slip that was told",
    "slipped": "how often the pad with the sensor really slipped (simulated benches)",
    "told_true": "those of them that were slips (simulated benches)",
    "told_false": "those that were none (simulated benches)",
    "untold": "slips of the whole object that were not detected (simulated benches)",
    "slid_m": "how far it slid in the fingers altogether (simulated benches)",
    "arrested_m": "how far it slid at the most until it was held again, in the air (simulated benches)",
    "turned_rad": "how far it had turned about the grip's axis at the end (simulated benches)",
    "grip_n": "the last commanded grip force",
    "least_n": "the least force that would have held it, median of the hold (simulated benches)",
    "grip_over_least": "grip over least force, median of the hold (simulated benches)",
    "crushed": "1 where the grip crushed it (simulated benches)",
    "friction": "estimated coefficient of friction",
    "friction_low": "lower end of its 90 % interval",
    "friction_high": "upper end",
    "friction_true": "the true one, of what friction has left for the weight where torque takes its part (simulated "
    "benches)",
}
COLUMNS = {**_OWN, **centering.COLUMNS}  # what decides first

HIGHLIGHTS = ("grip_over_least", "arrested_m", "rise_m")
"""Columns shown during a run."""


def measure(evidence: TrialEvidence, settings: GraspSettings, outcome: str) -> Measured:
    """Measure one grasp.

    Whether the object was lifted and held is known from the truth of a simulated bench, whatever the fingers feel;
    else, where they still feel it, from the arm's force and the object's weight. Where neither is known it is `felt`.
    """
    outcome, row = centering.measure(evidence, settings, outcome)
    row |= dict.fromkeys(_OWN)
    lifting_s, holding_s = (evidence.entered_s.get(state) for state in ("LOADING", "HOLDING"))
    if lifting_s is None or lifting_s < evidence.entered_s.get("CLOSING", math.inf):
        return outcome, row
    over_s = evidence.entered_s.get("LOWERING", math.inf)
    begun_s = evidence.entered_s.get("SEEKING_FORWARD", evidence.entered_s.get("RESTING", lifting_s))
    released_s = evidence.entered_s.get("RELEASING")
    row["cycle_s"] = None if released_s is None else released_s - begun_s
    for detector in (*settings.slip, *settings.load):
        evidence.require_samples(detector, lifting_s, over_s)
    told_s = evidence.notes.get("slip_s", ())
    row["slips"] = len(told_s)
    sent = [event.command for event in evidence.events if isinstance(event, Sent)]
    row["grip_n"] = next((command.force_n for command in reversed(sent) if isinstance(command, Grip)), None)
    row |= _friction(evidence)
    if holding_s is not None and math.isfinite(over_s):
        heights_m = evidence.stream(settings.pose_stream, lifting_s, over_s).values[:, 2]
        row["lifted_m"], row["held_s"] = float(heights_m[-1] - heights_m[0]), over_s - holding_s
        row["carried_n"] = _carried_n(evidence, settings, holding_s, over_s)
    if evidence.lifts is not None:
        row |= _true(evidence, told_s, lifting_s, over_s)
    return _judged(evidence, settings, outcome, row), row


def _friction(evidence: TrialEvidence) -> Mapping[str, float]:
    """The least share of the grip that a finger carried when it slipped, and its interval."""
    found = evidence.notes.get("friction", ())
    if not found:
        return {}
    low, high = FRICTION_90
    return {"friction": found[-1], "friction_low": low * found[-1], "friction_high": high * found[-1]}


def _true(
    evidence: TrialEvidence, told_s: Sequence[float], lifting_s: float, over_s: float
) -> Mapping[str, Any]:
    """What a simulated bench knows."""
    known: dict[str, Any] = {}
    lifts = [lift for lift in evidence.lifts or () if lift.t_s <= over_s]
    slips, slides = (
        [span for span in spans_within(changes or ()) if lifting_s <= span[1] and span[0] <= over_s]
        for changes in (evidence.slips, evidence.slides)
    )
    known["slipped"] = len(slips)
    known["told_true"] = sum(any(_within(t_s, span) for span in (*slips, *slides)) for t_s in told_s)
    known["told_false"] = len(told_s) - known["told_true"]
    heard_s = evidence.notes.get("told_s", ())  # also what the jaws could not answer
    known["untold"] = sum(not any(_within(t_s, span) for t_s in heard_s) for span in slides)
    if not lifts:
        return known
    known["push_n"], known["crushed"] = lifts[-1].push_n, int(lifts[-1].crushed)
    times_s = np.array([lift.t_s for lift in lifts])
    known["felt_n"] = float(np.interp(lifting_s, times_s, [lift.grip_n for lift in lifts]))
    slid_m = np.array([lift.slid_m for lift in lifts])
    known["slid_m"] = float(slid_m[-1] - np.interp(lifting_s, times_s, slid_m))
    air_s = evidence.entered_s.get("LIFTING", math.inf)
    edges_m = [np.interp(span, times_s, slid_m) for span in slides if span[0] >= air_s]
    known["arrested_m"] = max((float(edge[1] - edge[0]) for edge in edges_m), default=0.0)
    held = [lift for lift in lifts if lift.t_s >= evidence.entered_s.get("HOLDING", math.inf)]
    if held:
        known["rise_m"], known["carried"] = held[-1].rise_m, held[-1].carried
        known["turned_rad"] = held[-1].turned_rad
        known["least_n"] = float(np.median([lift.least_n for lift in held]))
        firm = [lift for lift in held if lift.least_n > 0.0]
        if firm:
            known["grip_over_least"] = float(np.median([lift.grip_n / lift.least_n for lift in firm]))
            known["friction_true"] = float(np.median([0.5 * lift.weight_n / lift.least_n for lift in firm]))
    return known


def _within(t_s: float, span: tuple[float, float]) -> bool:
    """Whether a report is of a slip."""
    return not_before(t_s, span[0]) and t_s <= span[1] + LATE_S


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


def _judged(evidence: TrialEvidence, settings: GraspSettings, outcome: str, row: Mapping[str, Any]) -> str:
    """Whether what the fingers felt, or no longer felt, was lifted and held."""
    if outcome not in ("held", "dropped"):
        return outcome
    if evidence.lifts is not None:
        if row["crushed"]:
            return "crushed"
        lifting_s = evidence.entered_s["LOADING"]
        risen = any(lift.rise_m > OFF_TABLE_M for lift in evidence.lifts if lift.t_s >= lifting_s)
        held = row["rise_m"] is not None and row["carried"] >= CARRIED
        held = held and row["rise_m"] > max(OFF_TABLE_M, row["lifted_m"] - DROPPED_M)
        return "held" if held else "dropped" if risen else "not_lifted"
    if outcome == "dropped":
        return outcome
    if settings.weight_n is None or row["carried_n"] is None:
        return "felt"
    return "held" if row["carried_n"] >= CARRIED * settings.weight_n else "not_lifted"
