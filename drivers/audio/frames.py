"""From a source's packets to sample blocks: loss seen, times by the converter's clock. Pure."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from drivers.audio.source import Packet
from drivers.clock_model import ClockModel, Timeline
from drivers.messages import SampleBlock, StreamInfo


class BenchTime(Protocol):
    """What is needed of the host's clock."""

    def from_monotonic(self, monotonic_s: float) -> float:
        """Bench time of a reading of the monotonic clock."""


class CounterError(ValueError):
    """The converter's counter went backwards: it has begun anew, and with it the drive's phase."""


class Frames:
    """Sound on the converter's own clock. Pure: it asks no clock.

    A block's `seq` is the converter's counter of its first frame, which is also what the drive's phase is counted by.

    Args:
        info: Of the stream.
        channels: Which channels of a packet the stream's are.
        clock: Turns monotonic time into bench time.
        max_drift_ppm: Bound on the drift of the converter's clock.

    Attributes:
        model: Of the converter's clock.
        lost: Frames lost so far.
        taken: Frames handed out so far.
    """

    def __init__(
        self, info: StreamInfo, channels: tuple[int, int], clock: BenchTime, max_drift_ppm: float
    ) -> None:
        assert info.rate_hz is not None
        self.model = ClockModel(max_drift_ppm)
        self.lost = 0
        self.taken = 0
        self._info = info
        self._rate_hz = info.rate_hz
        self._channels = list(channels)
        self._clock = clock
        self._timeline = Timeline(self.model)
        self._next: int | None = None
        self._begins = True

    def begin(self) -> None:
        """What comes next was asked for anew: what is missing before it is not lost."""
        self._begins = True

    def learn(self, packet: Packet) -> None:
        """Learn of the converter's clock from a packet that is not handed out."""
        self.model.observe(self._device_us(packet.frame + len(packet.counts) - 1), packet.arrival_s)

    def push(self, packet: Packet) -> tuple[SampleBlock, int]:
        """The block of a packet, and how many frames were lost before it.

        Raises:
            CounterError: it goes back to frames that have been.
        """
        n = len(packet.counts)
        if self._next is not None and packet.frame < self._next:
            raise CounterError(f"the converter began anew: after frame {self._next - 1} came {packet.frame}")
        lost = 0 if self._begins or self._next is None else packet.frame - self._next
        self.lost += lost
        self.taken += n
        self._begins = False
        self._next = packet.frame + n
        first_us, last_us = self._device_us(packet.frame), self._device_us(packet.frame + n - 1)
        self.learn(packet)
        host_s = float(self._timeline.host_s(np.array([first_us], np.int64))[0])
        self._timeline.hold(last_us, host_s + (n - 1) / self._rate_hz)
        bench_s = self._clock.from_monotonic(0.0)
        block = SampleBlock(
            self._info.name,
            packet.frame,
            host_s + bench_s,
            np.ascontiguousarray(packet.counts[:, self._channels]),
            rate_hz=self._rate_hz,
            unit=self._info.unit,
            scale=self._info.scale,
            device_t0_s=packet.frame / self._rate_hz,
            arrival_s=packet.arrival_s + bench_s,
        )
        return block, lost

    def time_s(self, frame: int, arrival_s: float) -> float:
        """Bench time of a frame; of its news where no sound has told of the converter's clock yet."""
        if not self.model.ready:
            return self._clock.from_monotonic(arrival_s)
        host_s = float(self.model.host_s(np.array([self._device_us(frame)], np.int64))[0])
        return self._clock.from_monotonic(min(host_s, arrival_s))

    def _device_us(self, frame: int) -> int:
        rate_hz = round(self._rate_hz)
        return (frame * 1_000_000 + rate_hz // 2) // rate_hz
