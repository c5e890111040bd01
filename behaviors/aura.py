"""C2, C4, C5: a finger approaches an object with one of its sides, and may touch it (Rupavatharam et al., IV)."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

from pydantic import Field, Strict

from behaviors.machine import StatePlan, from_mover, on
from behaviors.sonic import COMING_IN, GOING_OUT, Place, SonicBehavior, SonicSettings
from drivers.core.messages import Stop
from drivers.core.settings import Mismatch, Settings, StreamName


class PathSettings(Settings):
    """A straight path of the tool, as displacements from the mover's start pose along the axes of its base frame."""

    start_m: Place
    """Where the approach begins: x, y, z."""

    end_m: Place
    """Where it ends; the object is beyond it by `end_gap_m`, or is touched on the way."""


class AuraSettings(SonicSettings):
    """How one approach is run; `clear_m` is above the path's start."""

    finger_stream: StreamName = "signals.right"
    """Envelope of the finger that approaches."""

    pose_stream: StreamName = "arm.pose"
    """Where the tool is (m and rad, base frame)."""

    paths: dict[Literal["x", "y", "z"], PathSettings]
    """By the axis of the approach."""

    end_gap_m: float = Field(default=0.004, ge=0.0, le=0.5)
    """Distance to the object at the end of the path (IV.A.1: 0.4 cm along x); 0 where the path leads to contact."""

    touch: bool = False
    """Go on until the detector `contact` reports contact, hold, and come back."""

    contact: str = "contact_ours"
    """Detector that stops an approach which touches."""

    methods: Annotated[tuple[Literal["paper", "ours"], ...], Strict(False)] = ("paper", "ours")
    """Whose detectors are armed, named `pretouch_METHOD` and `contact_METHOD`: what is measured."""

    cycles: int = Field(default=1, ge=1, le=1000)
    """Approaches in one trial."""

    hold_s: float = Field(default=2.0, ge=0.0, le=600.0)
    """Rest at the end of the path, in contact or before it (Fig. 7: about 2 s of contact)."""

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """Its paths are of the base frame, the guard's travel is on the approach axis."""
        yield from super().mismatches(path, profile)
        yield from self.axis_mismatches(profile)


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


class Aura(SonicBehavior):
    """Approach, stay, come back; several times if asked to.

    Every detector is armed from the rest before the approach until the finger is back; the measure uses their events.
    An approach that is to touch is not begun while the detector that is to stop it reports a touch. Events during a
    pause are not handled, so after one the detectors begin anew before the next approach.
    """

    settings: AuraSettings

    def __init__(self, settings: AuraSettings, factors: AuraFactors, detectors: frozenset[str]) -> None:
        if factors.axis not in settings.paths:
            known = ", ".join(settings.paths) or "none"
            raise ValueError(f"axis = {factors.axis}: no such path in behavior.paths; there are {known}")
        if settings.touch and settings.contact not in detectors:
            known = ", ".join(sorted(detectors)) or "none"
            raise ValueError(
                f"contact = {settings.contact}: no such detector to stop an approach that touches; there are {known}"
            )
        self.factors = factors
        self._path = path = settings.paths[factors.axis]
        self._left_to_do = settings.cycles
        self._paused = False
        seen = frozenset((settings.finger_stream, settings.pose_stream))
        motion = settings.motion_timeout_s
        length_m = sum((b - a) ** 2 for a, b in zip(path.start_m, path.end_m, strict=True)) ** 0.5
        travel_s = length_m / factors.speed_m_s + motion
        plans: dict[str, StatePlan] = {
            "BASELINE": StatePlan(settings.baseline_s, detectors, seen, prompt=False),
            "APPROACHING": StatePlan(travel_s, detectors, seen, prompt=settings.touch),
            "STOPPING": StatePlan(motion, detectors, seen),
            "HOLDING": StatePlan(settings.hold_s, detectors, seen, prompt=False),
            "RETRACTING": StatePlan(travel_s, detectors, seen),
        }
        acting = frozenset({settings.contact}) if settings.touch else frozenset[str]()
        super().__init__(settings, path.start_m, acting, plans)

    def again(self) -> bool:
        """Whether there is another approach to do."""
        return self._left_to_do > 0

    def was_paused(self) -> bool:
        """Whether there was a pause since the detectors began."""
        return self._paused

    def note_pause(self) -> None:
        """Events of detectors that are still armed were not handled."""
        self._paused = True

    def repeat_approach(self) -> None:
        """A pause broke the approach off: it is made once more."""
        self._left_to_do += 1

    def conclude_approached(self) -> None:
        """Every approach came to its end, and no contact stopped it."""
        self.conclude("no_contact" if self._touches else "approached")

    @property
    def _touches(self) -> bool:
        """Whether there is something to touch, and it is to be touched."""
        return self.settings.touch and self.factors.object != "none"

    def enter_BASELINE(self) -> None:
        """Detectors that a pause left in doubt have begun anew."""
        self._paused = False

    def enter_APPROACHING(self) -> None:
        """Along the path."""
        self._left_to_do -= 1
        self._go(self._path.end_m, self.factors.speed_m_s)

    def enter_STOPPING(self) -> None:
        """Stop at once."""
        self.conclude("contact" if self._touches else "false_contact")
        self.command(Stop(self.settings.mover))

    def enter_RETRACTING(self) -> None:
        """Back along the path, as fast as it came."""
        self._go(self._path.start_m, self.factors.speed_m_s)

    table = (
        *COMING_IN,
        on("deadline", "BASELINE", "APPROACHING"),
        on("contact", "APPROACHING", "STOPPING", SonicBehavior.decisive, label="where it is to touch"),
        on("reached", "APPROACHING", "HOLDING", from_mover),
        on("standstill", "STOPPING", "HOLDING", from_mover),
        on("deadline", "HOLDING", "RETRACTING"),
        on("reached", "RETRACTING", "ENTERING", from_mover, again, was_paused, label="again, after a pause"),
        on("reached", "RETRACTING", "BASELINE", from_mover, again, label="again"),
        on("reached", "RETRACTING", "LEAVING", from_mover, do=conclude_approached),
        on("resumed", "BASELINE", "ENTERING"),
        on("resumed", "APPROACHING", "RETRACTING", do=[note_pause, repeat_approach]),
        on("resumed", ["STOPPING", "HOLDING", "RETRACTING"], "RETRACTING", do=note_pause),
        *GOING_OUT,
    )
