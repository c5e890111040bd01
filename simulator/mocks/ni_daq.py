"""A device with analog inputs on the mock bench: what its inputs show, sampled in the process."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.messages import Command, Listen
from drivers.ni_daq.driver import DaqInputs
from drivers.ni_daq.settings import DaqLimits
from simulator.devices.serial_lines import shown_columns
from simulator.mocks.base import MockSensor


class MockNiDaqSettings(DaqLimits):
    """The simulated device."""


class MockNiDaq(MockSensor):
    """Samples what its inputs show, without noise of its own, within its range."""

    model = "simulated analog inputs"
    _settings: MockNiDaqSettings

    def _wire(self) -> None:
        self._inputs = DaqInputs(self.name, self._settings)
        self._infos = self._inputs.infos
        self._shown = {
            f"{self.name}.{own}": list(shown_columns({own: stream}, self._bench, self.name))
            for own, stream in self._settings.streams.items()
        }

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._inputs.forget()
        super().restart()

    def apply(self, command: Command) -> Command:
        """Listen to streams, or tare one.

        Raises:
            CommandError: not for such a device.
        """
        wanted = self._inputs.valid(command)
        if isinstance(wanted, Listen):
            self._subscribe(wanted.streams, self._clock.now())
        elif self._inputs.tare(wanted.stream):
            self._sent(wanted)
        else:
            self._refuse(wanted, "no samples of it yet; listen to it first")
        return command

    def account(self) -> Mapping[str, object]:
        """The volts at zero."""
        return {"zero_v": self._inputs.zeros()}

    def _subscribe(self, streams: Iterable[str], now_s: float) -> None:
        named = frozenset(streams)
        sources = frozenset(column.source for stream in named for column in self._shown[stream])
        self._bench.read(self.name, sources)
        super()._subscribe(named, now_s)

    def _counts(self, stream: str, times_s: NDArray[np.float64]) -> Any:
        now_s, range_v = self._clock.now(), self._settings.range_v
        volts = np.empty((len(times_s), len(self._shown[stream])))
        for source, channel, column, scale, offset in self._shown[stream]:
            felt = np.asarray(self._bench.sample(source, times_s)).reshape(len(times_s), -1)[:, channel]
            volts[:, column] = np.clip(felt / scale + offset, -range_v, range_v)
        if self._faults.active(now_s, "full_scale"):
            volts[:] = range_v
        return self._inputs.counts(stream, self._faults.held(now_s, stream, volts))
