"""Lift what the jaws hold, hold it against slip, set it down again: a part of a trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import Field, Strict

from behaviors.events import SlipStarted
from behaviors.grip import Gripping, GripSettings
from behaviors.machine import Row, StatePlan, on
from behaviors.sonic import Place
from drivers.messages import Grip, Gripped
from drivers.settings import DetectorName, StreamName

_UP = ("LIFTING", "HOLDING")

LIFTING: Sequence[Row] = (
    on("reached", "LIFTING", "HOLDING", "from_mover"),
    on("slip_started", _UP, None, "may_tighten", do="tighten", label="press harder"),
    on("slip_ended", _UP, None, do="note_held"),
    on("gripped", _UP, None, "slips_on", do="tighten", label="slips on: press harder still"),
    on("gripped", _UP, "LOWERING", "dropped", do="conclude_dropped", label="nothing between the jaws"),
    on("deadline", "HOLDING", "LOWERING", do="conclude_held"),
    on("reached", "LOWERING", "RELEASING", "from_mover"),
    on("resumed", (*_UP, "LOWERING"), "LOWERING", do="conclude_broken_off"),
)
"""Rows from the first contact felt at the object to its release, at the place where it was found."""


class LiftSettings(GripSettings):
    """How an object is lifted and held."""

    pose_stream: StreamName = "arm.pose"
    """Where the tool is (m and rad, base frame)."""

    lift_m: float = Field(default=0.02, gt=0.0, le=0.5)
    """How far up."""

    lift_speed_m_s: float = Field(default=0.01, gt=0.0, le=0.25)
    """Speed of lifting and setting down. Assumption: slow enough that its jerk moves nothing in the fingers."""

    slip: Annotated[tuple[DetectorName, ...], Strict(False)] = ()
    """Detectors of slip between finger and object; each slip makes the jaws press harder."""

    tighten_n: float = Field(default=2.0, gt=0.0, le=100.0)
    """By how much more. Assumption: a fifth of the grip."""

    tightest_n: float = Field(default=14.0, gt=0.0, le=500.0)
    """How hard at the most; the guard's `grip_n` holds besides."""


def lifting_plans(
    settings: LiftSettings, feeling: frozenset[str], measures: frozenset[str]
) -> Mapping[str, StatePlan]:
    """What these states need: the detectors of contact and of slip, and what is measured."""
    held = StatePlan(
        settings.lift_m / settings.lift_speed_m_s + settings.motion_timeout_s,
        feeling,
        measures | {settings.width_stream, settings.pose_stream},
    )
    return {
        "LIFTING": held,
        "HOLDING": StatePlan(settings.hold_s, held.detectors, held.measures),
        "LOWERING": held,
    }


class Lifting(Gripping):
    """What `LIFTING` asks and commands."""

    settings: LiftSettings
    _force_n = 0.0
    _slipping = False

    # conditions

    def may_tighten(self) -> bool:
        """Whether the jaws can press harder still."""
        return isinstance(self.event, SlipStarted) and self._force_n < self.settings.tightest_n

    def slips_on(self) -> bool:
        """Whether the jaws press as hard as commanded, and what they hold still slips."""
        return self._slipping and not self.dropped() and self._force_n < self.settings.tightest_n

    def dropped(self) -> bool:
        """Whether the jaws report that they hold nothing."""
        return isinstance(self.event, Gripped) and not self.event.object

    # before transitions

    def tighten(self) -> None:
        """Press harder, to the same opening."""
        settings, self._slipping = self.settings, True
        self._force_n = min(self._force_n + settings.tighten_n, settings.tightest_n)
        self.command(Grip(settings.gripper, settings.grip_width_m, settings.grip_speed_m_s, self._force_n))

    def note_held(self) -> None:
        """The slip is over."""
        self._slipping = False

    def conclude_dropped(self) -> None:
        """The jaws lost what they held."""
        self.conclude("no_contact", f"the object was lost in {self.state}")

    def conclude_held(self) -> None:
        """Held for as long as was asked for, if both fingers still feel it."""
        if self.both_touch():
            self.conclude("contact")
        else:
            self.conclude_dropped()

    # what is commanded on entry

    def enter_LIFTING(self) -> None:
        """Straight up from where it was found."""
        self._force_n = self.settings.grip_force_n
        x_m, y_m, z_m = self._found_m
        self._go((x_m, y_m, z_m + self.settings.lift_m), self.settings.lift_speed_m_s)

    def enter_LOWERING(self) -> None:
        """Down to where it stood."""
        self._go(self._found_m, self.settings.lift_speed_m_s)

    @property
    def _found_m(self) -> Place:
        """Where the object was gripped."""
        return self._place_m
