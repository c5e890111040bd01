"""From a source's packets to sample blocks: loss seen, times by the converter's clock. Pure."""

from __future__ import annotations

import numpy as np

from drivers.audio.source import SoundPacket
from drivers.core.clock import Clock
from drivers.core.messages import SampleBlock, StreamInfo
from drivers.core.numbering import ENDLESS, DeviceClock, StreamTrack


class CounterError(ValueError):
    """The converter's counter went backwards: it has restarted, and with it the drive's phase."""


class SoundFrames:
    """Sound on the converter's own clock. Pure: it asks no clock.

    A block's `seq` is the converter's counter of its first frame, which is also what the drive's phase is counted by.

    Args:
        info: Of the stream.
        channels: Which channels of a packet the stream's are.
        clock: Turns monotonic time into bench time.
        max_drift_ppm: Bound on the drift of the converter's clock.

    Attributes:
        clock: The converter's.
        lost: Frames lost so far.
        taken: Frames handed out so far.
    """

    def __init__(
        self, info: StreamInfo, channels: tuple[int, int], clock: Clock, max_drift_ppm: float
    ) -> None:
        assert info.rate_hz is not None
        self.clock = DeviceClock(max_drift_ppm)
        self.lost = 0
        self.taken = 0
        self._info = info
        self._rate_hz = info.rate_hz
        self._channels = list(channels)
        self._bench = clock
        self._track = StreamTrack(self.clock, info.rate_hz, ENDLESS)
        self._last = -1

    def begin(self) -> None:
        """The stream was subscribed again: what is missing before the next packet is not lost."""
        self._track.begin()

    def learn(self, packet: SoundPacket) -> None:
        """Learn of the converter's clock from a packet that is not handed out."""
        last = packet.frame + len(packet.counts) - 1
        self.clock.model.observe(last / self._rate_hz, packet.arrival_s)

    def push(self, packet: SoundPacket) -> tuple[SampleBlock, int]:
        """The block of a packet, and how many frames were lost before it.

        Raises:
            CounterError: it goes back to frames that have been, or far ahead of the time that has passed.
        """
        n, device_s = len(packet.counts), packet.frame / self._rate_hz
        placed = self._track.place(device_s, packet.arrival_s, n)
        if packet.frame <= self._last or self.clock.restarts:
            raise CounterError(f"the converter began anew: after frame {self._last} came {packet.frame}")
        self._last = packet.frame + n - 1
        self.lost += placed.lost or 0
        self.taken += n
        bench_s = self._bench.from_monotonic(0.0)
        block = self._info.block(
            packet.frame,
            placed.t0_s + bench_s,
            np.ascontiguousarray(packet.counts[:, self._channels]),
            device_t0_s=device_s,
            arrival_s=packet.arrival_s + bench_s,
        )
        return block, placed.lost or 0

    def time_s(self, frame: int, arrival_s: float) -> float:
        """Bench time of a frame; its arrival while the converter's clock is not known yet."""
        if self.clock.model.ready:
            arrival_s = min(self.clock.model.host_s(frame / self._rate_hz), arrival_s)
        return self._bench.from_monotonic(arrival_s)
