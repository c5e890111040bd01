"""A parallel gripper's jaws on their brackets, and what is between them: mass, friction, end stops, compliance."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from drivers.can_gripper.units import STROKE_M
from drivers.core.settings import Settings
from simulator.physics import jaws_kernel as kernel

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

    def fits(self, name: str) -> bool:
        """Whether the jaws on these brackets close on an object at all."""
        try:
            self.check(name)
        except ValueError:
            return False
        return True


def _number(place: int) -> Any:
    """A property that is kept in the state."""

    def get(self: Jaws) -> float:
        return float(self.x[place])

    def put(self: Jaws, value: float) -> None:
        self.x[place] = value

    return property(get, put)


class Jaws:
    """Two jaws in sync, as one mass at their opening; how they move: `jaws_kernel`.

    Attributes:
        x: State, as the kernel has it; the drive's numbers are there as well.
        flags: The same of what is counted.
        width_m: Opening.
        rate_m_s: Its rate; positive opens.
    """

    width_m: float = _number(kernel.WIDTH)
    rate_m_s: float = _number(kernel.RATE)

    def __init__(self, settings: JawsSettings) -> None:
        self.settings = settings
        self.x = np.zeros(kernel.NUMBERS)
        self.flags = np.zeros(kernel.FLAGS, dtype=np.int64)
        closed_m, open_m = settings.closed_width_m, settings.closed_width_m + STROKE_M
        start_m = open_m if settings.start_width_m is None else settings.start_width_m
        self.x[[kernel.CLOSED_M, kernel.OPEN_M]] = closed_m, open_m
        self.x[[kernel.MASS, kernel.FRICTION]] = settings.mass_kg, settings.friction_n
        self.width_m = min(max(start_m, closed_m), open_m)
        self.place(settings.object)

    @property
    def contact_n(self) -> float:
        """How hard the jaws press on what is between them; compression is positive."""
        return float(kernel.contact_n(self.x, self.flags))

    def place(self, name: str | None) -> None:
        """Put an object between the jaws, or take away what is there.

        Raises:
            ValueError: it is not in the scene, does not fit, or the jaws are not open wide enough.
        """
        self.settings.check(name)
        self.flags[kernel.PRESENT] = False
        if name is None:
            return
        thing = self.settings.objects[name]
        if self.width_m < thing.width_m:
            raise ValueError(
                f"{name} is {thing.width_m * 1e3:g} mm wide and the jaws are open {self.width_m * 1e3:.1f} mm:"
                " open them first"
            )
        self.show(name)
        self.flags[kernel.PRESENT] = True

    def show(self, name: str) -> None:
        """Let this object be the one that the jaws may meet."""
        thing = self.settings.objects[name]
        places = [kernel.THING, kernel.STIFFNESS, kernel.DAMPING]
        self.x[places] = thing.width_m, thing.stiffness_n_m, thing.damping_n_s_m
