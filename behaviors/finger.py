"""What the experiments with the oscillating finger share: its devices and streams, and how a trial begins and ends."""

from __future__ import annotations

from pydantic import Field

from behaviors.machine import Behavior
from drivers.core.messages import Excite, Home
from drivers.core.settings import DeviceName, Settings, StreamName


class FingerTrialSettings(Settings):
    """The probe, the finger and the streams of both."""

    mover: DeviceName = "stage"
    """Device that carries the probe."""

    exciter: DeviceName = "board"
    """Device that switches the finger's excitation."""

    load_cell_stream: StreamName = "board.load_cell"
    """The reference: force behind the probe (N)."""

    period_stream: StreamName = "board.period"
    """Period counts of the excitation (s)."""

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
        self.command(Excite(self.settings.exciter, True))
        self.command(Home(self.settings.mover))

    def enter_DONE(self) -> None:
        """The finger rests."""
        self.command(Excite(self.settings.exciter, False))

    def enter_FAILED(self) -> None:
        """Nothing moves after an error."""
        super().enter_FAILED()
        self.command(Excite(self.settings.exciter, False))
