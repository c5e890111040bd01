"""C2, C4, C5: a finger approaches an object with one of its sides, and may touch it (Rupavatharam et al., IV)."""

from __future__ import annotations

from enum import Enum, auto
from typing import Annotated, Literal

from pydantic import Field, Strict

from behaviors.events import Detected
from behaviors.machine import Behavior, StatePlan, failures
from drivers.messages import Excite, Home, MovePose, Release, Stop, Tone
from drivers.settings import Settings

Place = tuple[float, float, float]


class PathSettings(Settings):
    """A straight path of the tool, as displacements from the mover's start pose along the axes of its base frame."""

    start_m: Place
    """Where the approach begins: x, y, z."""

    end_m: Place
    """Where it ends; the object is beyond it by `end_gap_m`, or is touched on the way."""


class AuraSettings(Settings):
    """How one approach is run."""

    mover: str = "arm"
    """Device that carries the gripper."""

    gripper: str = "gripper"
    """Device whose jaws carry the fingers."""

    exciter: str = "audio"
    """Device that drives the fingers' transducers."""

    finger_stream: str = "signals.right"
    """Envelope of the finger that approaches."""

    pose_stream: str = "arm.pose"
    """Where the tool is (m and rad, base frame)."""

    paths: dict[Literal["x", "y", "z"], PathSettings]
    """By the axis of the approach."""

    end_gap_m: float = Field(default=0.004, ge=0.0, le=0.5)
    """Distance to the object at the end of the path (IV.A.1: 0.4 cm along x); 0 where the path leads to contact."""

    touch: bool = False
    """Go on until `contact` says so, hold, and come back."""

    contact: str = "contact_ours"
    """Detector that stops an approach which touches."""

    methods: Annotated[tuple[Literal["paper", "ours"], ...], Strict(False)] = ("paper", "ours")
    """Whose detectors listen, named `pretouch_METHOD` and `contact_METHOD`: what is measured."""

    drive_hz: float = Field(default=40_000.0, gt=0.0, le=1e6)
    """Frequency of the aura (III.A: 40 kHz)."""

    drive_level: float = Field(default=0.5, gt=0.0, le=1.0)
    """Amplitude of the drive as a share of full scale. Assumption: 18 Vrms at half of it."""

    clear_m: float = Field(default=0.10, gt=0.0, le=1.0)
    """How far above the path's start the jaws are empty, so that the gripper may find its ends there."""

    handling_speed_m_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """Speed of coming and going."""

    open_speed_m_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """How fast the jaws open."""

    cycles: int = Field(default=1, ge=1, le=1000)
    """Approaches in one trial."""

    baseline_s: float = Field(default=2.0, ge=0.0, le=600.0)
    """Rest before each approach: the drive settles, the detectors learn."""

    hold_s: float = Field(default=2.0, ge=0.0, le=600.0)
    """Rest at the end of the path, in contact or before it (Fig. 7: about 2 s of contact)."""

    motion_timeout_s: float = Field(default=60.0, gt=0.0, le=600.0)
    """Longest stay in any state that waits for a motion."""


class AuraFactors(Settings):
    """What a trial varies."""

    side: Literal["normal", "back", "front", "top", "bottom"] = "normal"
    """Side of the finger that faces the object (Fig. 3); the gripper is turned by hand on a real bench."""

    axis: Literal["x", "y", "z"] = "x"
    """Line of the approach (Fig. 8b)."""

    speed_m_s: float = Field(default=0.01, gt=0.0, le=1.0)
    """Speed of the approach (Fig. 4d: 0.01 and 0.03 m/s)."""

    object: str = "pipe"
    """What stands there; "none" is a control: the same motion before nothing."""


class Aura(Behavior):
    """Approach, stay, come back; several times if asked to.

    Every detector listens from the rest before the approach until the finger is back: what they say is for the measure.

    Args:
        settings: Of the experiment.
        factors: Of the trial.
        detectors: Names of all detectors.
    """

    class States(Enum):
        """Where the trial is."""

        CLEARING = auto()
        CALIBRATING = auto()
        OPENING = auto()
        ENTERING = auto()
        BASELINE = auto()
        APPROACHING = auto()
        STOPPING = auto()
        HOLDING = auto()
        RETRACTING = auto()
        LEAVING = auto()
        DONE = auto()
        FAILED = auto()

    initial = States.CLEARING
    final = frozenset({States.DONE, States.FAILED})
    _alive = tuple(States)[:-2]
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
        {"trigger": "deadline", "source": States.BASELINE, "dest": States.APPROACHING},
        {
            "trigger": "contact",
            "source": States.APPROACHING,
            "dest": States.STOPPING,
            "conditions": "acting",
            "label": "where it is to touch",
        },
        {
            "trigger": "reached",
            "source": States.APPROACHING,
            "dest": States.HOLDING,
            "conditions": "from_mover",
        },
        {
            "trigger": "standstill",
            "source": States.STOPPING,
            "dest": States.HOLDING,
            "conditions": "from_mover",
        },
        {"trigger": "deadline", "source": States.HOLDING, "dest": States.RETRACTING},
        {
            "trigger": "reached",
            "source": States.RETRACTING,
            "dest": States.BASELINE,
            "conditions": ["from_mover", "again"],
            "label": "again",
        },
        {
            "trigger": "reached",
            "source": States.RETRACTING,
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
            "source": [States.BASELINE, States.STOPPING, States.HOLDING],
            "dest": States.RETRACTING,
        },
        {
            "trigger": "resumed",
            "source": States.APPROACHING,
            "dest": States.RETRACTING,
            "before": "say_broken_off",
        },
        {"trigger": "resumed", "source": States.RETRACTING, "dest": States.RETRACTING},
        {"trigger": "resumed", "source": States.LEAVING, "dest": States.LEAVING},
        {
            "trigger": "baseline_refused",
            "source": list(_alive),
            "dest": States.FAILED,
            "before": "say_why",
        },
        *failures(_alive, States.FAILED),
        {
            "trigger": "deadline",
            "source": [state for state in _alive if state.name not in ("BASELINE", "HOLDING")],
            "dest": States.FAILED,
            "before": "say_stuck",
        },
    )

    def __init__(self, settings: AuraSettings, factors: AuraFactors, detectors: frozenset[str]) -> None:
        states = self.States
        if factors.axis not in settings.paths:
            known = ", ".join(settings.paths) or "none"
            raise ValueError(f"axis = {factors.axis}: no such path in behavior.paths; there are {known}")
        if settings.touch and settings.contact not in detectors:
            known = ", ".join(sorted(detectors)) or "none"
            raise ValueError(
                f"contact = {settings.contact}: no such detector to stop an approach that touches; there are {known}"
            )
        self.settings = settings
        self.factors = factors
        self._path = settings.paths[factors.axis]
        self._left_to_do = settings.cycles
        seen = frozenset((settings.finger_stream, settings.pose_stream))
        motion = settings.motion_timeout_s
        plans: dict[Enum, StatePlan] = dict.fromkeys(self._alive, StatePlan(motion))
        length_m = sum((b - a) ** 2 for a, b in zip(self._path.start_m, self._path.end_m, strict=True)) ** 0.5
        travel_s = length_m / factors.speed_m_s + motion
        plans |= {
            states.BASELINE: StatePlan(settings.baseline_s, detectors, seen, prompt=False),
            states.APPROACHING: StatePlan(travel_s, detectors, seen, prompt=settings.touch),
            states.STOPPING: StatePlan(motion, detectors, seen),
            states.HOLDING: StatePlan(settings.hold_s, detectors, seen, prompt=False),
            states.RETRACTING: StatePlan(travel_s, detectors, seen),
        }
        super().__init__(plans, mover=settings.mover)

    # conditions

    def from_gripper(self) -> bool:
        """Whether the status is the gripper's."""
        return getattr(self.event, "device", None) == self.settings.gripper

    def acting(self) -> bool:
        """Whether the contact is the acting detector's, in an approach that is to touch."""
        return (
            self.settings.touch
            and isinstance(self.event, Detected)
            and self.event.detector == self.settings.contact
        )

    def again(self) -> bool:
        """Whether there is another approach to do."""
        return self._left_to_do > 0

    def say_broken_off(self) -> None:
        """A pause broke the approach off: it is made once more."""
        self._left_to_do += 1

    # what is commanded on entry

    def enter_CLEARING(self) -> None:
        """To where the jaws are empty, above the start of the path."""
        self._go(self._above, self.settings.handling_speed_m_s)

    def enter_CALIBRATING(self) -> None:
        """Let the gripper find its ends, if it does not know them."""
        self.command(Home(self.settings.gripper))

    def enter_OPENING(self) -> None:
        """As wide as it goes."""
        self.command(Release(self.settings.gripper, self.settings.open_speed_m_s))

    def enter_ENTERING(self) -> None:
        """Down to the start of the path; the aura on, so that it settles on the way."""
        self.command(Tone(self.settings.exciter, self.settings.drive_hz, self.settings.drive_level))
        self._go(self._path.start_m, self.settings.handling_speed_m_s)

    def enter_APPROACHING(self) -> None:
        """Along the path."""
        self._left_to_do -= 1
        self._go(self._path.end_m, self.factors.speed_m_s)

    def enter_STOPPING(self) -> None:
        """Stop at once."""
        self.conclude("contact")
        self.command(Stop(self.settings.mover))

    def enter_RETRACTING(self) -> None:
        """Back along the path, as fast as it came."""
        self._go(self._path.start_m, self.factors.speed_m_s)

    def enter_LEAVING(self) -> None:
        """Up and away."""
        self.conclude("no_contact")
        self._go(self._above, self.settings.handling_speed_m_s)

    def enter_DONE(self) -> None:
        """Silence."""
        self.command(Excite(self.settings.exciter, False))

    def enter_FAILED(self) -> None:
        """Nothing moves after an error."""
        self.command(Stop(self.settings.mover))
        self.command(Stop(self.settings.gripper))
        self.command(Excite(self.settings.exciter, False))

    @property
    def _above(self) -> Place:
        x_m, y_m, z_m = self._path.start_m
        return (x_m, y_m, z_m + self.settings.clear_m)

    def _go(self, place_m: Place, speed_m_s: float) -> None:
        self.command(MovePose(self.settings.mover, (*place_m, 0.0, 0.0, 0.0), speed_m_s))
