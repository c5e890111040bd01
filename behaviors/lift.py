"""Lift what the jaws hold, hold it against slip, set it down again: a part of a trial."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import Field, Strict

from behaviors.events import Event
from behaviors.grip import Gripping, GripSettings
from behaviors.machine import Row, StatePlan, from_mover, on
from behaviors.sonic import Place
from drivers.core.messages import Command, Grip, Gripped
from drivers.core.settings import DetectorName, StreamName

_UP = ("LIFTING", "HOLDING")


class LiftSettings(GripSettings):
    """How an object is lifted and held."""

    pose_stream: StreamName = "arm.pose"
    """Where the tool is (m and rad, base frame)."""

    lift_m: float = Field(default=0.02, gt=0.0, le=0.5)
    """How far up."""

    lift_speed_m_s: float = Field(default=0.01, gt=0.0, le=0.25)
    """Speed of lifting and setting down. Assumption: slow enough that its jerk moves nothing in the fingers."""

    force_stream: StreamName = "arm.force"
    """What the arm carries (N, third channel upwards)."""

    weight_n: float | None = Field(default=None, gt=0.0, le=1000.0)
    """What the object weighs, where somebody weighed it: on a real bench a lift is known by it to have succeeded."""

    take_up_m: float = Field(default=0.003, ge=0.0, le=0.1)
    """Length of the lift in which the pads take up the weight. The knock of that is no slip: one that begins here
    counts if it lasts to the end of it. Measured on the simulated pad with 0.05 and 0.2 kg: what the detector called
    slip in the take-up was over 0.22 s after the lift began, 2.2 mm at the default speed."""

    slip: Annotated[tuple[DetectorName, ...], Strict(False)] = ()
    """Detectors of slip between finger and object; each slip makes the jaws press harder."""

    tighten_n: float = Field(default=2.0, gt=0.0, le=100.0)
    """By how much more. Assumption: a fifth of the grip."""

    tighten_s: float = Field(default=0.25, gt=0.0, le=10.0)
    """How long a slip may go on after the jaws press as hard as commanded, before they press harder still. Longer than
    the detector takes to report its end: 0.1 s on the simulated pad."""

    tightest_n: float = Field(default=14.0, gt=0.0, le=500.0)
    """How hard at the most; the guard's `grip_n` holds besides."""


def lifting_plans(
    settings: LiftSettings, feeling: frozenset[str], measures: frozenset[str]
) -> Mapping[str, StatePlan]:
    """What these states need: the detectors of contact and of slip, and what is measured."""
    held = StatePlan(
        settings.lift_m / settings.lift_speed_m_s + settings.motion_timeout_s,
        feeling,
        measures | {settings.width_stream, settings.pose_stream, settings.force_stream},
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
    _slipping: frozenset[str] = frozenset()
    _taken_up_s = math.inf
    _tighten_due_s = math.inf

    @property
    def due_s(self) -> float:
        """When the jaws press harder, unless the slip is over by then."""
        return self._tighten_due_s if self._slipping and self.state in _UP else math.inf

    def handle(self, event: Event) -> Sequence[Command]:
        """Handle one event, and press harder where it is time."""
        commands = super().handle(event)
        if event.t_s < self.due_s - 1e-9:
            return commands
        return [*commands, *self._tightened()]

    @property
    def deciding(self) -> Sequence[str]:
        """In the air, what detects slip first."""
        up = self.state in _UP
        return sorted(super().deciding, key=lambda name: up != (name in self.settings.slip))

    def dropped(self) -> bool:
        """Whether the jaws report that they hold nothing."""
        return isinstance(self.event, Gripped) and not self.event.object

    def note_slip(self) -> None:
        """Something slips: at once, or once the weight is taken up, the jaws are to press harder."""
        if not self._slipping:
            self._tighten_due_s = max(self.event.t_s, self._taken_up_s)
        self._slipping |= {self._detector}

    def note_held(self) -> None:
        """The slip that a detector reported is over."""
        self._slipping -= {self._detector}

    def note_tight(self) -> None:
        """The jaws press as hard as commanded: the slip has its time to end."""
        self._tighten_due_s = max(self.event.t_s + self.settings.tighten_s, self._taken_up_s)

    @property
    def _detector(self) -> str:
        return str(getattr(self.event, "detector", ""))

    def _tightened(self) -> Sequence[Command]:
        """Press harder, to the same opening, if that is possible."""
        settings, self._tighten_due_s = self.settings, math.inf
        if self._force_n >= settings.tightest_n:
            return []
        self._force_n = min(self._force_n + settings.tighten_n, settings.tightest_n)
        return [Grip(settings.gripper, settings.grip_width_m, settings.grip_speed_m_s, self._force_n)]

    def conclude_dropped(self) -> None:
        """The jaws lost what they held."""
        self.conclude("dropped", f"the object was lost in {self.state}")

    def conclude_held(self) -> None:
        """Held for as long as was asked for, if both fingers still feel it."""
        if self.both_touch():
            self.conclude("held")
        else:
            self.conclude_dropped()

    def enter_LIFTING(self) -> None:
        """Straight up from where it was found."""
        self._force_n = self.settings.grip_force_n
        self._slipping, self._tighten_due_s = frozenset(), math.inf
        self._taken_up_s = self.event.t_s + self.settings.take_up_m / self.settings.lift_speed_m_s
        x_m, y_m, z_m = self._found_m
        self._go((x_m, y_m, z_m + self.settings.lift_m), self.settings.lift_speed_m_s)

    def enter_LOWERING(self) -> None:
        """Down to where it stood."""
        self._go(self._found_m, self.settings.lift_speed_m_s)

    @property
    def _found_m(self) -> Place:
        """Where the object was gripped."""
        return self._place_m


LIFTING: Sequence[Row] = (
    on("reached", "LIFTING", "HOLDING", from_mover),
    on("slip_started", _UP, None, do=Lifting.note_slip, label="press harder"),
    on("slip_ended", _UP, None, do=Lifting.note_held),
    on("gripped", _UP, "LOWERING", Lifting.dropped, do=Lifting.conclude_dropped, label="nothing held"),
    on("gripped", _UP, None, do=Lifting.note_tight, label="slips on: press harder still"),
    on("deadline", "HOLDING", "LOWERING", do=Lifting.conclude_held),
    on("reached", "LOWERING", "RELEASING", from_mover),
    on("resumed", (*_UP, "LOWERING"), "LOWERING", do=Lifting.conclude_broken_off),
)
"""Rows from the first contact felt at the object to its release, at the place where it was found."""
