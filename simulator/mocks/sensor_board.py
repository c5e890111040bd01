"""The sensor board of the mock bench: what the plant does, sampled and quantised in the process."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.core.clock import last_tick
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Excite,
    Listen,
    SampleBlock,
    SetTendon,
    Tare,
)
from drivers.sensor_board.commands import BoardLimits
from drivers.sensor_board.streams import stream_info
from simulator.mocks.base import MockSensor

INT32 = np.iinfo(np.int32)


class MockSensorBoardSettings(BoardLimits):
    """The mock board: the real one's limits, without its link."""

    block_samples: int = Field(default=4096, ge=1, le=65536)
    """Longest block that `read` hands out; what has arrived is cut into blocks of at most this length."""


class MockSensorBoard(MockSensor):
    """Samples the plant on the board's own grid (sample k at k / rate), computing only what is subscribed."""

    _settings: MockSensorBoardSettings

    def _wire(self) -> None:
        self._infos = {
            spec.name: stream_info(
                f"{self.name}.{spec.name}", spec.channels, spec.unit, spec.scale, spec.rate_hz
            )
            for spec in self._bench.streams()
        }

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._excited = False
        self._subscribed: frozenset[str] = frozenset()
        self._next_sample = dict.fromkeys(self._infos, 0)
        self._seq = dict.fromkeys(self._infos, 0)
        self._zero = {name: np.zeros(len(info.channels), np.int64) for name, info in self._infos.items()}
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return DeviceInfo(
            self.name,
            model="simulated sensor board",
            streams={info.name: info for info in self._infos.values()},
            clock="bench",
        )

    def close(self) -> None:
        """Nothing to release; the excitation ends."""
        if self._excited:
            self._bench.excite(False)

    def apply(self, command: Command) -> Command:
        """Do it, now.

        Raises:
            CommandError: not for this board, or not finite.
        """
        known = [info.name for info in self._infos.values()]
        command, now_s = self._settings.checked(self.name, known, command), self._clock.now()
        if isinstance(command, Listen):
            self._listen(command, now_s)
            return command
        self._bench.advance(now_s, self._subscribed)
        if isinstance(command, Excite):
            self._excited = command.on
            self._bench.excite(command.on)
        elif isinstance(command, SetTendon):
            self._bench.set_tendon(command.position_m)
        elif isinstance(command, Tare):
            self._tare(command.stream.partition(".")[2], now_s)
        self._sent(command)
        return command

    def _listen(self, command: Listen, now_s: float) -> None:
        self._bench.advance(now_s, self._subscribed)
        streams = frozenset(stream.partition(".")[2] for stream in command.streams)
        for name in streams - self._subscribed:
            rate_hz = self._infos[name].rate_hz
            if rate_hz is not None:
                self._next_sample[name] = last_tick(now_s, rate_hz) + 1
        if "period" in streams - self._subscribed:
            self._bench.events("period")
        self._subscribed = streams
        self._bench.advance(now_s, streams)

    def _tare(self, name: str, now_s: float) -> None:
        """Zero is the present reading, as on the real board."""
        self._zero[name] += self._counts(name, np.array([now_s]))[0]

    def read(self) -> Sequence[SampleBlock]:
        """What the board sampled since the last call."""
        now_s = self._clock.now()
        self._bench.advance(now_s, self._subscribed)
        blocks: list[SampleBlock] = []
        for name in sorted(self._subscribed):
            blocks += self._waveform(name, now_s) if self._infos[name].rate_hz else self._events(name, now_s)
        return self._arrived(blocks, now_s)

    def _waveform(self, name: str, now_s: float) -> list[SampleBlock]:
        info = self._infos[name]
        assert info.rate_hz is not None
        last = last_tick(now_s, info.rate_hz)
        first = self._next_sample[name]
        if last < first:
            return []
        self._next_sample[name] = last + 1
        times_s = np.arange(first, last + 1) / info.rate_hz
        counts = self._counts(name, times_s)
        blocks = []
        for start in range(0, len(counts), self._settings.block_samples):
            part = counts[start : start + self._settings.block_samples]
            blocks.append(self._block(name, part, float(times_s[start]), None, now_s))
        return blocks

    def _counts(self, name: str, times_s: NDArray[np.float64]) -> NDArray[np.int32]:
        values = self._bench.sample(name, times_s).reshape(len(times_s), -1)
        if self._faults.active(float(times_s[-1]), "full_scale"):
            values = np.full_like(values, INT32.min * self._infos[name].scale)
        counts = np.rint(values / self._infos[name].scale) - self._zero[name]
        clipped = counts.clip(INT32.min, INT32.max).astype(np.int32)
        return np.asarray(self._faults.held(float(times_s[-1]), name, clipped))

    def _events(self, name: str, now_s: float) -> list[SampleBlock]:
        ends_s, values = self._bench.events(name)
        scale = self._infos[name].scale
        blocks = []
        for start in range(0, len(ends_s), self._settings.block_samples):
            times_s = ends_s[start : start + self._settings.block_samples]
            counts = np.rint(values[start : start + self._settings.block_samples] / scale).astype(np.int32)
            blocks.append(self._block(name, counts[:, None], float(times_s[0]), times_s, now_s))
        return blocks

    def _block(
        self,
        name: str,
        counts: NDArray[np.int32],
        t0_s: float,
        times_s: NDArray[np.float64] | None,
        now_s: float,
    ) -> SampleBlock:
        info = self._infos[name]
        block = info.block(self._seq[name], t0_s, counts, times_s=times_s, device_t0_s=t0_s, arrival_s=now_s)
        self._seq[name] += len(counts)
        return block
