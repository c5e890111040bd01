"""C1: sweep the drive for the frequency that transfers best (Rupavatharam et al., III.A.2)."""

from typing import Self

from pydantic import Field, model_validator

from behaviors.machine import Behavior, StatePlan, concluding, on, sent_by
from drivers.core.messages import Chirp, Excite
from drivers.core.settings import DeviceName, Settings, StreamName


class ChirpSettings(Settings):
    """How the drive is swept."""

    exciter: DeviceName = "audio"
    """Device that drives the fingers' transducers."""

    fingers_stream: StreamName = "audio.fingers"
    """What the fingers send back: the carrier itself."""

    from_hz: float = Field(default=20_000.0, gt=0.0, le=1e6)
    """Where the sweep begins. Assumption: audible frequencies are left out."""

    to_hz: float = Field(default=46_000.0, gt=0.0, le=1e6)
    """Where it ends. Assumption: short of half of 96 kHz, where the converter's own filter begins."""

    duration_s: float = Field(default=4.0, gt=0.0, le=600.0)
    """How long it takes."""

    level: float = Field(default=0.5, gt=0.0, le=1.0)
    """Amplitude of the drive as a share of full scale."""

    settle_s: float = Field(default=0.2, ge=0.0, le=60.0)
    """Silence before the sweep: the converter runs, and the noise is recorded."""

    @model_validator(mode="after")
    def _upwards(self) -> Self:
        if self.from_hz >= self.to_hz:
            raise ValueError("from_hz must be below to_hz: the sweep goes upwards")
        return self


class ChirpSweep(Behavior):
    """Listen to silence, sweep, listen on."""

    def __init__(self, settings: ChirpSettings, factors: Settings, detectors: frozenset[str]) -> None:
        measured, exciter = frozenset((settings.fingers_stream,)), settings.exciter
        sweep = Chirp(exciter, settings.from_hz, settings.to_hz, settings.duration_s, settings.level)
        self.settings = settings
        super().__init__(
            {
                "SILENT": StatePlan(
                    settings.settle_s, frozenset(), measured, False, [Excite(exciter, False)]
                ),
                "SWEEPING": StatePlan(settings.duration_s + 5.0, frozenset(), measured, False, [sweep]),
                "RINGING": StatePlan(settings.settle_s, frozenset(), measured, prompt=False),
            }
        )

    def enter_FAILED(self) -> None:
        """Silence after an error."""
        self.command(Excite(self.settings.exciter, False))

    table = (
        on("deadline", "SILENT", "SWEEPING"),
        on("reached", "SWEEPING", "RINGING", sent_by("exciter"), label="sweep over"),
        on("deadline", "RINGING", "DONE", do=concluding("swept")),
        on("resumed", ["SILENT", "SWEEPING"], "SILENT"),
    )
