"""Find an object between two fingers by its aura, go to its middle: a part of a trial (Rupavatharam et al., III.D)."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from pydantic import Field

from behaviors.events import PreTouch
from behaviors.machine import Row, StatePlan, from_mover, on
from behaviors.sonic import CONTACTS, Place, SonicBehavior, SonicSettings
from drivers.core.messages import MoveAt, MoveTo, Standstill, Stop
from drivers.core.settings import Settings, StreamName

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
        self._left, self._right = f"left_{factors.method}", f"right_{factors.method}"
        self._saw: dict[str, float] = {}
        contact = detectors & CONTACTS
        seeking = frozenset((self._left, self._right)) | contact
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
        own |= dict.fromkeys(("STOPPING", "CENTERING"), numb_plan)
        super().__init__(settings, NOWHERE, contact, own | dict(plans), acting | seeking)

    @property
    def deciding(self) -> Sequence[str]:
        """The finger ahead of the motion first."""
        ahead = self._left if self.state == "SEEKING_FORWARD" else self._right
        return sorted(super().deciding, key=lambda name: name != ahead)

    @property
    def middle_m(self) -> float:
        """Middle of the two places at which a finger saw the object."""
        return 0.5 * (self._saw[self._left] + self._saw[self._right])

    @property
    def widest_m(self) -> float:
        """Widest that the object can be: each finger came so far without touching it."""
        return self._opening_m - (self._saw[self._left] - self._saw[self._right])

    def by_left(self) -> bool:
        """Whether the left finger saw it."""
        return self.came_from(self._left)

    def by_right(self) -> bool:
        """Whether the right finger saw it."""
        return self.came_from(self._right)

    def running_up(self) -> bool:
        """Whether the result of the first way is discarded."""
        return self.settings.run_up and self.factors.method == "ours"

    def under_way(self) -> bool:
        """Whether the motion began long enough ago for a contact to be one."""
        return self.event.t_s >= self._entered_s + self.settings.blind_m / self.factors.speed_m_s

    def conclude_unseen(self) -> None:
        """The sweep ended before the finger ahead saw anything."""
        finger = "left" if self.state == "SEEKING_FORWARD" else "right"
        self.conclude("not_found", f"the {finger} finger saw nothing within {self.settings.sweep_m:.6g} m")

    def conclude_touched(self) -> None:
        """The search touched what it should have seen."""
        self.conclude("touched", "touched during the search")

    def enter_ENTERING(self) -> None:
        """The fingers to either side of the object, which has been seen nowhere yet."""
        self._saw.clear()
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
        self._remember(self._left)

    def enter_SEEKING_BACKWARD(self) -> None:
        """The right finger towards the object."""
        self._stood_still(self._left)
        self._seek(-1.0)

    def enter_STOPPING(self) -> None:
        """Remember, stop."""
        self._remember(self._right)

    def enter_CENTERING(self) -> None:
        """To the middle."""
        self._stood_still(self._right)
        settings = self.settings
        self.command(MoveTo(settings.mover, self.middle_m, min(self.factors.speed_m_s, 0.01)))

    def _seek(self, direction: float) -> None:
        settings = self.settings
        limit_m = direction * settings.sweep_m
        self.command(MoveAt(settings.mover, direction * self.factors.speed_m_s, limit_m))

    def _remember(self, finger: str) -> None:
        assert isinstance(self.event, PreTouch)
        self._saw[finger] = self.event.position_m
        self.command(Stop(self.settings.mover))

    def _stood_still(self, finger: str) -> None:
        if math.isnan(self._saw[finger]) and isinstance(self.event, Standstill):
            self._saw[finger] = self.event.position_m


_touched = Search.conclude_touched

SEARCHING: Sequence[Row] = (
    on("deadline", "BASELINE", "RUNNING_UP", Search.running_up, label="run-up"),
    on("deadline", "BASELINE", "SEEKING_FORWARD"),
    on("pre_touch", "RUNNING_UP", "REVERSING", Search.by_right, label="right finger"),
    on("standstill", _TURNING, "LEAVING", from_mover, Search.touch_held, do=_touched, label="a touch stands"),
    on("standstill", "REVERSING", "SEEKING_FORWARD", from_mover),
    on("pre_touch", "SEEKING_FORWARD", "TURNING", Search.by_left, label="left finger"),
    on("reached", _SEEKING, "LEAVING", from_mover, do=Search.conclude_unseen, label="not seen"),
    on("contact", _SEEKING, "BACKING_OFF", Search.under_way, do=_touched),
    on("contact_held", _SEEKING, "BACKING_OFF", do=_touched, label="a touch that began while ignored"),
    on("standstill", "TURNING", "SEEKING_BACKWARD", from_mover),
    on("pre_touch", "SEEKING_BACKWARD", "STOPPING", Search.by_right, label="right finger"),
    on("standstill", "STOPPING", "CENTERING", from_mover),
    on("standstill", "BACKING_OFF", "LEAVING", from_mover),
    on("resumed", ["BASELINE", *_SEEKING, *_TURNING, "STOPPING", "CENTERING"], "ENTERING"),
    on("resumed", "BACKING_OFF", "LEAVING"),
)
"""Rows from the rest that `COMING_IN` ends in to `CENTERING`; the behavior adds what follows. A search that sees
nothing, or touches something, leaves; a pause begins it anew."""
