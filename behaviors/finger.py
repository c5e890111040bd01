"""What the experiments with the oscillating finger share: its devices and streams, and how a trial begins and ends."""

from pydantic import Field

from behaviors.machine import Behavior
from drivers.core.messages import Excite, Home
from drivers.core.settings import DeviceName, Settings, StreamName


class FingerTrialSettings(Settings):
    """The probe, the finger and the streams of both."""

    mover: DeviceName = "stage"
    """Device that carries the probe."""

    exciter: DeviceName | None = "board"
    """Device that switches the finger's excitation; "none": it is on, by a circuit that nothing here switches."""

    load_cell_stream: StreamName | None = "board.load_cell"
    """The reference: force behind the probe (N); "none": it is not measured."""

    load_cell_channel: int = Field(default=0, ge=0, le=63)
    """Which of its channels a push makes positive: of an arm's own force 2 (fz), where it comes from above."""

    period_stream: StreamName | None = "board.period"
    """Period counts of the excitation (s); "none": they are not counted."""

    settle_s: float = Field(default=90.0, ge=0.0, le=3600.0)
    """Wait after power-on (III.B: 90 s)."""

    motion_timeout_s: float = Field(default=30.0, gt=0.0, le=600.0)
    """Longest stay in any state that waits for the mover."""

    home_timeout_s: float = Field(default=60.0, gt=0.0, le=600.0)
    """Longest homing."""


class FingerTrial(Behavior):
    """What such a trial commands at its beginning and its end."""

    settings: FingerTrialSettings

    def enter_HOMING(self) -> None:
        """Know where the mover is, excite the finger."""
        self.excite(True)
        self.command(Home(self.settings.mover))

    def enter_DONE(self) -> None:
        """The finger rests."""
        self.excite(False)

    def enter_FAILED(self) -> None:
        """Nothing moves after an error."""
        super().enter_FAILED()
        self.excite(False)

    def excite(self, on: bool) -> None:
        """Switch the excitation, where a device does."""
        if self.settings.exciter is not None:
            self.command(Excite(self.settings.exciter, on))

    def measured(self, *streams: str | None) -> frozenset[str]:
        """Those of the streams that this bench has."""
        return frozenset(stream for stream in streams if stream is not None)
