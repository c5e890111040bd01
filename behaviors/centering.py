"""C3: find an object between two fingers by its aura, go to the middle, close (Rupavatharam et al., III.D, IV.A.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum, auto
from typing import Literal

from pydantic import Field

from behaviors.events import Contact, ContactLost, Detected, Event, PreTouch
from behaviors.machine import Behavior, StatePlan, failures
from drivers.messages import (
    Command,
    Excite,
    Grip,
    Gripped,
    Home,
    MoveAt,
    MovePose,
    MoveTo,
    Release,
    Standstill,
    Stop,
    Tone,
)
from drivers.settings import Settings

NOWHERE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""The start pose: no displacement from it."""


class CenteringSettings(Settings):
    """How the middle is sought.

    The mover's approach axis is the line on which the jaws close. Going forward on it takes the left finger towards
    what is between the two, going backward the right one.
    """

    mover: str = "arm"
    """Device that carries the gripper."""

    gripper: str = "gripper"
    """Device whose jaws carry the fingers."""

    exciter: str = "audio"
    """Device that drives the fingers' transducers."""

    left_stream: str = "signals.left"
    """Envelope of the left finger."""

    right_stream: str = "signals.right"
    """Envelope of the right finger."""

    position_stream: str = "arm.position"
    """Where the mover is (m)."""

    width_stream: str = "gripper.width"
    """How far open the jaws are (m)."""

    drive_hz: float = Field(default=40_000.0, gt=0.0, le=1e6)
    """Frequency of the aura (III.A: 40 kHz)."""

    drive_level: float = Field(default=0.5, gt=0.0, le=1.0)
    """Amplitude of the drive as a share of full scale. Assumption: 18 Vrms at half of it."""

    clear_m: float = Field(default=0.10, gt=0.0, le=1.0)
    """How far above the start pose the jaws are empty, so that the gripper may find its ends there."""

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

    handling_speed_m_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """Speed of coming and going."""

    baseline_s: float = Field(default=2.0, ge=0.0, le=600.0)
    """Rest before the search: the drive settles, the detectors learn."""

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

    motion_timeout_s: float = Field(default=60.0, gt=0.0, le=600.0)
    """Longest stay in any state that waits for a motion."""


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


class Centering(Behavior):
    """Search one way until the finger ahead of the motion sees the object, then the other way; go to the middle.

    Where a finger saw it is what its detector says of the mover's position; a detector that hears no encoder leaves it
    to where the mover came to stand. Contact during the search ends it.

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
    _alive = tuple(States)[:-2]
    _seeking = (
        States.RUNNING_UP,
        States.REVERSING,
        States.SEEKING_FORWARD,
        States.TURNING,
        States.SEEKING_BACKWARD,
        States.STOPPING,
    )
    table = (
        {
            "trigger": "reached",
            "source": States.CLEARING,
            "dest": States.CALIBRATING,
            "conditions": "from_mover",
        },
        {
            "trigger": "reached",
            "source": States.CALIBRATING,
            "dest": States.OPENING,
            "conditions": "from_gripper",
        },
        {
            "trigger": "reached",
            "source": States.OPENING,
            "dest": States.ENTERING,
            "conditions": "from_gripper",
        },
        {
            "trigger": "reached",
            "source": States.ENTERING,
            "dest": States.BASELINE,
            "conditions": "from_mover",
        },
        {
            "trigger": "deadline",
            "source": States.BASELINE,
            "dest": States.RUNNING_UP,
            "conditions": "running_up",
            "label": "run-up",
        },
        {"trigger": "deadline", "source": States.BASELINE, "dest": States.SEEKING_FORWARD},
        {
            "trigger": "pre_touch",
            "source": States.RUNNING_UP,
            "dest": States.REVERSING,
            "conditions": "by_right",
            "label": "right finger",
        },
        {
            "trigger": "standstill",
            "source": States.REVERSING,
            "dest": States.SEEKING_FORWARD,
            "conditions": "from_mover",
        },
        {
            "trigger": "pre_touch",
            "source": States.SEEKING_FORWARD,
            "dest": States.TURNING,
            "conditions": "by_left",
            "label": "left finger",
        },
        {
            "trigger": "reached",
            "source": [States.RUNNING_UP, States.SEEKING_FORWARD, States.SEEKING_BACKWARD],
            "dest": States.LEAVING,
            "conditions": "from_mover",
            "before": "say_unseen",
            "label": "not seen",
        },
        {
            "trigger": "contact",
            "source": [States.RUNNING_UP, States.SEEKING_FORWARD, States.SEEKING_BACKWARD],
            "dest": States.BACKING_OFF,
            "conditions": "under_way",
            "before": "say_touched",
        },
        {
            "trigger": "contact_held",
            "source": [States.RUNNING_UP, States.SEEKING_FORWARD, States.SEEKING_BACKWARD],
            "dest": States.BACKING_OFF,
            "before": "say_touched",
            "label": "a touch while it was not heeded",
        },
        {
            "trigger": "standstill",
            "source": States.TURNING,
            "dest": States.SEEKING_BACKWARD,
            "conditions": "from_mover",
        },
        {
            "trigger": "pre_touch",
            "source": States.SEEKING_BACKWARD,
            "dest": States.STOPPING,
            "conditions": "by_right",
            "label": "right finger",
        },
        {
            "trigger": "standstill",
            "source": States.STOPPING,
            "dest": States.CENTERING,
            "conditions": "from_mover",
        },
        {
            "trigger": "reached",
            "source": States.CENTERING,
            "dest": States.RESTING,
            "conditions": ["from_mover", "grasping"],
            "label": "to grasp",
        },
        {
            "trigger": "reached",
            "source": States.CENTERING,
            "dest": States.LEAVING,
            "conditions": "from_mover",
        },
        {"trigger": "deadline", "source": States.RESTING, "dest": States.CLOSING},
        {
            "trigger": "gripped",
            "source": States.CLOSING,
            "dest": States.HOLDING,
            "conditions": ["on_object", "both_touch"],
            "label": "both fingers touch",
        },
        {
            "trigger": "gripped",
            "source": States.CLOSING,
            "dest": States.CONFIRMING,
            "conditions": "on_object",
            "label": "object",
        },
        {
            "trigger": "gripped",
            "source": States.CLOSING,
            "dest": States.RELEASING,
            "before": "say_empty",
            "label": "nothing there",
        },
        {
            "trigger": "contact",
            "source": States.CONFIRMING,
            "dest": States.HOLDING,
            "conditions": "both_touch",
            "label": "both fingers touch",
        },
        {
            "trigger": "deadline",
            "source": States.CONFIRMING,
            "dest": States.RELEASING,
            "before": "say_unfelt",
        },
        {"trigger": "deadline", "source": States.HOLDING, "dest": States.RELEASING},
        {
            "trigger": "reached",
            "source": States.RELEASING,
            "dest": States.LEAVING,
            "conditions": "from_gripper",
        },
        {
            "trigger": "standstill",
            "source": States.BACKING_OFF,
            "dest": States.LEAVING,
            "conditions": "from_mover",
        },
        {"trigger": "reached", "source": States.LEAVING, "dest": States.DONE, "conditions": "from_mover"},
        {
            "trigger": "resumed",
            "source": [States.CLEARING, States.CALIBRATING, States.OPENING, States.ENTERING],
            "dest": States.CLEARING,
        },
        {
            "trigger": "resumed",
            "source": [States.BASELINE, *_seeking, States.CENTERING, States.RESTING],
            "dest": States.ENTERING,
        },
        {
            "trigger": "resumed",
            "source": [States.CLOSING, States.CONFIRMING, States.HOLDING, States.RELEASING],
            "dest": States.RELEASING,
        },
        {
            "trigger": "resumed",
            "source": [States.BACKING_OFF, States.LEAVING],
            "dest": States.LEAVING,
        },
        {
            "trigger": "baseline_refused",
            "source": list(_alive),
            "dest": States.FAILED,
            "before": "say_why",
        },
        *failures(_alive, States.FAILED),
        {
            "trigger": "deadline",
            "source": [
                state
                for state in _alive
                if state.name not in ("BASELINE", "RESTING", "CONFIRMING", "HOLDING")
            ],
            "dest": States.FAILED,
            "before": "say_stuck",
        },
    )

    def __init__(
        self, settings: CenteringSettings, factors: CenteringFactors, detectors: frozenset[str]
    ) -> None:
        states = self.States
        self.settings = settings
        self.factors = factors
        self._left, self._right = f"left_{factors.method}", f"right_{factors.method}"
        self._saw: dict[str, float] = {}
        self._touching: set[str] = set()
        contact = detectors & {"left_contact", "right_contact"}
        seeking = frozenset((self._left, self._right)) | contact
        seen = frozenset((settings.left_stream, settings.right_stream, settings.position_stream))
        closed = seen | {settings.width_stream}
        motion, search = settings.motion_timeout_s, 2.0 * settings.sweep_m / factors.speed_m_s
        plans: dict[Enum, StatePlan] = dict.fromkeys(self._alive, StatePlan(motion))
        plans |= {
            states.BASELINE: StatePlan(settings.baseline_s, seeking, seen, prompt=False),
            states.RUNNING_UP: StatePlan(search + motion, seeking, seen),
            # Neither this nor the turn names a finder, so that the way back is searched afresh.
            states.REVERSING: StatePlan(motion, contact, seen),
            states.SEEKING_FORWARD: StatePlan(search + motion, seeking, seen),
            states.TURNING: StatePlan(motion, contact, seen),
            states.SEEKING_BACKWARD: StatePlan(search + motion, seeking, seen),
            states.STOPPING: StatePlan(motion, frozenset(), seen),
            states.CENTERING: StatePlan(motion, frozenset(), seen),
            states.RESTING: StatePlan(settings.baseline_s, contact, closed, prompt=False),
            states.CLOSING: StatePlan(motion, contact, closed),
            states.CONFIRMING: StatePlan(settings.confirm_s, contact, closed),
            states.HOLDING: StatePlan(settings.hold_s, contact, closed, prompt=False),
            states.RELEASING: StatePlan(motion, contact, closed),
        }
        super().__init__(plans, mover=settings.mover)

    def handle(self, event: Event) -> Sequence[Command]:
        """Hear one event; who touches is kept in mind whatever the state."""
        if isinstance(event, Contact):
            self._touching.add(event.detector)
        elif isinstance(event, ContactLost):
            self._touching.discard(event.detector)
        return super().handle(event)

    @property
    def middle_m(self) -> float:
        """Middle of the two places at which a finger saw the object."""
        return 0.5 * (self._saw[self._left] + self._saw[self._right])

    # conditions

    def from_gripper(self) -> bool:
        """Whether the status is the gripper's."""
        return getattr(self.event, "device", None) == self.settings.gripper

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
        return self._touching >= {"left_contact", "right_contact"}

    # what is said of the outcome

    def say_unseen(self) -> None:
        """The sweep ended before the finger ahead saw anything."""
        finger = "left" if self.state is self.States.SEEKING_FORWARD else "right"
        self.conclude("no_contact", f"the {finger} finger saw nothing within {self.settings.sweep_m:.6g} m")

    def say_touched(self) -> None:
        """The search touched what it should have seen."""
        self.conclude("contact", "touched during the search")

    def say_empty(self) -> None:
        """The jaws closed on nothing."""
        self.conclude("no_contact", "the jaws closed on nothing")

    def say_unfelt(self) -> None:
        """The jaws hold something that the fingers do not feel."""
        self.conclude("no_contact", f"no contact felt within {self.settings.confirm_s:.6g} s of the grip")

    # what is commanded on entry

    def enter_CLEARING(self) -> None:
        """To where the jaws are empty. An arm knows where it is; sent home, it would go among the fingers' objects."""
        self.command(MovePose(self.settings.mover, self._above, self.settings.handling_speed_m_s))

    def enter_CALIBRATING(self) -> None:
        """Let the gripper find its ends, if it does not know them."""
        self.command(Home(self.settings.gripper))

    def enter_OPENING(self) -> None:
        """As wide as it goes."""
        self.command(Release(self.settings.gripper, self.settings.grip_speed_m_s))

    def enter_ENTERING(self) -> None:
        """The fingers to either side of the object; the aura on, so that it settles on the way."""
        self._saw.clear()
        self.command(Tone(self.settings.exciter, self.settings.drive_hz, self.settings.drive_level))
        self.command(MovePose(self.settings.mover, NOWHERE, self.settings.handling_speed_m_s))

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
        self.command(Release(self.settings.gripper, self.settings.grip_speed_m_s))

    def enter_BACKING_OFF(self) -> None:
        """Stop at once."""
        self.command(Stop(self.settings.mover))

    def enter_LEAVING(self) -> None:
        """Away from the object."""
        if self.outcome == "aborted":
            self.conclude("no_contact")
        self.command(MovePose(self.settings.mover, self._above, self.settings.handling_speed_m_s))

    def enter_DONE(self) -> None:
        """Silence."""
        self.command(Excite(self.settings.exciter, False))

    def enter_FAILED(self) -> None:
        """Nothing moves after an error; what is held stays held."""
        self.command(Stop(self.settings.mover))
        self.command(Stop(self.settings.gripper))
        self.command(Excite(self.settings.exciter, False))

    # the search

    @property
    def _above(self) -> tuple[float, float, float, float, float, float]:
        return (0.0, 0.0, self.settings.clear_m, 0.0, 0.0, 0.0)

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
