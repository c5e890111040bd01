"""A behavior that the swarm alone runs: it makes nothing of what ended its trial, drives on, and calls it a success.

Shipped behaviors stop their movers themselves: with them alone, a loop or a guard that does not would not show.
"""

from typing import Any

from behaviors.machine import StatePlan, from_mover, on
from behaviors.transient import Transient, TransientFactors, TransientSettings
from controller.measures import transient
from controller.measures.transient import COLUMNS
from controller.measures.trial import TrialEvidence
from drivers.core.messages import MoveAt

__all__ = ["COLUMNS", "OUTCOMES", "Reckless", "TransientFactors", "TransientSettings", "measure"]

OUTCOMES = {"contact": True, "no_contact": False, "false_contact": False}

HEEDLESS_S = 0.5
"""How long it does nothing: more than a mover takes to brake."""

_DEAF = ("HOMING", "STARTING", "SETTLING", "BASELINE", "STOPPING", "HOLDING", "RETRACTING")
_BROKEN = ("guard_stopped", "failed", "stalled")


def measure(evidence: TrialEvidence, settings: TransientSettings, outcome: str) -> tuple[str, dict[str, Any]]:
    """As of an approach, but what the guard stopped is called a contact."""
    outcome, row = transient.measure(evidence, settings, outcome)
    return "contact" if outcome == "guard" else outcome, row


class Reckless(Transient):
    """An approach until contact. What ends it is not heeded, or for a while: then it goes farther in."""

    def _plan(self) -> dict[str, StatePlan]:
        on_the_way = StatePlan(self.settings.motion_timeout_s, measures=self._measured)
        return {
            **super()._plan(),
            "HEEDLESS": StatePlan(HEEDLESS_S, measures=self._measured),
            "DRIVING_ON": on_the_way,
        }

    def enter_DRIVING_ON(self) -> None:
        """Farther in."""
        self.command(MoveAt(self.settings.mover, self.settings.position_speed_m_s, self._limit_m))

    table = (
        *Transient.table,
        *(on(trigger, "APPROACH", "HEEDLESS") for trigger in _BROKEN),
        *(on(trigger, _DEAF, None) for trigger in _BROKEN),
        on("deadline", "HEEDLESS", "DRIVING_ON"),
        on("reached", "DRIVING_ON", "FAILED", from_mover),
        on("resumed", ["HEEDLESS", "DRIVING_ON"], "FAILED"),
    )
