"""B7: touch after touch with the tip turned further, up and down its range (Fernandez et al., section 2, Fig. 2)."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, model_validator

from behaviors.approach import TipTrial, TipTrialSettings, approaching
from behaviors.machine import StatePlan, from_mover, on, sent_by
from drivers.core.messages import Home, Stop
from drivers.core.settings import DetectorName, Settings, StreamName

Angle = Annotated[float, Field(ge=-1.57, le=1.57)]
"""The tip is a half cylinder: what touches beyond a quarter turn touches something else (section 2)."""


class PointerSettings(TipTrialSettings):
    """How the angle of the contact is held against the arm's."""

    detector: DetectorName = "touch"
    """Detector whose contact ends a descent; its threshold is the force of the touch."""

    forces_stream: StreamName = "signals.tip"
    """The fingertip's calibrated forces (N): Fx and Fy first."""

    angles_rad: tuple[Angle, ...] = tuple(round(-1.5 + 0.3 * i, 6) for i in range(11))
    """Angles at which it touches, rad, ascending: all of them up, then all of them down. Fig. 11 is drawn from -1.5 to
    1.5; the steps are an assumption."""

    zero_s: float = Field(default=0.2, gt=0.0, le=10.0)
    """How long the start pose is recorded: angles count from it (assumption)."""

    baseline_timeout_s: float = Field(default=10.0, gt=0.0, le=600.0)
    """Longest wait for the detector's baseline, taken anew before each touch."""

    turn_rad_s: float = Field(default=0.3, gt=0.0, le=3.0)
    """Speed of turning, in the air. Assumption: slow enough that an arm of 0.5 rad/s2 is up to it within a step of the
    angles; one that is not turns less far."""

    rest_s: float = Field(default=0.3, ge=0.0, le=60.0)
    """Wait after standstill (assumption: the structure has stopped ringing)."""

    record_s: float = Field(default=0.4, gt=0.0, le=60.0)
    """How long each touch is recorded."""

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if len(self.angles_rad) < 2 or any(low >= high for low, high in pairwise(self.angles_rad)):
            raise ValueError("angles_rad must ascend, and be two at least")
        return self

    @property
    def turns_rad(self) -> Sequence[float]:
        """Every touch's angle, in order: up, then down."""
        return (*self.angles_rad, *reversed(self.angles_rad))


_AWAY_FROM_START = ("TURNING", "WAITING", "DESCENDING", "STOPPING", "RESTING", "RECORDING", "LIFTING")


class Pointer(TipTrial):
    """Turn, touch, record, lift, until every angle has been touched in both directions.

    Args:
        detectors: Names of all detectors there are; the touch's alone is armed.
    """

    settings: PointerSettings

    def __init__(self, settings: PointerSettings, factors: Settings, detectors: frozenset[str]) -> None:
        motion = settings.motion_timeout_s
        armed = frozenset({settings.detector})
        both = frozenset({settings.forces_stream, settings.pose_stream})
        widest_rad = 2.0 * max(abs(angle_rad) for angle_rad in settings.angles_rad)
        # Measured because one turn is none: virtual time does not pass over the standstill's answer then.
        turning = StatePlan(
            widest_rad / settings.turn_rad_s + motion, measures=frozenset({settings.pose_stream})
        )
        self.settings = settings
        self.factors = factors
        self._recorded = 0
        self._missed = self._astray = False
        self._turned_rad = 0.0
        super().__init__(
            {
                "HOMING": StatePlan(settings.home_timeout_s),
                "ZEROING": StatePlan(
                    settings.zero_s, frozenset(), frozenset({settings.pose_stream}), prompt=False
                ),
                "TURNING": turning,
                "WAITING": StatePlan(settings.baseline_timeout_s, armed, prompt=False),
                "DESCENDING": self.descent(settings.detector, StatePlan(motion, armed)),
                "STOPPING": StatePlan(motion),
                "RESTING": StatePlan(settings.rest_s),
                "RECORDING": StatePlan(settings.record_s, frozenset(), both, prompt=False),
                "UNTURNING": turning,
                **self.ending(),
            },
            mover=settings.mover,
        )

    def finished(self) -> bool:
        """Whether there is nothing left to touch, or nothing there."""
        return self._missed or self._recorded >= len(self.settings.turns_rad)

    def note_astray(self) -> None:
        """A turn may have been broken off: the angle counts from the start pose once more."""
        self._astray = True

    def count_recorded(self) -> None:
        """One touch more is on record."""
        self._recorded += 1
        if self.finished():
            self.conclude("contact")

    def conclude_no_contact(self) -> None:
        """A descent ended at its limit."""
        self._missed = True
        angle_rad = self.settings.turns_rad[self._recorded]
        self.conclude(
            "no_contact", f"no contact up to {self.settings.descend_limit_m:.6g} m at {angle_rad:.6g} rad"
        )

    def enter_HOMING(self) -> None:
        """Begin at the start pose."""
        self._turned_rad, self._astray = 0.0, False
        self.command(Home(self.settings.mover))

    def enter_TURNING(self) -> None:
        """To the next angle, about the tip's own axis; the last angle upwards is the first one downwards."""
        self._turn(self.settings.turns_rad[self._recorded])

    def enter_STOPPING(self) -> None:
        """The table presses as hard as was asked for."""
        self.command(Stop(self.settings.mover))

    def enter_UNTURNING(self) -> None:
        """Turned back, for the way home is slow where it turns."""
        self._turn(0.0)

    def _turn(self, angle_rad: float) -> None:
        turn_rad, self._turned_rad = angle_rad - self._turned_rad, angle_rad
        if turn_rad == 0.0:
            self.command(Stop(self.settings.mover))
            return
        self.turn(turn_rad, self.settings.turn_rad_s)

    table = (
        on("reached", "HOMING", "ZEROING", from_mover),
        on("deadline", "ZEROING", "TURNING"),
        on("reached", "TURNING", "WAITING", from_mover),
        on("standstill", "TURNING", "WAITING", from_mover, label="the same angle again"),
        on("baseline_ready", "WAITING", "DESCENDING", sent_by("detector")),
        *approaching("DESCENDING", stopped="RESTING", missed="LIFTING"),
        on("deadline", "RESTING", "RECORDING"),
        on("deadline", "RECORDING", "LIFTING", do=count_recorded),
        on("reached", "LIFTING", "UNTURNING", from_mover, finished, label="all touched, or nothing there"),
        on("reached", "LIFTING", "HOMING", from_mover, lambda it: it._astray, label="after a pause"),
        on("reached", "LIFTING", "TURNING", from_mover),
        on("reached", "UNTURNING", "RETURNING", from_mover),
        on("standstill", "UNTURNING", "RETURNING", from_mover, label="not turned"),
        on("reached", "RETURNING", "DONE", from_mover),
        on("resumed", ["HOMING", "ZEROING"], "HOMING"),
        on("resumed", _AWAY_FROM_START, "LIFTING", do=note_astray),
        on("resumed", ["UNTURNING", "RETURNING"], "RETURNING"),
        on("deadline", "WAITING", "FAILED", do=TipTrial.conclude_late),
    )
