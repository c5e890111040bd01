"""The tactile matrices of the mock bench: what their texels feel, sampled in the process."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from drivers.core.clock import last_tick
from drivers.core.errors import check_streams, wrong
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Listen,
    SampleBlock,
    Saturated,
    StreamInfo,
)
from drivers.core.settings import Settings
from drivers.dsa_matrix import codec
from simulator.devices.dsa_matrix import counts
from simulator.mocks.base import MockSensor
from simulator.physics.bench import part


class MockDsaMatrixSettings(Settings):
    """The mock matrices."""

    frame_hz: int = Field(default=100, ge=1, le=1000)
    """Frames a second, as in the real driver; no line is too slow here."""

    threshold_counts: int = Field(default=0, ge=0, le=codec.TEXEL_MAX)
    """Texels below this are reported as 0."""


class MockDsaMatrix(MockSensor):
    """Samples the texels on its own grid (frame k at k / frame_hz), only while subscribed."""

    _settings: MockDsaMatrixSettings

    def _wire(self) -> None:
        part(self._bench, "texels_v", self.name)
        channels = codec.channel_names((matrix.rows, matrix.columns) for matrix in self._bench.matrices())
        rate_hz = float(self._settings.frame_hz)
        self._info = StreamInfo(f"{self.name}.taxels", channels, "V", codec.VOLT_PER_COUNT, rate_hz)

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._next: int | None = None
        self._seq = 0
        self._saturated = False
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return DeviceInfo(
            self.name, model="simulated DSA 9210", streams={self._info.name: self._info}, clock="bench"
        )

    def apply(self, command: Command) -> Command:
        """Subscribe to the texels, or unsubscribe.

        Raises:
            CommandError: not for these matrices.
        """
        now_s = self._clock.now()
        if not isinstance(command, Listen):
            raise wrong(self.name, command, "it has no such command", "matrices can Listen")
        check_streams(self.name, command, command.streams, (self._info.name,))
        if bool(command.streams) != (self._next is not None):
            self._next = last_tick(now_s, self._settings.frame_hz) + 1 if command.streams else None
            self._sent(command)
        return command

    def read(self) -> Sequence[SampleBlock]:
        """Frames since the last call."""
        now_s, rate_hz = self._clock.now(), self._settings.frame_hz
        self._bench.advance(now_s)
        last = last_tick(now_s, rate_hz)
        if self._next is None or last < self._next:
            return ()
        times_s = np.arange(self._next, last + 1) / rate_hz
        self._next = last + 1
        texels = counts(self._bench.texels_v(times_s), self._settings.threshold_counts)
        if self._faults.active(now_s, "full_scale"):
            texels = np.full_like(texels, codec.TEXEL_MAX)
        t0_s = float(times_s[0])
        block = self._info.block(self._seq, t0_s, texels.astype(np.int32), device_t0_s=t0_s, arrival_s=now_s)
        self._seq += len(block)
        arrived = self._arrived((block,), now_s)
        for one in arrived:
            self._watch(one)
        return arrived

    def _watch(self, block: SampleBlock) -> None:
        """Report each excursion to a texel's end once."""
        full = (block.values >= codec.TEXEL_MAX).any(axis=1)
        for place in np.flatnonzero(np.diff(full, prepend=self._saturated)):
            self._saturated = not self._saturated
            if self._saturated:
                value = codec.TEXEL_MAX * self._info.scale
                self._statuses.append(Saturated(float(block.times[place]), self.name, block.stream, value))
