"""The sensor board of the mock bench: what the plant does, sampled and quantised in the process."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.core.messages import Command, Excite, Listen, SampleBlock, SetTendon, Tare
from drivers.sensor_board.commands import BoardLimits
from drivers.sensor_board.streams import stream_info
from simulator.mocks.base import MockSensor

INT32 = np.iinfo(np.int32)


class MockSensorBoardSettings(BoardLimits):
    """The mock board: the real one's limits, without its link."""

    block_samples: int = Field(default=4096, ge=1, le=65536)
    """Longest block that `read` hands out; what has arrived is cut into blocks of at most this length."""


class MockSensorBoard(MockSensor):
    """Samples the plant on the board's own grid; a stream without a rate comes as the plant's events."""

    model = "simulated sensor board"
    _settings: MockSensorBoardSettings

    def _wire(self) -> None:
        self._longest = self._settings.block_samples
        infos = (
            stream_info(f"{self.name}.{spec.name}", spec.channels, spec.unit, spec.scale, spec.rate_hz)
            for spec in self._bench.streams()
        )
        self._infos = {info.name: info for info in infos}

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._excited = False
        self._zero = {name: np.zeros(len(info.channels), np.int64) for name, info in self._infos.items()}
        super().restart()

    def close(self) -> None:
        """Nothing to release; the excitation ends."""
        if self._excited:
            self._bench.excite(False)

    def apply(self, command: Command) -> Command:
        """Do it, now.

        Raises:
            CommandError: not for this board, or not finite.
        """
        command, now_s = self._settings.checked(self.name, list(self._infos), command), self._clock.now()
        self._advance(now_s)
        if isinstance(command, Listen):
            for stream in command.streams - self._next.keys():
                if self._infos[stream].rate_hz is None:
                    self._bench.events(_short(stream))  # those from before
            self._subscribe(command.streams, now_s)
            self._advance(now_s)
            return command
        if isinstance(command, Excite):
            self._excited = command.on
            self._bench.excite(command.on)
        elif isinstance(command, SetTendon):
            self._bench.set_tendon(command.position_m)
        elif isinstance(command, Tare):
            # zero is the present reading, as on the real board
            self._zero[command.stream] += self._counts(command.stream, np.array([now_s]))[0]
        self._sent(command)
        return command

    def _advance(self, now_s: float) -> None:
        self._bench.advance(now_s, frozenset(map(_short, self._next)))

    def _due(self, stream: str, now_s: float) -> Sequence[SampleBlock]:
        if self._infos[stream].rate_hz is not None:
            return super()._due(stream, now_s)
        ends_s, values = self._bench.events(_short(stream))
        blocks = []
        for start in range(0, len(ends_s), self._longest):
            times_s = ends_s[start : start + self._longest]
            counts = np.rint(values[start : start + self._longest] / self._infos[stream].scale)
            blocks.append(
                self._block(stream, float(times_s[0]), counts.astype(np.int32)[:, None], now_s, times_s)
            )
        return blocks

    def _counts(self, stream: str, times_s: NDArray[np.float64]) -> NDArray[np.int32]:
        scale = self._infos[stream].scale
        values = self._bench.sample(_short(stream), times_s).reshape(len(times_s), -1)
        if self._faults.active(float(times_s[-1]), "full_scale"):
            values = np.full_like(values, INT32.min * scale)
        counts = np.rint(values / scale) - self._zero[stream]
        return np.asarray(counts.clip(INT32.min, INT32.max), np.int32)


def _short(stream: str) -> str:
    """A stream's name on the board."""
    return stream.partition(".")[2]
