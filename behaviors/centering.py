"""C3: find an object between two fingers by its aura, go to the middle, close (Rupavatharam et al., III.D, IV.A.2)."""

from __future__ import annotations

from enum import Enum, auto

from behaviors.grip import Gripping, GripSettings, gripping, gripping_plans
from behaviors.machine import on, with_failures
from behaviors.search import SEARCHING, Search, SearchFactors, SearchSettings
from behaviors.sonic import COMING_IN, CONTACTS, GOING_OUT


class CenteringSettings(SearchSettings, GripSettings):
    """How the middle is sought, and what is done there."""

    grasp: bool = True
    """Close on the object, confirm contact and open again once the middle is found."""


class CenteringFactors(SearchFactors):
    """What a trial varies."""


class Centering(Search, Gripping):
    """Find the middle; close there, hold and let go.

    Args:
        settings: Of the experiment.
        factors: Of the trial.
        detectors: Names of all detectors: `left_METHOD`, `right_METHOD`, `left_contact`, `right_contact`.
    """

    class States(Enum):
        """Where the trial is."""

        CLEARING = auto()
        CALIBRATING = auto()
        OPENING = auto()
        ENTERING = auto()
        BASELINE = auto()
        RUNNING_UP = auto()
        REVERSING = auto()
        SEEKING_FORWARD = auto()
        TURNING = auto()
        SEEKING_BACKWARD = auto()
        STOPPING = auto()
        CENTERING = auto()
        RESTING = auto()
        CLOSING = auto()
        CONFIRMING = auto()
        HOLDING = auto()
        RELEASING = auto()
        BACKING_OFF = auto()
        LEAVING = auto()
        DONE = auto()
        FAILED = auto()

    initial = States.CLEARING
    final = frozenset({States.DONE, States.FAILED})
    table = with_failures(
        States,
        *COMING_IN,
        *SEARCHING,
        on("reached", States.CENTERING, States.RESTING, ["from_mover", "grasping"], label="to grasp"),
        on("reached", States.CENTERING, States.LEAVING, "from_mover"),
        *gripping(felt="HOLDING"),
        on("deadline", States.HOLDING, States.RELEASING),
        on("resumed", States.HOLDING, States.RELEASING),
        *GOING_OUT,
    )
    settings: CenteringSettings

    def __init__(
        self, settings: CenteringSettings, factors: CenteringFactors, detectors: frozenset[str]
    ) -> None:
        plans = gripping_plans(self.States, settings, detectors & CONTACTS, settings.envelopes)
        super().__init__(settings, factors, detectors, plans)

    def grasping(self) -> bool:
        """Whether the object is to be grasped."""
        return self.settings.grasp

    def enter_HOLDING(self) -> None:
        """Contact is confirmed."""
        self.conclude("contact")
