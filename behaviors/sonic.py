"""What the experiments with sonic fingers share: coming in from above, tracking touches, leaving, failing."""

import math
from collections.abc import Iterator, Mapping, Sequence

from pydantic import Field

from behaviors.events import Contact, ContactHeld, ContactLost, Detected, Event
from behaviors.machine import Behavior, Row, StatePlan, from_mover, on
from drivers.core.messages import Command, Excite, Home, MovePose, Reached, Release, Stop, Tone
from drivers.core.settings import DeviceName, DriveHz, Mismatch, Settings

CONTACTS = frozenset({"left_contact", "right_contact"})
"""Detectors that feel a touch, one at each of two fingers."""

Place = tuple[float, float, float]
"""A displacement from the mover's start pose along the axes of its base frame, m."""

BASE_X: Place = (1.0, 0.0, 0.0)
"""Unit vector."""

AXIS_TOLERANCE = 1e-3
"""How far an approach axis may be off it (assumption: three digits in a profile)."""


class SonicSettings(Settings):
    """The devices, the drive, and how the fingers come and go."""

    mover: DeviceName = "arm"
    """Device that carries the gripper."""

    gripper: DeviceName = "gripper"
    """Device whose jaws carry the fingers."""

    exciter: DeviceName = "audio"
    """Device that drives the fingers' transducers."""

    drive_hz: DriveHz = Field(default=40_000.0, gt=0.0, le=1e6)
    """Frequency of the aura (III.A: 40 kHz)."""

    drive_level: float = Field(default=0.5, gt=0.0, le=1.0)
    """Amplitude of the drive as a share of full scale. Assumption: 18 Vrms at half of it."""

    clear_m: float = Field(default=0.10, gt=0.0, le=1.0)
    """How far above its place the gripper is calibrated: there is nothing between the jaws there."""

    handling_speed_m_s: float = Field(default=0.05, gt=0.0, le=1.0)
    """Speed of coming and going."""

    open_speed_m_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """How fast the jaws open."""

    baseline_s: float = Field(default=2.0, ge=0.0, le=600.0)
    """Rest before what is measured: the drive settles, the detectors learn."""

    motion_timeout_s: float = Field(default=60.0, gt=0.0, le=600.0)
    """Longest stay in any state that waits for a motion."""

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """Who listens expects the frequency of the drive: at another one there is no signal."""
        for place, settings in profile.items():
            for key in settings.keys_of("drive"):
                if (heard_hz := getattr(settings, key)) != self.drive_hz:
                    mistake = (
                        f" = {heard_hz}: [behavior] has drive_hz = {self.drive_hz}; write the same in both"
                    )
                    yield Mismatch(place, key, mistake)

    def axis_mismatches(self, profile: Mapping[tuple[str, ...], Settings]) -> Iterator[Mismatch]:
        """Places are along the axes of the base frame: for kinds of which one must lie on the approach axis."""
        place = ("devices", self.mover)
        axis = getattr(profile.get(place), "approach_axis", BASE_X)
        if math.dist(axis, BASE_X) > AXIS_TOLERANCE:
            mistake = (
                f" = {list(axis)}: this experiment goes along x of the base frame; choose a start_pose in which the"
                f" jaws close along it, and write {list(BASE_X)}"
            )
            yield Mismatch(place, "approach_axis", mistake)


class SonicBehavior(Behavior):
    """A trial of sonic fingers: what `COMING_IN` and `GOING_OUT` need commanded, and which fingers touch.

    Args:
        place_m: Where the fingers rest before what is measured.
        contacts: Detectors whose contact counts.
        plans: What states need beyond the time for a motion.
        acting: Other detectors that the trial acts on.
    """

    settings: SonicSettings

    def __init__(
        self,
        settings: SonicSettings,
        place_m: Place,
        contacts: frozenset[str],
        plans: Mapping[str, StatePlan],
        acting: frozenset[str] = frozenset(),
    ) -> None:
        self.settings = settings
        self._place_m = place_m
        self._contacts = contacts
        self._touching: set[str] = set()
        self._held: set[str] = set()
        self._opening_m = math.inf
        waiting = dict.fromkeys(
            [state for state in self.states if state not in self.final], StatePlan(settings.motion_timeout_s)
        )
        super().__init__({**waiting, **plans}, settings.mover, contacts | acting)

    def handle(self, event: Event) -> Sequence[Command]:
        """Handle one event; which fingers touch is tracked, whatever the state does with it."""
        if isinstance(event, Detected) and event.detector in self._contacts & self.plan.detectors:
            self._track_touch(event)
        commands = super().handle(event)
        # A detector that this state does not name is disarmed, and never reports the end of what it reported.
        self._touching &= self.plan.detectors
        self._held &= self.plan.detectors
        return commands

    def _track_touch(self, event: Detected) -> None:
        if isinstance(event, Contact):
            self._touching.add(event.detector)
        elif isinstance(event, ContactHeld):
            self._held.add(event.detector)
        elif isinstance(event, ContactLost):
            self._touching.discard(event.detector)
            self._held.discard(event.detector)

    def from_gripper(self) -> bool:
        """Whether the status is the gripper's."""
        return self.came_from(self.settings.gripper)

    @property
    def answering(self) -> str:
        """See `Behavior.answering`: the gripper, where one of its rows is the way on, or a grip and no motion is."""
        rows = [row for row in self.rows if self.state in row.sources]
        triggers = {row.trigger for row in rows}
        asked = any(SonicBehavior.from_gripper in row.conditions for row in rows)
        asked |= "gripped" in triggers and "reached" not in triggers
        return self.settings.gripper if asked else super().answering

    def touched(self) -> bool:
        """Whether a touch has been reported and its end has not."""
        return bool(self._touching)

    def touch_held(self) -> bool:
        """Whether a touch has been reported to persist, and its end has not."""
        return bool(self._held)

    def note_opening(self) -> None:
        """How wide open the jaws come to the object."""
        assert isinstance(self.event, Reached)
        self._opening_m = self.event.position_m

    def conclude_touching(self) -> None:
        """There is a touch where there should be none."""
        touching = ", ".join(sorted(self._touching))
        self.outcome = "touched"
        self.reason = (
            f"{touching} reported a touch at rest and not its end, so that it could stop no motion: "
            "is something at the finger, or is the finger's level not quiet?"
        )

    def enter_CLEARING(self) -> None:
        """To where the jaws are empty. An arm knows where it is; sent home, it would go among the fingers' objects."""
        self._go(self._above_m, self.settings.handling_speed_m_s)

    def enter_CALIBRATING(self) -> None:
        """Let the gripper find its ends, if it does not know them."""
        self.command(Home(self.settings.gripper))

    def enter_OPENING(self) -> None:
        """As wide as it goes."""
        self.command(Release(self.settings.gripper, self.settings.open_speed_m_s))

    def enter_ENTERING(self) -> None:
        """To the place; the aura on, so that it settles on the way."""
        self.command(Tone(self.settings.exciter, self.settings.drive_hz, self.settings.drive_level))
        self._go(self._place_m, self.settings.handling_speed_m_s)

    def enter_LEAVING(self) -> None:
        """Up and away."""
        self.conclude("no_contact")
        self._go(self._above_m, self.settings.handling_speed_m_s)

    def enter_DONE(self) -> None:
        """Silence."""
        self.command(Excite(self.settings.exciter, False))

    def enter_FAILED(self) -> None:
        """Nothing moves after an error; what is held stays held."""
        super().enter_FAILED()
        self.command(Stop(self.settings.gripper))
        self.command(Excite(self.settings.exciter, False))

    @property
    def _above_m(self) -> Place:
        x_m, y_m, z_m = self._place_m
        return (x_m, y_m, z_m + self.settings.clear_m)

    def _go(self, place_m: Place, speed_m_s: float) -> None:
        self.command(MovePose(self.settings.mover, (*place_m, 0.0, 0.0, 0.0), speed_m_s))


_touched = SonicBehavior.touched

COMING_IN: Sequence[Row] = (
    on("reached", "CLEARING", "CALIBRATING", from_mover),
    on("reached", "CALIBRATING", "OPENING", SonicBehavior.from_gripper),
    on("reached", "OPENING", "ENTERING", SonicBehavior.from_gripper, do=SonicBehavior.note_opening),
    on("reached", "ENTERING", "BASELINE", from_mover),
    on("resumed", ["CLEARING", "CALIBRATING", "OPENING", "ENTERING"], "CLEARING"),
    *(
        on(
            trigger,
            "BASELINE",
            "LEAVING",
            _touched,
            do=SonicBehavior.conclude_touching,
            label="a touch stands",
        )
        for trigger in ("deadline", "resumed")
    ),
)
"""Rows of the way in: up to where the jaws are empty, open them there, down to the place, rest. A pause on this way
begins it anew. The rest is not left towards an object while a touch stands: it was reported, will not be reported
again, and so could stop nothing."""

GOING_OUT: Sequence[Row] = (on("reached", "LEAVING", "DONE", from_mover), on("resumed", "LEAVING", "LEAVING"))
"""Rows of the end: away, and done."""
