"""What the aura is shown: the paper's pipe and six objects, and two soft ones.

The paper prints the pipe's size (1.905 cm thick, 25.4 cm long; Rupavatharam et al., IV.A) and the names of the six
objects (IV.B, Fig. 8a). Every other number here is an assumption: sizes are such that our gripper's stroke of 48 mm
takes them all on one pair of brackets, which that of the paper's objects may not; acoustic properties are ordinary
ones of the materials.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import Field

from drivers.settings import Settings

Side = Literal["normal", "back", "front", "top", "bottom"]
"""Sides of a finger (Fig. 3)."""

SIDES: tuple[Side, ...] = ("normal", "back", "front", "top", "bottom")

NOTHING = "none"
"""Name of the object that is not there."""


class AuraObject(Settings):
    """Something that stands upright in front of a finger, or between two."""

    width_m: float = Field(gt=0.0, le=0.2)
    """Along x, on which the jaws close."""

    depth_m: float = Field(gt=0.0, le=0.5)
    """Along y, across the finger."""

    height_m: float = Field(gt=0.0, le=0.5)
    """Along z, lengthwise of the finger."""

    radius_m: float = Field(gt=0.0, le=10.0)
    """Radius of curvature of what faces the finger; a flat face has a large one."""

    absorption: float = Field(ge=0.0, le=1.0)
    """Share of the sound's power at 40 kHz that stays in it."""

    coupling: float = Field(ge=0.0, le=1.0)
    """How much it loads a finger that it touches, as a share of what a rigid body does."""

    stiffness_n_m: float = Field(default=2e4, gt=0.0, le=1e6)
    """Force for each metre by which the jaws squeeze it (as `drivers.mock.physics.jaws.GripObject`)."""

    @property
    def reflectivity(self) -> float:
        """Sound pressure that comes back from a flat piece of it, as a share of what arrived."""
        return float((1.0 - self.absorption) ** 0.5)


FLAT_M = 10.0
"""Radius of what is flat."""

OBJECTS: Mapping[str, AuraObject] = {
    "pipe": AuraObject(
        width_m=0.01905, depth_m=0.01905, height_m=0.254, radius_m=0.009525, absorption=0.02, coupling=1.0
    ),
    "mug": AuraObject(
        width_m=0.044, depth_m=0.044, height_m=0.09, radius_m=0.022, absorption=0.01, coupling=1.0
    ),
    "hand_sanitizer": AuraObject(
        width_m=0.034, depth_m=0.05, height_m=0.12, radius_m=0.05, absorption=0.03, coupling=0.9
    ),
    "transparent_plastic": AuraObject(
        width_m=0.03, depth_m=0.06, height_m=0.09, radius_m=FLAT_M, absorption=0.03, coupling=0.8
    ),
    "notebook": AuraObject(
        width_m=0.018, depth_m=0.09, height_m=0.14, radius_m=FLAT_M, absorption=0.12, coupling=0.8
    ),
    "water_cup": AuraObject(
        width_m=0.044, depth_m=0.044, height_m=0.1, radius_m=0.022, absorption=0.05, coupling=0.7
    ),
    "paper_cylinder": AuraObject(
        width_m=0.04,
        depth_m=0.04,
        height_m=0.15,
        radius_m=0.02,
        absorption=0.15,
        coupling=0.5,
        stiffness_n_m=5e3,
    ),
    "sponge": AuraObject(
        width_m=0.03,
        depth_m=0.06,
        height_m=0.09,
        radius_m=FLAT_M,
        absorption=0.9,
        coupling=0.25,
        stiffness_n_m=2e3,
    ),
    "cloth": AuraObject(
        width_m=0.025,
        depth_m=0.08,
        height_m=0.08,
        radius_m=FLAT_M,
        absorption=0.8,
        coupling=0.2,
        stiffness_n_m=2e3,
    ),
}
"""By the names that trials use."""

SIX = ("mug", "hand_sanitizer", "transparent_plastic", "notebook", "water_cup", "paper_cylinder")
"""The objects of the paper's deployment (IV.B)."""

SOFT = ("sponge", "cloth")
"""Ours: "soft objects absorb sound making them relatively harder to detect" (IV.B.1)."""
