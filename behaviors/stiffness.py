"""A6, A4b: a contact at rest as in A1, then the finger rings without its drive (Backus and Dollar, II, V.A, V.C)."""

from pydantic import Field

from behaviors.machine import StatePlan, on
from behaviors.static import Static, StaticSettings
from drivers.core.settings import StreamName


class StiffnessSettings(StaticSettings):
    """How one contact is recorded, and the ringing after it."""

    distal_stream: StreamName | None = None
    """A second accelerometer, on the distal link (m/s2); "none": there is none."""

    ring_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """How long the finger is recorded after the drive went off. Assumption: several times what the ringing lasts."""


class Stiffness(Static):
    """Place the probe, wait for equilibrium, record, switch the drive off, record."""

    table = (
        *(
            row._replace(dest="RINGING")
            if row.sources == ("RECORDING",) and row.dest == "RETRACTING"
            else row
            for row in Static.table
        ),
        on("deadline", "RINGING", "RETRACTING"),
        on("resumed", "RINGING", "RETRACTING"),
    )

    settings: StiffnessSettings

    def _plan(self) -> dict[str, StatePlan]:
        plans = super()._plan()
        settings, measured = self.settings, plans["RECORDING"].measures
        measured |= self.measured(settings.distal_stream)
        for name, lasts_s in (("RECORDING", settings.record_s), ("RINGING", settings.ring_s)):
            plans[name] = StatePlan(lasts_s, frozenset(), measured, prompt=False)
        return plans

    def enter_RINGING(self) -> None:
        """Without the drive."""
        self.excite(False)
