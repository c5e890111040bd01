"""A1: none, light or full contact, at rest; the finger's waveform (Backus and Dollar, III.C, Fig. 4)."""

from collections.abc import Sequence
from typing import ClassVar, Literal

from pydantic import Field

from behaviors.finger import FingerTrial, FingerTrialSettings
from behaviors.machine import Row, StatePlan, concluding, from_mover, on
from drivers.core.messages import MoveTo
from drivers.core.settings import Settings, StreamName

Condition = Literal["none", "light", "full"]


class StaticSettings(FingerTrialSettings):
    """How one static contact is recorded."""

    accelerometer_stream: StreamName = "board.accelerometer"
    """The finger's waveform (m/s2)."""

    none_m: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Position without contact, on the mover's axis; where the trial starts and ends."""

    light_m: float = Field(ge=-1.0, le=1.0)
    """Position where the probe meets the finger for a part of each oscillation (III.C)."""

    full_m: float = Field(ge=-1.0, le=1.0)
    """Position where it never leaves it (III.C)."""

    speed_m_s: float = Field(default=0.002, gt=0.0, le=1.0)
    """Speed of going there. Assumption: slow enough to disturb nothing."""

    zero_s: float = Field(default=1.0, gt=0.0, le=60.0)
    """Last part of `settle_s`, in which the load cell's zero is taken: nothing touches. Assumption: 28 periods."""

    rest_s: float = Field(default=5.0, ge=0.0, le=600.0)
    """Wait for equilibrium after placing (III.C: "waiting for the system to reach equilibrium")."""

    record_s: float = Field(default=4.0, gt=0.0, le=600.0)
    """Length of the representative sample."""


class StaticFactors(Settings):
    """What a trial varies."""

    condition: Condition
    """Which of the three contacts."""

    location: Literal["a", "b", "c", "d", "e", "f", "g", "h"] = "f"
    """Where the probe touches (Fig. 6); set by hand on a real bench."""


class Static(FingerTrial):
    """Place the probe, wait for equilibrium, record."""

    table: ClassVar[Sequence[Row]] = (
        on("reached", "HOMING", "STARTING", from_mover),
        on("reached", "STARTING", "SETTLING", from_mover),
        on("deadline", "SETTLING", "ZEROING"),
        on("deadline", "ZEROING", "PLACING"),
        on("reached", "PLACING", "RESTING", from_mover),
        on("deadline", "RESTING", "RECORDING"),
        on("deadline", "RECORDING", "RETRACTING", do=concluding("recorded")),
        on("reached", "RETRACTING", "DONE", from_mover),
        on("resumed", "HOMING", "HOMING"),
        on("resumed", "STARTING", "STARTING"),
        on("resumed", "ZEROING", "ZEROING"),
        on("resumed", ["PLACING", "RESTING", "RECORDING"], "PLACING"),
        on("resumed", "RETRACTING", "RETRACTING"),
    )

    settings: StaticSettings

    def __init__(self, settings: StaticSettings, factors: StaticFactors, detectors: frozenset[str]) -> None:
        self.settings = settings
        self.factors = factors
        self.position_m = {"none": settings.none_m, "light": settings.light_m, "full": settings.full_m}[
            factors.condition
        ]
        super().__init__(self._plan(), mover=settings.mover)

    def _plan(self) -> dict[str, StatePlan]:
        """What each state needs."""
        settings, motion = self.settings, self.settings.motion_timeout_s
        measured = self.measured(
            settings.accelerometer_stream, settings.load_cell_stream, settings.period_stream
        )
        away = MoveTo(settings.mover, settings.none_m, settings.speed_m_s)
        there = MoveTo(settings.mover, self.position_m, settings.speed_m_s)
        return {
            "HOMING": StatePlan(settings.home_timeout_s),
            "STARTING": StatePlan(motion, commands=[away]),
            "SETTLING": StatePlan(max(0.0, settings.settle_s - settings.zero_s)),
            "ZEROING": StatePlan(
                settings.zero_s, frozenset(), self.measured(settings.load_cell_stream), prompt=False
            ),
            "PLACING": StatePlan(motion, commands=[there]),
            "RESTING": StatePlan(settings.rest_s),
            "RECORDING": StatePlan(settings.record_s, frozenset(), measured, prompt=False),
            "RETRACTING": StatePlan(motion, commands=[away]),
        }
