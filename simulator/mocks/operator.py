"""The person of the mock bench: the real driver on the emulated person."""

import math

from drivers.operator.driver import Person, PersonSettings
from simulator.devices.operator import EmulatedPerson, HandSettings
from simulator.mocks.base import OverMemory


class MockPersonSettings(HandSettings, PersonSettings):
    """The simulated person, within the real one's limits."""

    port: str = "mock"


class MockPerson(OverMemory, Person):
    """Answers every request after a while, and hangs the weights on the bench."""

    _far_end = EmulatedPerson

    @property
    def alone_s(self) -> float:
        """How long it may go unread: then the request is done."""
        return math.inf if self._asked is None else self._twin.ready_s - self._clock.now()
