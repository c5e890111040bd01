"""The tactile matrices of the mock bench: what their texels feel, sampled in the process."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.core.messages import Command, Listen, SampleBlock, Saturated, StreamInfo
from drivers.core.settings import Settings
from drivers.core.wire import check_sensor
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
    """Samples the texels, frame by frame."""

    model = "simulated DSA 9210"
    _settings: MockDsaMatrixSettings

    def _wire(self) -> None:
        part(self._bench, "texels_v", self.name)
        channels = codec.channel_names((matrix.rows, matrix.columns) for matrix in self._bench.matrices())
        rate_hz = float(self._settings.frame_hz)
        info = StreamInfo(f"{self.name}.taxels", channels, "V", codec.VOLT_PER_COUNT, rate_hz)
        self._infos = {info.name: info}

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._saturated = False
        super().restart()

    def apply(self, command: Command) -> Command:
        """Subscribe to the texels, or unsubscribe.

        Raises:
            CommandError: not for these matrices.
        """
        check_sensor(self.name, command, self._infos, "matrices", (Listen,))
        if isinstance(command, Listen) and command.streams != self._next.keys():
            self._subscribe(command.streams, self._clock.now())
            self._sent(command)
        return command

    def read(self) -> Sequence[SampleBlock]:
        """Frames since the last call."""
        blocks = super().read()
        for block in blocks:
            self._watch(block)
        return blocks

    def _counts(self, stream: str, times_s: NDArray[np.float64]) -> NDArray[np.int32]:
        texels = counts(self._bench.texels_v(times_s), self._settings.threshold_counts)
        if self._faults.active(self._clock.now(), "full_scale"):
            texels = np.full_like(texels, codec.TEXEL_MAX)
        return texels.astype(np.int32)

    def _watch(self, block: SampleBlock) -> None:
        """Report each excursion to a texel's end once."""
        full = (block.values >= codec.TEXEL_MAX).any(axis=1)
        for place in np.flatnonzero(np.diff(full, prepend=self._saturated)):
            self._saturated = not self._saturated
            if self._saturated:
                value = codec.TEXEL_MAX * block.scale
                self._statuses.append(Saturated(float(block.times[place]), self.name, block.stream, value))
