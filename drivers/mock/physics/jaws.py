"""A parallel gripper's jaws on their brackets, and what is between them: mass, friction, end stops, compliance."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from drivers.can_gripper.units import STROKE_M
from drivers.settings import Settings

TICK_S = 2e-4
"""Step of the integration: the period of the gripper's own loops (5 kHz, its interface page)."""

STIFFEST_N_M = 1e6
"""Stiffest object: beyond 4 m / TICK_S^2 the semi-implicit step is unstable; this is a tenth of it."""

CLEARANCE_M = 0.001
"""By how much an object must clear the open and the closed jaws, to be let in and to be held (assumption)."""


class GripObject(Settings):
    """Something that can stand between the jaws."""

    width_m: float = Field(gt=0.0, le=0.2)
    """Along the jaws' travel."""
    stiffness_n_m: float = Field(default=2e4, gt=0.0, le=STIFFEST_N_M)
    """Force for each metre by which the jaws squeeze it, finger pads included (assumption: 1 mm at 20 N)."""
    damping_n_s_m: float = Field(default=20.0, ge=0.0, le=200.0)
    """The same for each m/s (assumption: a fifth of critical with the jaws' mass)."""


class JawsSettings(Settings):
    """Jaws and scene."""

    closed_width_m: float = Field(default=0.008, ge=0.008, le=0.085 - STROKE_M)
    """Opening of the closed jaws, set by the brackets (the bench's page: openings of 8 to 85 mm)."""
    objects: dict[str, GripObject] = Field(default={})
    """What there is to grip, by name."""
    object: str | None = None
    """Which of them is between the jaws when a trial begins."""
    start_width_m: float | None = None
    """Where the jaws stand at power-up; None is fully open."""
    mass_kg: float = Field(default=0.1, gt=0.01, le=10.0)
    """What the motor moves, as seen at the opening. Assumption: rotor of 1e-5 kg m2 on a 6 mm pinion, jaws of 50 g."""
    friction_n: float = Field(default=0.5, ge=0.0, le=5.0)
    """Of racks and pinion, as seen at the opening (assumption: a tenth of the least grip, 5 N)."""

    @model_validator(mode="after")
    def _object_fits(self) -> Self:
        self.check(self.object)
        return self

    def check(self, name: str | None) -> None:
        """See whether an object can be gripped.

        Raises:
            ValueError: it is not in the scene, or does not fit between the jaws on these brackets.
        """
        if name is None:
            return
        if name not in self.objects:
            raise ValueError(
                f"there is no object {name!r}; there is: {', '.join(sorted(self.objects)) or 'none'}"
            )
        width_m = self.objects[name].width_m
        lowest_m, highest_m = self.closed_width_m + CLEARANCE_M, self.closed_width_m + STROKE_M - CLEARANCE_M
        if not lowest_m <= width_m <= highest_m:
            raise ValueError(
                f"{name} is {width_m * 1e3:g} mm wide and does not fit: on these brackets the jaws hold"
                f" {lowest_m * 1e3:g} to {highest_m * 1e3:g} mm; choose closed_width_m to suit"
            )


class Jaws:
    """Two jaws in sync, as one mass at their opening.

    Semi-implicit Euler; dry friction takes speed away and never turns it round, so that the jaws come to rest
    to the last bit. The end stops are rigid and swallow every impact.

    Args:
        settings: Of jaws and scene.

    Attributes:
        width_m: Opening.
        rate_m_s: Its rate; positive opens.
        jammed: True where nothing moves them.
    """

    def __init__(self, settings: JawsSettings) -> None:
        self.settings = settings
        self._closed_m = settings.closed_width_m
        self._open_m = settings.closed_width_m + STROKE_M
        self._object: GripObject | None = None
        start_m = self._open_m if settings.start_width_m is None else settings.start_width_m
        self.width_m = min(max(start_m, self._closed_m), self._open_m)
        self.rate_m_s = 0.0
        self.jammed = False
        self.place(settings.object)

    @property
    def contact_n(self) -> float:
        """How hard the jaws press on what is between them; compression is positive."""
        thing = self._object
        if thing is None or self.width_m >= thing.width_m:
            return 0.0
        squeezed_n = (
            thing.stiffness_n_m * (thing.width_m - self.width_m) - thing.damping_n_s_m * self.rate_m_s
        )
        return max(0.0, squeezed_n)

    def place(self, name: str | None) -> None:
        """Put an object between the jaws, or take away what is there.

        Raises:
            ValueError: it is not in the scene, does not fit, or the jaws are not open wide enough.
        """
        self.settings.check(name)
        thing = None if name is None else self.settings.objects[name]
        if thing is not None and self.width_m < thing.width_m:
            raise ValueError(
                f"{name} is {thing.width_m * 1e3:g} mm wide and the jaws are open {self.width_m * 1e3:.1f} mm:"
                " open them first"
            )
        self._object = thing

    def tick(self, drive_n: float) -> None:
        """Let `TICK_S` pass under a force of the drive; positive opens."""
        if self.jammed:
            self.rate_m_s = 0.0
            return
        settings = self.settings
        gain = TICK_S / settings.mass_kg
        rate_m_s = self.rate_m_s + gain * (drive_n + self.contact_n)
        held_m_s = gain * settings.friction_n
        rate_m_s = (
            0.0 if abs(rate_m_s) <= held_m_s else rate_m_s - held_m_s * (1.0 if rate_m_s > 0.0 else -1.0)
        )
        width_m = self.width_m + TICK_S * rate_m_s
        if not self._closed_m <= width_m <= self._open_m:
            width_m, rate_m_s = min(max(width_m, self._closed_m), self._open_m), 0.0
        self.width_m, self.rate_m_s = width_m, rate_m_s
