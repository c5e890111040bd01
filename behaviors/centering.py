"""C3: find an object between two fingers by its aura, go to the middle, close (Rupavatharam et al., III.D, IV.A.2)."""

from behaviors.grip import Gripping, GripSettings, gripping, gripping_plans
from behaviors.machine import concluding, from_mover, on
from behaviors.search import SEARCHING, Search, SearchFactors, SearchSettings
from behaviors.sonic import COMING_IN, CONTACTS, GOING_OUT


class CenteringSettings(SearchSettings, GripSettings):
    """How the middle is sought, and what is done there."""

    grasp: bool = True
    """Close on the object, confirm contact and open again once the middle is found."""


class Centering(Search, Gripping):
    """Find the middle; close there, hold and release.

    Args:
        detectors: Names of all detectors: `left_METHOD`, `right_METHOD`, `left_contact`, `right_contact`.
    """

    settings: CenteringSettings

    def __init__(
        self, settings: CenteringSettings, factors: SearchFactors, detectors: frozenset[str]
    ) -> None:
        plans = gripping_plans(settings, detectors & CONTACTS, settings.envelopes)
        super().__init__(settings, factors, detectors, plans)

    def enter_HOLDING(self) -> None:
        """Contact is confirmed."""
        self.conclude("centered")

    table = (
        *COMING_IN,
        *SEARCHING,
        on("reached", "CENTERING", "RESTING", from_mover, lambda it: it.settings.grasp, label="to grasp"),
        on("reached", "CENTERING", "LEAVING", from_mover, do=concluding("centered")),
        *gripping(felt="HOLDING"),
        on("deadline", "HOLDING", "RELEASING"),
        on("resumed", "HOLDING", "RELEASING"),
        *GOING_OUT,
    )
