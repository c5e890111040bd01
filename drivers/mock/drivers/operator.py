"""The person of the mock bench: does what is asked for, in virtual time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.errors import RefusedError
from drivers.messages import (
    Answered,
    Applied,
    Ask,
    Command,
    DeviceInfo,
    Listen,
    Loaded,
    LoadWeight,
    SampleBlock,
    Status,
)
from drivers.mock.drivers.base import MockDriver
from drivers.mock.physics.weight_set import Hands, HandSettings
from drivers.operator.requests import LoadLimits, Loads, load_stream, valid


class MockPersonSettings(HandSettings, LoadLimits):
    """The simulated person, within the real one's limits."""


class MockPerson(MockDriver):
    """Answers every request after a while, and hangs the weights on the bench.

    Its faults: "silent" and "lose" (no answer), "refuse" (it says no), "unplug" (it has left).
    """

    _settings: MockPersonSettings

    def _wire(self) -> None:
        self._hands = Hands(self._settings, self._bench)

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._loads = Loads(self.name)
        self._asked: Ask | LoadWeight | None = None
        self._due_s = 0.0
        super().restart()

    def open(self) -> DeviceInfo:
        """Nobody to wait for."""
        info = load_stream(self.name)
        return DeviceInfo(self.name, model="simulated person", streams={info.name: info}, clock="bench")

    def close(self) -> None:
        """Nothing is asked for any more."""
        self._asked = None

    def apply(self, command: Command) -> Applied:
        """Ask; a newer request replaces an older one.

        Raises:
            CommandError: not for a person, or a load that the sensor does not bear.
        """
        now_s = self._clock.now()
        if isinstance(command, Listen):
            self._loads.listen(command.streams)
            return Applied(command, now_s)
        self._asked = valid(self.name, self._settings, command)
        self._due_s = now_s + self._settings.answer_s
        self._sent(command)
        return Applied(command, now_s)

    def read(self) -> Sequence[SampleBlock]:
        """What hangs on the sensor, where it has changed since the last call."""
        self._work()
        return self._loads.take()

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""
        self._work()
        return super().poll()

    @property
    def alone_s(self) -> float:
        """For how long nobody need look: then they do what was asked for."""
        return math.inf if self._asked is None else self._due_s - self._clock.now()

    def _cut_off(self, now_s: float) -> None:
        """They have left."""
        self._asked = None

    def _work(self) -> None:
        now_s = self._clock.now()
        if self._asked is None or now_s < self._due_s or self._gone(now_s) or self._garbled(now_s):
            return
        asked, self._asked = self._asked, None
        if self._faults.active(now_s, "refuse"):
            self._refuse(asked, "the person says no (injected fault)")
        elif isinstance(asked, Ask):
            self._say(Answered(now_s, self.name, asked.request, command_id=asked.id))
        else:
            self._hang(asked, now_s)

    def _hang(self, asked: LoadWeight, now_s: float) -> None:
        try:
            self._hands.hang(now_s, asked.bridge, asked.force_n)
        except RefusedError as error:
            self._refuse(asked, f"{error.reason}; {error.advice}")
            return
        self._loads.hang(now_s, asked.bridge, asked.force_n)
        self._say(Loaded(now_s, self.name, asked.bridge, asked.force_n, command_id=asked.id))
