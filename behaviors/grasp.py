"""Find an object by its aura, centre on it, close until it is felt, lift it, hold it with little force, set it down."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from behaviors.grip import gripping, gripping_plans
from behaviors.lift import LIFTING, Lifting, LiftSettings, lifting_plans
from behaviors.machine import from_mover, on
from behaviors.search import SEARCHING, Search, SearchFactors, SearchSettings
from behaviors.sonic import COMING_IN, CONTACTS, GOING_OUT, Place
from drivers.core.settings import Mismatch, Settings


class GraspSettings(SearchSettings, LiftSettings):
    """How an object is sought, gripped and lifted."""

    center: bool = True
    """Whether the middle is sought; else the jaws close where the start pose is."""

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """The middle is found on the approach axis, and lifted from as a place in the base frame."""
        yield from super().mismatches(path, profile)
        if self.center:
            yield from self.axis_mismatches(profile)


class Grasp(Search, Lifting):
    """A whole grasp, joined from its fragments.

    Args:
        detectors: As of `Search`, and those of slip that the settings name.
    """

    table = (
        *COMING_IN,
        on("deadline", "BASELINE", "RESTING", lambda it: not it.settings.center, label="no centering"),
        *SEARCHING,
        on("reached", "CENTERING", "RESTING", from_mover),
        *gripping(felt="LOADING"),
        *LIFTING,
        *GOING_OUT,
    )
    settings: GraspSettings

    def __init__(self, settings: GraspSettings, factors: SearchFactors, detectors: frozenset[str]) -> None:
        # from the rest on, where they learn
        feeling = detectors & CONTACTS | frozenset(settings.slip) | frozenset(settings.load)
        plans = {
            **gripping_plans(settings, feeling, settings.envelopes | {settings.force_stream}),
            **lifting_plans(settings, detectors & CONTACTS, settings.envelopes),
        }
        acting = frozenset(settings.slip) | frozenset(settings.load)
        super().__init__(settings, factors, detectors, plans, acting)

    @property
    def widest_m(self) -> float:
        """See `Search.widest_m`; unknown where nothing was sought."""
        return super().widest_m if self.settings.center else math.inf

    @property
    def _found_m(self) -> Place:
        return (self.middle_m if self.settings.center else 0.0, 0.0, 0.0)
