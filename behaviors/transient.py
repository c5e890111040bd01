"""A2: approach at constant speed until contact is detected, stop, retract (Backus and Dollar, III.C)."""

from typing import Literal, Self

from pydantic import Field, model_validator

from behaviors.approach import Approaching, approaching, see_that_it_leads_on
from behaviors.events import Detected
from behaviors.finger import FingerTrial, FingerTrialSettings
from behaviors.machine import StatePlan, concluding, from_mover, on
from drivers.core.messages import MoveTo
from drivers.core.settings import DetectorName, Settings, StreamName


class TransientSettings(FingerTrialSettings):
    """How one approach is run."""

    detector: DetectorName = "contact"
    """Detector whose contact stops the approach; the profile's others are armed and recorded."""

    position_stream: StreamName = "stage.position"
    """Where the mover is (m)."""

    waveform_streams: tuple[StreamName, ...] = ()
    """The finger's accelerometers (m/s2), where they are to be recorded: proximal link, then distal."""

    baseline_timeout_s: float = Field(default=30.0, gt=0.0, le=3600.0)
    """Longest wait for every detector's baseline."""

    start_m: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Where the approach starts, on the mover's axis."""

    approach_limit_m: float = Field(default=0.010, gt=0.0, le=1.0)
    """Where an approach without contact ends."""

    position_speed_m_s: float = Field(default=0.010, gt=0.0, le=1.0)
    """Speed of going to the start and of retracting."""

    hold_s: float = Field(default=0.3, ge=0.0, le=60.0)
    """How long the contact is recorded after standstill, before the retraction."""

    @model_validator(mode="after")
    def _leads_on(self) -> Self:
        see_that_it_leads_on(self.start_m, self.approach_limit_m)
        return self


class TransientFactors(Settings):
    """What a trial varies."""

    speed_m_s: float = Field(gt=0.0, le=1.0)
    """Speed of the approach."""

    location: Literal["a", "b", "c", "d", "e", "f", "g", "h", "p"] = "f"
    """Where the probe touches (Fig. 6; p: the middle of the proximal link); set by hand on a real bench."""


class Transient(FingerTrial, Approaching):
    """Approach until contact.

    Args:
        detectors: Names of all detectors that listen, the acting one among them.
    """

    settings: TransientSettings

    def __init__(
        self, settings: TransientSettings, factors: TransientFactors, detectors: frozenset[str]
    ) -> None:
        self.settings = settings
        self.factors = factors
        self._detectors = detectors
        self._ready: set[str] = set()
        self._settled = False
        self._measured = self.measured(
            settings.load_cell_stream,
            settings.period_stream,
            settings.position_stream,
            *settings.waveform_streams,
        )
        super().__init__(self._plan(), settings.mover, frozenset({settings.detector}))

    def _plan(self) -> dict[str, StatePlan]:
        """What each state needs."""
        settings, detectors, measured = self.settings, self._detectors, self._measured
        motion = settings.motion_timeout_s
        limit_m = settings.approach_limit_m
        way_m = limit_m - settings.start_m
        back = [MoveTo(settings.mover, settings.start_m, settings.position_speed_m_s)]
        return {
            "HOMING": StatePlan(settings.home_timeout_s),
            "STARTING": StatePlan(motion, commands=back),
            "SETTLING": StatePlan(settings.settle_s),
            "BASELINE": StatePlan(settings.baseline_timeout_s, detectors, measured, prompt=False),
            "APPROACH": self.approach(
                settings.detector,
                self.factors.speed_m_s,
                limit_m,
                way_m,
                StatePlan(motion, detectors, measured),
            ),
            "STOPPING": StatePlan(motion, frozenset(), measured),
            "HOLDING": StatePlan(settings.hold_s, frozenset(), measured, prompt=False),
            "RETRACTING": StatePlan(motion, commands=back),
        }

    def listens(self) -> bool:
        """Whether the trial goes on without this detector."""
        return not self.decisive()

    def all_ready(self) -> bool:
        """Whether this was the last baseline that was waited for."""
        assert isinstance(self.event, Detected)
        self._ready.add(self.event.detector)
        return self._ready >= self._detectors

    def enter_BASELINE(self) -> None:
        """Every detector learns anew."""
        self._settled = True
        self._ready.clear()

    enter_APPROACH = Approaching.go_until_contact
    too_early = concluding("contact")
    """The acting detector reported contact before the approach began: the measure will call it false."""

    table = (
        on("reached", "HOMING", "STARTING", from_mover),
        on("reached", "STARTING", "SETTLING", from_mover, lambda it: not it._settled, label="first time"),
        on("reached", "STARTING", "BASELINE", from_mover, label="after a pause"),
        on("deadline", "SETTLING", "BASELINE"),
        on("baseline_ready", "BASELINE", "APPROACH", all_ready, label="all detectors"),
        on("baseline_refused", "BASELINE", "APPROACH", listens, all_ready, label="the last one"),
        on("contact", "BASELINE", "RETRACTING", Approaching.touched, do=too_early, label="too early"),
        *approaching("APPROACH", stopped="HOLDING", missed="RETRACTING"),
        on("deadline", "HOLDING", "RETRACTING"),
        on("reached", "RETRACTING", "DONE", from_mover),
        on("resumed", ["STARTING", "BASELINE", "APPROACH"], "STARTING"),
        on("resumed", "HOMING", "HOMING"),
        on("resumed", ["STOPPING", "HOLDING", "RETRACTING"], "RETRACTING"),
        on("deadline", "BASELINE", "FAILED", do=Approaching.conclude_late),
    )
