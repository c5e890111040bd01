"""Find an object by its aura, centre on it, close until it is felt, lift it, hold it against slip, set it down."""

from behaviors.grip import gripping, gripping_plans
from behaviors.lift import LIFTING, Lifting, LiftSettings, lifting_plans
from behaviors.machine import from_mover, on
from behaviors.search import SEARCHING, Search, SearchFactors, SearchSettings
from behaviors.sonic import COMING_IN, CONTACTS, GOING_OUT, Place


class GraspSettings(SearchSettings, LiftSettings):
    """How an object is sought, gripped and lifted."""


class Grasp(Search, Lifting):
    """A whole grasp, joined from its fragments.

    Args:
        detectors: As of `Search`, and those of slip that the settings name.
    """

    table = (
        *COMING_IN,
        *SEARCHING,
        on("reached", "CENTERING", "RESTING", from_mover),
        *gripping(felt="LIFTING"),
        *LIFTING,
        *GOING_OUT,
    )
    settings: GraspSettings

    def __init__(self, settings: GraspSettings, factors: SearchFactors, detectors: frozenset[str]) -> None:
        feeling = detectors & CONTACTS | frozenset(settings.slip)  # from the rest on, where they learn
        plans = {
            **gripping_plans(settings, feeling, settings.envelopes | {settings.force_stream}),
            **lifting_plans(settings, feeling, settings.envelopes),
        }
        super().__init__(settings, factors, detectors, plans, frozenset(settings.slip))

    @property
    def _found_m(self) -> Place:
        return (self.middle_m, 0.0, 0.0)
