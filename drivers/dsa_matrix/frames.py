"""From the frames of a controller to sample blocks: time extended, loss and saturation seen. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.clock_model import ClockModel, Timeline
from drivers.dsa_matrix import codec
from drivers.messages import Lost, SampleBlock, Saturated, Status, StreamInfo

BACKWARDS_MS = codec.TIME_MODULUS // 2
"""A step of more than half the clock's range is one backwards: the controller began anew."""


class BenchTime(Protocol):
    """What is needed of the host's clock."""

    def from_monotonic(self, monotonic_s: float) -> float:
        """Bench time of a reading of the monotonic clock."""


class _Run(NamedTuple):
    """Frames without a gap: number and device time of the first, time and arrival of the last in host seconds."""

    seq: int
    first_us: int
    t0_s: float
    arrival_s: float
    texels: list[NDArray[np.uint16]]


class Frames:
    """From the controller's frames to sample blocks, on its own clock. Pure: it asks no clock.

    Frame k is where the controller's clock says; a step of more than one and a half periods is loss. Time of its
    milliseconds is extended, and goes through the lower envelope of arrivals.

    Args:
        device: Name in the profile.
        info: Of the stream.
        clock: Turns monotonic time into bench time.
        max_drift_ppm: Bound on the drift of the controller's clock.

    Attributes:
        model: Of the controller's clock.
        wrong: Frames that have not the cells that the matrices said.
        lost: Frames lost so far.
    """

    def __init__(self, device: str, info: StreamInfo, clock: BenchTime, max_drift_ppm: float) -> None:
        assert info.rate_hz is not None
        self.model = ClockModel(max_drift_ppm)
        self.wrong = 0
        self.lost = 0
        self._device = device
        self._info = info
        self._rate_hz = info.rate_hz
        self._clock = clock
        self._max_drift_ppm = max_drift_ppm
        self._timeline = Timeline(self.model)
        self._last_ms: int | None = None  # extended
        self._seq = -1
        self._begins = True
        self._saturated = False
        self._runs: list[_Run] = []
        self._statuses: list[Status] = []

    def begin(self) -> None:
        """What comes next was asked for anew: what is missing before it is not lost."""
        self._begins = True
        self._saturated = False

    def push(self, frame: codec.Frame, arrival_s: float) -> None:
        """Take a frame that was in hand at monotonic time `arrival_s`."""
        if len(frame.texels) != len(self._info.channels):
            self.wrong += 1
            return
        follows = bool(self._runs) and not self._begins
        time_ms, steps, lost = self._place(frame.time_ms)
        time_us = time_ms * 1000
        self.model.observe(time_us, arrival_s)
        host_s = float(self._timeline.host_s(np.array([time_us], dtype=np.int64))[0])
        self._timeline.hold(time_us, host_s)
        if lost is not None:
            self.lost += lost
            bench_s = self._clock.from_monotonic(host_s)
            self._statuses.append(Lost(bench_s, self._device, self._info.name, lost))
        self._seq += steps
        if follows and steps == 1:
            self._runs[-1] = self._runs[-1]._replace(arrival_s=arrival_s)
            self._runs[-1].texels.append(frame.texels)
        else:
            self._runs.append(_Run(self._seq, time_us, host_s, arrival_s, [frame.texels]))
        self._begins = False
        self._last_ms = time_ms
        self._watch(frame, host_s)

    def take_blocks(self) -> Sequence[SampleBlock]:
        """Blocks since the last call."""
        runs, self._runs = self._runs, []
        return [self._block(run) for run in runs]

    def take_statuses(self) -> list[Status]:
        """Statuses since the last call."""
        statuses, self._statuses = self._statuses, []
        return statuses

    def _place(self, shown_ms: int) -> tuple[int, int, int | None]:
        """Extended time, by how much the number grows, and how many are told as lost (0: it began anew)."""
        if self._last_ms is None:
            return shown_ms, 1, None
        step_ms = (shown_ms - self._last_ms) % codec.TIME_MODULUS
        if step_ms >= BACKWARDS_MS:
            self.model = ClockModel(self._max_drift_ppm)
            self._timeline.restart(self.model)
            return shown_ms, 2, 0
        time_ms, steps = self._last_ms + step_ms, max(1, round(step_ms * 1e-3 * self._rate_hz))
        if self._begins:
            return time_ms, 1 + steps, None
        return time_ms, steps, steps - 1 if steps > 1 else None

    def _watch(self, frame: codec.Frame, host_s: float) -> None:
        full = bool((frame.texels >= codec.TEXEL_MAX).any())
        if full and not self._saturated:
            value = codec.TEXEL_MAX * self._info.scale
            bench_s = self._clock.from_monotonic(host_s)
            self._statuses.append(Saturated(bench_s, self._device, self._info.name, value))
        self._saturated = full

    def _block(self, run: _Run) -> SampleBlock:
        return SampleBlock(
            self._info.name,
            run.seq,
            self._clock.from_monotonic(run.t0_s),
            np.array(run.texels, dtype=np.int32),
            rate_hz=self._rate_hz,
            unit=self._info.unit,
            scale=self._info.scale,
            device_t0_s=run.first_us * 1e-6,
            arrival_s=self._clock.from_monotonic(run.arrival_s),
        )
