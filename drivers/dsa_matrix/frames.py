"""From the frames of a controller to sample blocks: time extended, loss and saturation seen. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import Clock
from drivers.core.messages import Lost, SampleBlock, Saturated, Status, StreamInfo
from drivers.core.numbering import DeviceClock, SampleStream
from drivers.dsa_matrix import codec


class MatrixFrames:
    """From the controller's frames to sample blocks, on its own clock. Pure: it asks no clock.

    Frames are dated by the controller's clock; a step of more than one and a half periods is loss
    (`numbering.StreamTrack`).

    Args:
        device: Name in the profile.
        info: Of the stream.
        clock: Turns monotonic time into bench time.
        max_drift_ppm: Bound on the drift of the controller's clock.

    Attributes:
        clock: The controller's.
        wrong: Frames whose number of cells is not that of the matrices.
        lost: Frames lost so far.
    """

    def __init__(self, device: str, info: StreamInfo, clock: Clock, max_drift_ppm: float) -> None:
        self.clock = DeviceClock(max_drift_ppm, wrap_s=codec.TIME_MODULUS * 1e-3)
        self.wrong = 0
        self.lost = 0
        self._device = device
        self._info = info
        self._stream = SampleStream[NDArray[np.uint16]](info, self.clock, clock, np.int32)
        self._saturated = False
        self._statuses: list[Status] = []

    def begin(self) -> None:
        """The stream was subscribed again: what is missing before the next frame is not lost."""
        self._stream.begin()
        self._saturated = False

    def push(self, frame: codec.Frame, arrival_s: float) -> None:
        """Take a frame that was in hand at monotonic time `arrival_s`."""
        if len(frame.texels) != len(self._info.channels):
            self.wrong += 1
            return
        bench_s, lost = self._stream.push(frame.texels, frame.time_ms * 1e-3, arrival_s)
        if lost is not None:
            self.lost += lost
            self._statuses.append(Lost(bench_s, self._device, self._info.name, lost))
        self._watch(frame, bench_s)

    def take_blocks(self) -> Sequence[SampleBlock]:
        """Blocks since the last call."""
        return self._stream.take()

    def take_statuses(self) -> list[Status]:
        """Statuses since the last call."""
        statuses, self._statuses = self._statuses, []
        return statuses

    def _watch(self, frame: codec.Frame, bench_s: float) -> None:
        full = bool((frame.texels >= codec.TEXEL_MAX).any())
        if full and not self._saturated:
            value = codec.TEXEL_MAX * self._info.scale
            self._statuses.append(Saturated(bench_s, self._device, self._info.name, value))
        self._saturated = full
