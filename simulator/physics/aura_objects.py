"""What the aura is shown: the paper's pipe and six objects, and two soft ones.

The paper prints the pipe's size (1.905 cm thick, 25.4 cm long; Rupavatharam et al., IV.A) and the names of the six
objects (IV.B, Fig. 8a). Every other number here is an assumption: sizes are such that our gripper's stroke of 48 mm
takes them all on one pair of brackets, which that of the paper's objects may not; acoustic properties are ordinary
ones of the materials.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import Field

from drivers.core.settings import Settings

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
    """Force for each metre by which the jaws squeeze it (as `simulator.physics.jaws_drive.GripObject`)."""

    @property
    def reflectivity(self) -> float:
        """Sound pressure that comes back from a flat piece of it, as a share of what arrived."""
        return float((1.0 - self.absorption) ** 0.5)


OBJECTS: Mapping[str, AuraObject] = {
    name: AuraObject.model_validate(row)
    for name, row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items()
}
"""By the names that trials use."""

SIX = ("mug", "hand_sanitizer", "transparent_plastic", "notebook", "water_cup", "paper_cylinder")
"""The objects of the paper's deployment (IV.B)."""

SOFT = ("sponge", "cloth")
"""Ours: "soft objects absorb sound making them relatively harder to detect" (IV.B.1)."""
