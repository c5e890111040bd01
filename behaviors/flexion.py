"""A3: approach while the tendon moves (Backus and Dollar, V.C: flexing raises the resonance as a contact does)."""

import math
from collections.abc import Sequence
from dataclasses import replace

from pydantic import Field

from behaviors.events import Event, Tick
from behaviors.machine import StatePlan, on
from behaviors.transient import Transient, TransientFactors, TransientSettings
from drivers.core.messages import Command, SetTendon
from drivers.core.settings import DeviceName, StreamName


class FlexionSettings(TransientSettings):
    """How one approach to a finger that is being flexed is run."""

    exciter: DeviceName = "board"
    """Device that switches the finger's excitation, and pulls its tendon."""

    tendon_stream: StreamName = "board.tendon"
    """Where the tendon is (m)."""

    flexed_m: float = Field(default=0.010, gt=0.0, le=0.1)
    """How far the tendon goes. Assumption: half of the board's 20 mm."""

    rest_s: float = Field(default=3.0, ge=0.0, le=60.0)
    """How long the finger stays extended before the tendon sweeps: detectors without it learn in this time, s."""

    sweep_m_s: float = Field(default=0.001, gt=0.0, le=0.1)
    """Speed of the one sweep to `flexed_m` and back in which the free resonance is learned."""

    flexing_s: float = Field(default=20.0, gt=0.0, le=600.0)
    """How long the tendon then goes to and fro, with nothing to touch, before the probe sets out; it goes on."""

    step_s: float = Field(default=0.1, gt=0.0, le=10.0)
    """Time from one position of the tendon to the next."""


class FlexionFactors(TransientFactors):
    """What a trial varies."""

    tendon_m_s: float = Field(gt=0.0, le=0.1)
    """Speed of the tendon."""


class Flexion(Transient):
    """Learn while the tendon sweeps once, flex to and fro with nothing to touch, approach while it goes on.

    Args:
        detectors: Names of all detectors that listen, the acting one among them.
    """

    table = (
        *(
            row._replace(dest="FLEXING") if row.sources == ("BASELINE",) and row.dest == "APPROACH" else row
            for row in Transient.table
        ),
        on("deadline", "FLEXING", "APPROACH"),
        on("resumed", "FLEXING", "STARTING"),
    )

    settings: FlexionSettings
    factors: FlexionFactors
    _sweeps_s = _step_due_s = 0.0

    def _plan(self) -> dict[str, StatePlan]:
        plans = super()._plan()
        self._measured |= {self.settings.tendon_stream}
        for name in ("BASELINE", "APPROACH", "STOPPING", "HOLDING"):
            plans[name] = replace(plans[name], detectors=self._detectors, measures=self._measured)
        for name in ("STARTING", "RETRACTING"):  # extended, too
            plans[name] = replace(plans[name], commands=[*plans[name].commands, self._tendon(0.0)])
        flexing = StatePlan(self.settings.flexing_s, self._detectors, self._measured, prompt=False)
        return plans | {"FLEXING": flexing}

    @property
    def due_s(self) -> float:
        """When the tendon moves on."""
        moves = ("BASELINE", "FLEXING", "APPROACH")
        return self._step_due_s if self.state in moves else math.inf

    def handle(self, event: Event) -> Sequence[Command]:
        """Handle one event, and move the tendon on where it is time."""
        commands = super().handle(event)
        if not isinstance(event, Tick) or event.t_s < self.due_s - 1e-9:
            return commands
        since_s = event.t_s - self._sweeps_s
        if self.state == "BASELINE":
            way_m = max(0.0, since_s - self.settings.rest_s) * self.settings.sweep_m_s
            way_m = min(way_m, 2.0 * self.settings.flexed_m)
        else:
            way_m = since_s * self.factors.tendon_m_s
        self._step_due_s = event.t_s + self.settings.step_s
        turned_m = way_m % (2.0 * self.settings.flexed_m)
        return [*commands, self._tendon(min(turned_m, 2.0 * self.settings.flexed_m - turned_m))]

    def _tendon(self, position_m: float) -> SetTendon:
        return SetTendon(self.settings.exciter, position_m)

    def enter_BASELINE(self) -> None:
        """Every detector learns anew, extended and while the tendon sweeps."""
        super().enter_BASELINE()
        self._sweeps_s = self._step_due_s = self.event.t_s

    def enter_FLEXING(self) -> None:
        """To and fro."""
        self._sweeps_s = self._step_due_s = self.event.t_s
