"""Find an object between two fingers by its aura, go to its middle: a part of a trial (Rupavatharam et al., III.D)."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from pydantic import Field

from behaviors.events import PreTouch
from behaviors.machine import Row, StatePlan, concluding, from_mover, on
from behaviors.sonic import CONTACTS, Place, SonicBehavior, SonicSettings
from drivers.core.messages import MoveAt, MoveTo, Standstill, Stop, Twist
from drivers.core.settings import Settings, StreamName

HALF_TURN_RAD = math.radians(178.0)
"""Half a turn of the wrist, but for two degrees: so the shortest way back is the way it came, and winds up no cable."""

NOWHERE: Place = (0.0, 0.0, 0.0)
"""The start pose: no displacement from it."""


class SearchSettings(SonicSettings):
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

    sweep_m: float = Field(default=0.017, gt=0.0, le=0.5)
    """Farthest search to either side of the start pose."""

    run_up: bool = False
    """Whether the detectors of method `ours` get a long way before they report: the right finger goes to the object
    first, and its result is discarded. A wave that is fitted with a memory along the way has a size that depends
    a little on how long the way was; with this both ways that count are as long as the room between the places."""

    blind_m: float = Field(default=0.0045, ge=0.0, le=0.1)
    """Contact is ignored over this distance after a motion of the search begins: a mover that starts or has just
    stopped changes the level as a touch does. Chosen on simulated searches (benchmarks/centering): of these false
    alarms none came after more than 3.5 mm. The guard's limits apply nevertheless."""

    half_turn: bool = False
    """Whether the wrist then turns by half a turn in the middle, and all is searched again: fingers that differ put
    their middle as far to the other side, and the mean of both is the object's. The limits must allow the turn."""

    turn_rad_s: float = Field(default=1.25, gt=0.0, le=3.0)
    """How fast the wrist turns. Assumption: half of what a wrist may."""

    @property
    def envelopes(self) -> frozenset[str]:
        """Both fingers' envelopes and the mover's position: what is measured."""
        return frozenset((self.left_stream, self.right_stream, self.position_stream))


class SearchFactors(Settings):
    """What a trial varies."""

    method: Literal["paper", "ours"] = "ours"
    """Method whose detectors decide: those named `left_METHOD` and `right_METHOD`."""

    speed_m_s: float = Field(default=0.01, gt=0.0, le=1.0)
    """Speed of the search (Fig. 4d: 0.01 and 0.03 m/s)."""

    object: str = "pipe"
    """What is between the fingers."""

    object_x_m: float = Field(default=0.0, ge=-0.1, le=0.1)
    """True position of its middle on the mover's axis, measured by hand on a real bench. The behavior does not use
    it."""


_SEEKING = ("RUNNING_UP", "SEEKING_FORWARD", "SEEKING_BACKWARD")
_TURNING = ("REVERSING", "TURNING")


class Search(SonicBehavior):
    """Search one way until the finger ahead of the motion sees the object, then the other way; go to the middle.

    Where a finger saw it is the mover's position in its detector's event, or, of a detector that subscribes to no
    encoder, where the mover came to stand. Contact during the search ends it; a touch that stands lets none begin.

    Args:
        detectors: Names of all detectors: `left_METHOD`, `right_METHOD`, `left_contact`, `right_contact`.
        acting: Detectors that the behavior's other states act on.
    """

    settings: SearchSettings

    def __init__(
        self,
        settings: SearchSettings,
        factors: SearchFactors,
        detectors: frozenset[str],
        plans: Mapping[str, StatePlan],
        acting: frozenset[str] = frozenset(),
    ) -> None:
        self.factors = factors
        self._saw: dict[str, float] = {}
        self._first_m: float | None = None
        self._begun_s = math.nan
        self._turned = self._turning_back = False
        self._face(turned=False)
        contact = detectors & CONTACTS
        seeking = frozenset((self._forward, self._backward)) | contact
        seen = settings.envelopes
        motion, search = settings.motion_timeout_s, 2.0 * settings.sweep_m / factors.speed_m_s
        search_plan = StatePlan(search + motion, seeking, seen)
        # A turn names no finder, so that the way back is searched afresh.
        turn_plan = StatePlan(motion, contact, seen)
        # Contact is not evaluated either: after a hard stop the contact detectors begin anew, at rest in the middle.
        numb_plan = StatePlan(motion, frozenset(), seen)
        own = {"BASELINE": StatePlan(settings.baseline_s, seeking, seen, prompt=False)}
        own |= dict.fromkeys(("RUNNING_UP", "SEEKING_FORWARD", "SEEKING_BACKWARD"), search_plan)
        own |= dict.fromkeys(("REVERSING", "TURNING"), turn_plan)
        own |= dict.fromkeys(("STOPPING", "CENTERING", "HALF_TURN"), numb_plan)
        if settings.half_turn:
            # after a pause or an error the wrist turns back with whatever way is made, as many rad/s as m/s
            back = StatePlan(motion + HALF_TURN_RAD / settings.handling_speed_m_s)
            own |= dict.fromkeys(("CLEARING", "ENTERING", "LEAVING"), back)
        super().__init__(settings, NOWHERE, contact, own | dict(plans), acting | seeking)

    @property
    def deciding(self) -> Sequence[str]:
        """The finger ahead of the motion first."""
        ahead = self._forward if self.state == "SEEKING_FORWARD" else self._backward
        return sorted(super().deciding, key=lambda name: name != ahead)

    @property
    def middle_m(self) -> float:
        """Middle of the two places at which a finger saw the object; after half a turn the mean of both middles."""
        middle_m = 0.5 * (self._saw["forward"] + self._saw["backward"])
        return middle_m if self._first_m is None else 0.5 * (self._first_m + middle_m)

    @property
    def widest_m(self) -> float:
        """Widest that the object can be: each finger came so far without touching it."""
        return self._opening_m - (self._saw["forward"] - self._saw["backward"])

    def by_forward(self) -> bool:
        """Whether the finger that goes ahead forward saw it: the left one until the wrist has turned."""
        return self.came_from(self._forward)

    def by_backward(self) -> bool:
        """Whether the other one did."""
        return self.came_from(self._backward)

    def to_turn(self) -> bool:
        """Whether the wrist is to turn, and all to be searched again."""
        return self.settings.half_turn and self._first_m is None

    def running_up(self) -> bool:
        """Whether the result of the first way is discarded."""
        return self.settings.run_up and self.factors.method == "ours"

    def under_way(self) -> bool:
        """Whether the motion began long enough ago for a contact to be one."""
        return self.event.t_s >= self._entered_s + self.settings.blind_m / self.factors.speed_m_s

    def conclude_unseen(self) -> None:
        """The sweep ended before the finger ahead saw anything."""
        finger = (self._forward if self.state == "SEEKING_FORWARD" else self._backward).split("_")[0]
        self.conclude("not_found", f"the {finger} finger saw nothing within {self.settings.sweep_m:.6g} m")

    def enter_ENTERING(self) -> None:
        """The fingers to either side of the object, which has been seen nowhere yet."""
        self._saw.clear()
        self._first_m, self._begun_s, self._turning_back = None, math.nan, False
        self.notes.pop("turned_s", None)
        self._face(turned=False)
        super().enter_ENTERING()

    def enter_RUNNING_UP(self) -> None:
        """The right finger towards the object."""
        self._seek(-1.0)

    def enter_REVERSING(self) -> None:
        """Stop at once."""
        self.command(Stop(self.settings.mover))

    enter_BACKING_OFF = enter_REVERSING

    def enter_SEEKING_FORWARD(self) -> None:
        """The left finger towards the object."""
        self._seek(1.0)

    def enter_TURNING(self) -> None:
        """Remember, stop."""
        self._remember("forward")

    def enter_SEEKING_BACKWARD(self) -> None:
        """The right finger towards the object."""
        self._stood_still("forward")
        self._seek(-1.0)

    def enter_STOPPING(self) -> None:
        """Remember, stop."""
        self._remember("backward")

    def enter_CENTERING(self) -> None:
        """To the middle."""
        self._stood_still("backward")
        settings = self.settings
        self.command(MoveTo(settings.mover, self.middle_m, min(self.factors.speed_m_s, 0.01)))

    def enter_HALF_TURN(self) -> None:
        """Each finger to where the other was; after the second search back, for the arm goes to places as it began."""
        if self._turned:
            self._stood_still("backward")
            self._turn_back()
            return
        if self.settings.half_turn:  # a rehearsal enters each state
            self._turn_wrist(self.settings.turn_rad_s)
        self._first_m = self.middle_m
        self.notes["turned_s"] = [self._begun_s, self._entered_s]
        self._face(turned=True)
        self._saw.clear()

    def enter_LEAVING(self) -> None:
        """Turn back, if turned; then up and away."""
        if not self._turned:
            self._turning_back = False
            super().enter_LEAVING()
            return
        self.conclude("no_contact")
        self._turn_back()

    def _face(self, turned: bool) -> None:
        """Which finger goes ahead forward and which backward."""
        method = self.factors.method
        self._turned, self._forward, self._backward = turned, f"left_{method}", f"right_{method}"
        if turned:
            self._forward, self._backward = self._backward, self._forward

    def _turn_back(self) -> None:
        self._turning_back = True
        self._face(turned=False)
        self._turn_wrist(-self.settings.turn_rad_s)

    def _turn_wrist(self, rad_s: float) -> None:
        self.command(Twist(self.settings.mover, (0.0, 0.0, 0.0, 0.0, 0.0, rad_s), HALF_TURN_RAD / abs(rad_s)))

    def _seek(self, direction: float) -> None:
        settings = self.settings
        if math.isnan(self._begun_s):
            self._begun_s = self._entered_s
        limit_m = direction * settings.sweep_m
        self.command(MoveAt(settings.mover, direction * self.factors.speed_m_s, limit_m))

    def _remember(self, way: Literal["forward", "backward"]) -> None:
        assert isinstance(self.event, PreTouch)
        self._saw[way] = self.event.position_m
        self.command(Stop(self.settings.mover))

    def _stood_still(self, way: Literal["forward", "backward"]) -> None:
        if math.isnan(self._saw[way]) and isinstance(self.event, Standstill):
            self._saw[way] = self.event.position_m


_touched = concluding("touched", "touched during the search")

SEARCHING: Sequence[Row] = (
    on("deadline", "BASELINE", "RUNNING_UP", Search.running_up, label="run-up"),
    on("deadline", "BASELINE", "SEEKING_FORWARD"),
    on("pre_touch", "RUNNING_UP", "REVERSING", Search.by_backward, label="right finger"),
    on("standstill", _TURNING, "LEAVING", from_mover, Search.touch_held, do=_touched, label="a touch stands"),
    on("standstill", "REVERSING", "SEEKING_FORWARD", from_mover),
    on("pre_touch", "SEEKING_FORWARD", "TURNING", Search.by_forward, label="left finger"),
    on("reached", _SEEKING, "LEAVING", from_mover, do=Search.conclude_unseen, label="not seen"),
    on("contact", _SEEKING, "BACKING_OFF", Search.under_way, do=_touched),
    on("contact_held", _SEEKING, "BACKING_OFF", do=_touched, label="a touch that began while ignored"),
    on("standstill", "TURNING", "SEEKING_BACKWARD", from_mover),
    on("pre_touch", "SEEKING_BACKWARD", "STOPPING", Search.by_backward, label="right finger"),
    on("standstill", "STOPPING", "HALF_TURN", from_mover, lambda it: it._turned, label="turned"),
    on("standstill", "STOPPING", "CENTERING", from_mover),
    on("reached", "CENTERING", "HALF_TURN", from_mover, Search.to_turn, label="to turn"),
    on("reached", "HALF_TURN", "CENTERING", from_mover, lambda it: it._turning_back, label="turned back"),
    on("reached", "HALF_TURN", "BASELINE", from_mover),
    on("reached", "LEAVING", "LEAVING", from_mover, lambda it: it._turning_back, label="turned back"),
    on("standstill", "BACKING_OFF", "LEAVING", from_mover),
    on("resumed", ["BASELINE", *_SEEKING, *_TURNING, "STOPPING", "CENTERING", "HALF_TURN"], "ENTERING"),
    on("resumed", "BACKING_OFF", "LEAVING"),
)
"""Rows from the rest that `COMING_IN` ends in to `CENTERING`; the behavior adds what follows. A search that sees
nothing, or touches something, leaves; a pause begins it anew."""
