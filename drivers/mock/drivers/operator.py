"""The person of the mock bench: the real driver on the emulated person, over a line in memory."""

from __future__ import annotations

import math

from drivers.clock import Clock
from drivers.mock.devices.faults import FaultSchedule
from drivers.mock.devices.memory_line import MemoryLine
from drivers.mock.devices.operator import EmulatedPerson
from drivers.mock.physics.bench import Bench
from drivers.mock.physics.weight_set import HandSettings
from drivers.operator.driver import Person, PersonSettings


class MockPersonSettings(HandSettings, PersonSettings):
    """The simulated person, within the real one's limits."""

    port: str = "mock"


class MockPerson(Person):
    """Answers every request after a while, and hangs the weights on the bench.

    Its faults: "silent", "lose" and "corrupt" (no answer arrives), "refuse" (it says no), "unplug" (it has left).
    """

    def __init__(
        self,
        name: str,
        settings: MockPersonSettings,
        clock: Clock,
        bench: Bench,
        faults: FaultSchedule | None = None,
    ) -> None:
        self._twin = EmulatedPerson(settings, bench)
        super().__init__(name, settings, clock, MemoryLine(self._twin, clock, faults).connect)

    def restart(self) -> None:
        """Begin a trial: nothing is asked for."""
        self._prepare()
        self._twin.restart()

    @property
    def alone_s(self) -> float:
        """For how long nobody need look: then they do what was asked for."""
        return math.inf if self._asked is None else self._twin.due_s - self._clock.now()
