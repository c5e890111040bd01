"""What C3's trials are made of: how the middle is sought, and what a trial varies."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from behaviors.sonic import SonicSettings
from drivers.settings import Settings, StreamName


class CenteringSettings(SonicSettings):
    """How the middle is sought.

    The mover's approach axis is the line on which the jaws close. Going forward on it takes the left finger towards
    what is between the two, going backward the right one.
    """

    left_stream: StreamName = "signals.left"
    """Envelope of the left finger."""

    right_stream: StreamName = "signals.right"
    """Envelope of the right finger."""

    position_stream: StreamName = "arm.position"
    """Where the mover is (m)."""

    width_stream: StreamName = "gripper.width"
    """How far open the jaws are (m)."""

    sweep_m: float = Field(default=0.017, gt=0.0, le=0.5)
    """Farthest search to either side of the start pose."""

    run_up: bool = False
    """Whether the detectors of method `ours` get a long way before they speak: the right finger goes to the object
    first, and what it finds is thrown away. A wave that is fitted with a memory along the way has a size that depends
    a little on how long the way was; with this both ways that count are as long as the room between the places."""

    blind_s: float = Field(default=0.15, ge=0.0, le=10.0)
    """For so long after a motion of the search begins, contact is not heeded: a mover that has just been stopped or
    sets out changes the level as a touch does. Chosen on simulated searches (benchmarks/centering): none of these
    false alarms came later than 0.1 s. What the guard limits holds nevertheless."""

    grasp: bool = True
    """Close on the object, confirm contact and open again once the middle is found."""

    grip_width_m: float = Field(default=0.0, ge=0.0, le=0.2)
    """Opening to close to; what is between the jaws keeps them from it."""

    grip_speed_m_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """How fast the jaws close."""

    grip_force_n: float = Field(default=10.0, gt=0.0, le=500.0)
    """How hard they press."""

    confirm_s: float = Field(default=1.0, gt=0.0, le=60.0)
    """Longest wait, after the grip, for both fingers to feel the contact."""

    hold_s: float = Field(default=1.0, ge=0.0, le=600.0)
    """How long the object is held."""


class CenteringFactors(Settings):
    """What a trial varies."""

    method: Literal["paper", "ours"] = "ours"
    """Whose detectors are asked: those named `left_METHOD` and `right_METHOD`."""

    speed_m_s: float = Field(default=0.01, gt=0.0, le=1.0)
    """Speed of the search (Fig. 4d: 0.01 and 0.03 m/s)."""

    object: str = "pipe"
    """What is between the fingers."""

    object_x_m: float = Field(default=0.0, ge=-0.1, le=0.1)
    """Where its middle really is on the mover's axis, measured by hand on a real bench. The behavior does not look at
    it."""
