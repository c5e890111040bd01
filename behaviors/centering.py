"""C3: find an object between two fingers by its aura, go to the middle, close (Rupavatharam et al., III.D, IV.A.2)."""

from __future__ import annotations

import math
from enum import Enum, auto

from behaviors.centering_settings import CenteringFactors, CenteringSettings
from behaviors.events import Detected, PreTouch
from behaviors.machine import StatePlan, on, with_failures
from behaviors.sonic import Place, SonicBehavior, coming_in, going_out
from drivers.messages import Grip, Gripped, MoveAt, MoveTo, Release, Standstill, Stop

NOWHERE: Place = (0.0, 0.0, 0.0)
"""The start pose: no displacement from it."""

CONTACTS = frozenset({"left_contact", "right_contact"})
"""Detectors that feel a touch, one at each finger."""


class Centering(SonicBehavior):
    """Search one way until the finger ahead of the motion sees the object, then the other way; go to the middle.

    Where a finger saw it is what its detector says of the mover's position; a detector that hears no encoder leaves it
    to where the mover came to stand. Contact during the search ends it; a touch that stands before it lets none begin.

    Args:
        settings: Of the experiment.
        factors: Of the trial.
        detectors: Names of all detectors: `left_METHOD`, `right_METHOD`, `left_contact`, `right_contact`.
    """

    class States(Enum):
        """Where the trial is."""

        CLEARING = auto()
        CALIBRATING = auto()
        OPENING = auto()
        ENTERING = auto()
        BASELINE = auto()
        RUNNING_UP = auto()
        REVERSING = auto()
        SEEKING_FORWARD = auto()
        TURNING = auto()
        SEEKING_BACKWARD = auto()
        STOPPING = auto()
        CENTERING = auto()
        RESTING = auto()
        CLOSING = auto()
        CONFIRMING = auto()
        HOLDING = auto()
        RELEASING = auto()
        BACKING_OFF = auto()
        LEAVING = auto()
        DONE = auto()
        FAILED = auto()

    initial = States.CLEARING
    final = frozenset({States.DONE, States.FAILED})
    _seeking = (States.RUNNING_UP, States.SEEKING_FORWARD, States.SEEKING_BACKWARD)
    _turning = (States.REVERSING, States.TURNING)
    table = with_failures(
        States,
        *coming_in(States),
        on("deadline", States.BASELINE, States.RUNNING_UP, "running_up", label="run-up"),
        on("deadline", States.BASELINE, States.SEEKING_FORWARD),
        on("pre_touch", States.RUNNING_UP, States.REVERSING, "by_right", label="right finger"),
        on(
            "standstill",
            list(_turning),
            States.LEAVING,
            ["from_mover", "touch_held"],
            do="conclude_touched",
            label="a touch stands",
        ),
        on("standstill", States.REVERSING, States.SEEKING_FORWARD, "from_mover"),
        on("pre_touch", States.SEEKING_FORWARD, States.TURNING, "by_left", label="left finger"),
        on("reached", list(_seeking), States.LEAVING, "from_mover", do="conclude_unseen", label="not seen"),
        on("contact", list(_seeking), States.BACKING_OFF, "under_way", do="conclude_touched"),
        on(
            "contact_held",
            list(_seeking),
            States.BACKING_OFF,
            do="conclude_touched",
            label="a touch while it was not heeded",
        ),
        on("standstill", States.TURNING, States.SEEKING_BACKWARD, "from_mover"),
        on("pre_touch", States.SEEKING_BACKWARD, States.STOPPING, "by_right", label="right finger"),
        on("standstill", States.STOPPING, States.CENTERING, "from_mover"),
        on("reached", States.CENTERING, States.RESTING, ["from_mover", "grasping"], label="to grasp"),
        on("reached", States.CENTERING, States.LEAVING, "from_mover"),
        on("deadline", States.RESTING, States.CLOSING),
        on(
            "gripped", States.CLOSING, States.HOLDING, ["on_object", "both_touch"], label="both fingers touch"
        ),
        on("gripped", States.CLOSING, States.CONFIRMING, "on_object", label="object"),
        on("gripped", States.CLOSING, States.RELEASING, do="conclude_empty", label="nothing there"),
        on("contact", States.CONFIRMING, States.HOLDING, "both_touch", label="both fingers touch"),
        on("deadline", States.CONFIRMING, States.RELEASING, do="conclude_unfelt"),
        on("deadline", States.HOLDING, States.RELEASING),
        on("reached", States.RELEASING, States.LEAVING, "from_gripper"),
        on("standstill", States.BACKING_OFF, States.LEAVING, "from_mover"),
        on(
            "resumed",
            [
                *(States.BASELINE, *_seeking, *_turning),
                *(States.STOPPING, States.CENTERING, States.RESTING),
            ],
            States.ENTERING,
        ),
        on("resumed", [States.CLOSING, States.CONFIRMING], States.RELEASING, do="conclude_broken_off"),
        on("resumed", [States.HOLDING, States.RELEASING], States.RELEASING),
        on("resumed", States.BACKING_OFF, States.LEAVING),
        *going_out(States),
    )
    settings: CenteringSettings

    def __init__(
        self, settings: CenteringSettings, factors: CenteringFactors, detectors: frozenset[str]
    ) -> None:
        states = self.States
        self.factors = factors
        self._left, self._right = f"left_{factors.method}", f"right_{factors.method}"
        self._saw: dict[str, float] = {}
        contact = detectors & CONTACTS
        seeking = frozenset((self._left, self._right)) | contact
        seen = frozenset((settings.left_stream, settings.right_stream, settings.position_stream))
        closed = seen | {settings.width_stream}
        motion, search = settings.motion_timeout_s, 2.0 * settings.sweep_m / factors.speed_m_s
        plans: dict[Enum, StatePlan] = dict.fromkeys(set(states) - self.final, StatePlan(motion))
        plans |= {
            states.BASELINE: StatePlan(settings.baseline_s, seeking, seen, prompt=False),
            states.RUNNING_UP: StatePlan(search + motion, seeking, seen),
            # Neither this nor the turn names a finder, so that the way back is searched afresh.
            states.REVERSING: StatePlan(motion, contact, seen),
            states.SEEKING_FORWARD: StatePlan(search + motion, seeking, seen),
            states.TURNING: StatePlan(motion, contact, seen),
            states.SEEKING_BACKWARD: StatePlan(search + motion, seeking, seen),
            # Nor does anybody feel here: after a hard stop the contact detectors begin anew, at rest in the middle.
            states.STOPPING: StatePlan(motion, frozenset(), seen),
            states.CENTERING: StatePlan(motion, frozenset(), seen),
            states.RESTING: StatePlan(settings.baseline_s, contact, closed, prompt=False),
            states.CLOSING: StatePlan(motion, contact, closed),
            states.CONFIRMING: StatePlan(settings.confirm_s, contact, closed),
            states.HOLDING: StatePlan(settings.hold_s, contact, closed, prompt=False),
            states.RELEASING: StatePlan(motion, contact, closed),
        }
        super().__init__(settings, NOWHERE, contact, plans)

    @property
    def middle_m(self) -> float:
        """Middle of the two places at which a finger saw the object."""
        return 0.5 * (self._saw[self._left] + self._saw[self._right])

    # conditions

    def by_left(self) -> bool:
        """Whether the left finger saw it."""
        return isinstance(self.event, Detected) and self.event.detector == self._left

    def by_right(self) -> bool:
        """Whether the right finger saw it."""
        return isinstance(self.event, Detected) and self.event.detector == self._right

    def running_up(self) -> bool:
        """Whether the first way is thrown away."""
        return self.settings.run_up and self.factors.method == "ours"

    def under_way(self) -> bool:
        """Whether the motion began long enough ago for a contact to be one."""
        return self.event.t_s >= self._entered_s + self.settings.blind_s

    def grasping(self) -> bool:
        """Whether the object is to be grasped."""
        return self.settings.grasp

    def on_object(self) -> bool:
        """Whether the jaws hold something."""
        return isinstance(self.event, Gripped) and self.event.object

    def both_touch(self) -> bool:
        """Whether both fingers feel contact."""
        return self._touching >= CONTACTS

    # what is said of the outcome

    def conclude_unseen(self) -> None:
        """The sweep ended before the finger ahead saw anything."""
        finger = "left" if self.state is self.States.SEEKING_FORWARD else "right"
        self.conclude("no_contact", f"the {finger} finger saw nothing within {self.settings.sweep_m:.6g} m")

    def conclude_touched(self) -> None:
        """The search touched what it should have seen."""
        self.conclude("contact", "touched during the search")

    def conclude_empty(self) -> None:
        """The jaws closed on nothing."""
        self.conclude("no_contact", "the jaws closed on nothing")

    def conclude_unfelt(self) -> None:
        """The jaws hold something that the fingers do not feel."""
        self.conclude("no_contact", f"no contact felt within {self.settings.confirm_s:.6g} s of the grip")

    def conclude_broken_off(self) -> None:
        """A pause came between the jaws and what they were to hold."""
        self.conclude("no_contact", "a pause broke the grip off")

    # what is commanded on entry

    def enter_ENTERING(self) -> None:
        """The fingers to either side of the object, which has been seen nowhere yet."""
        self._saw.clear()
        super().enter_ENTERING()

    def enter_RUNNING_UP(self) -> None:
        """The right finger towards the object."""
        self._seek(-1.0)

    def enter_REVERSING(self) -> None:
        """Stop, and forget."""
        self.command(Stop(self.settings.mover))

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

    def enter_CLOSING(self) -> None:
        """Close on the object."""
        settings = self.settings
        self.command(
            Grip(settings.gripper, settings.grip_width_m, settings.grip_speed_m_s, settings.grip_force_n)
        )

    def enter_HOLDING(self) -> None:
        """Contact is confirmed."""
        self.conclude("contact")

    def enter_RELEASING(self) -> None:
        """Let go."""
        self.command(Release(self.settings.gripper, self.settings.open_speed_m_s))

    def enter_BACKING_OFF(self) -> None:
        """Stop at once."""
        self.command(Stop(self.settings.mover))

    # the search

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
