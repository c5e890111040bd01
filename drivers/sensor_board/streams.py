"""From the board's frames to sample blocks: counters and times extended, loss and restarts seen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.clock_model import ClockModel, Timeline
from drivers.messages import SampleBlock, StreamInfo
from drivers.sensor_board.codec import COUNTER_MODULUS, TIME_MODULUS, CodecError, Samples, Times

FUTURE_S: Final = 5.0
"""A device time this far ahead of its arrival is another clock's. Assumption: no first frame is so late."""

SLACK_S: Final = 0.05
"""How far counter and device time of a regular stream may disagree. Assumption: firmware stamps that late."""


class BenchTime(Protocol):
    """What is needed of the host's clock."""

    def from_monotonic(self, monotonic_s: float) -> float:
        """Bench time of a reading of the monotonic clock."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """A block, and what lies between it and the one before.

    Attributes:
        block: In bench time; `seq` counts samples.
        lost: Samples lost before it; 0 where the board began anew and nobody knows how many; None where
            it follows on the one before, or begins because it was asked for.
    """

    block: SampleBlock
    lost: int | None


class _Stream:
    """Where one stream stands: what its next sample is called if nothing is missing."""

    def __init__(self, info: StreamInfo, model: ClockModel) -> None:
        self.info = info
        self.timeline = Timeline(model)
        self.counter = 0
        self.device_us = 0
        self.host_s = 0.0
        self.seq: int | None = None
        self.begins = True
        """The next block begins a segment that was asked for."""
        self.restarted = False
        """The next block begins a segment that nobody asked for."""

    def lost(self, counter: int, first_us: int) -> int | None:
        """Samples missing before this one; None where counter and time do not go on from where they were."""
        missing = (counter - self.counter) % COUNTER_MODULUS
        rate_hz = self.info.rate_hz
        if rate_hz is None:
            return missing if missing < COUNTER_MODULUS // 2 and first_us >= self.device_us else None
        elapsed = (first_us - self.device_us) * 1e-6 * rate_hz
        # A gap may be longer than the counter: device time tells how often it went round.
        missing += COUNTER_MODULUS * round((elapsed - missing) / COUNTER_MODULUS)
        return missing if missing >= 0 and abs(missing - elapsed) <= max(1.0, SLACK_S * rate_hz) else None

    def number(self, counter: int, lost: int | None, host_s: float) -> int:
        """Number of the first sample. A new segment's is where host time says, never next to the last."""
        if self.seq is None:
            return counter
        if lost is None:
            return self.seq + max(1, round((host_s - self.host_s) * (self.info.rate_hz or 0.0)))
        return self.seq + lost

    def follow(
        self, counter: int, seq: int, times_us: NDArray[np.int64], hosts_s: NDArray[np.float64]
    ) -> None:
        """A block has been given out: remember what follows on it."""
        period_s = 0.0 if self.info.rate_hz is None else 1.0 / self.info.rate_hz
        self.counter = (counter + len(times_us)) % COUNTER_MODULUS
        self.seq = seq + len(times_us)
        self.device_us = int(times_us[-1]) + round(period_s * 1e6)
        self.host_s = float(hosts_s[-1]) + period_s
        self.timeline.hold(int(times_us[-1]), float(hosts_s[-1]))
        self.begins = self.restarted = False


class BoardStreams:
    """All streams of a board on its one clock. Pure: it asks no clock.

    The u16 counter and the u32 time are extended. Where a regular stream's counter and device time do not
    tell the same number of missing samples, a counter runs backwards, or a time lies in the future, the board
    has restarted: every stream begins a new segment, and the clock model begins anew. The numbers of a
    stream's first segment are the board's; a later segment begins where host time says, so that no
    gap ever looks closed. Within a segment they follow the board's counter.

    Args:
        infos: The board's streams by their id.
        clock: Turns monotonic time into bench time.
        max_drift_ppm: Bound on the drift of the board's clock.

    Attributes:
        model: The present model of the board's clock.
    """

    def __init__(self, infos: Mapping[int, StreamInfo], clock: BenchTime, max_drift_ppm: float) -> None:
        self._clock = clock
        self._max_drift_ppm = max_drift_ppm
        self.model = ClockModel(max_drift_ppm)
        self._streams = {number: _Stream(info, self.model) for number, info in infos.items()}

    def begin(self, numbers: Iterable[int]) -> None:
        """These streams go on after a silence that was asked for: what is missing is not lost."""
        for number in numbers:
            self._streams[number].begins = True

    def push(self, frame: Samples | Times, arrival_s: float) -> Arrival:
        """The block in a frame that was in hand at monotonic time `arrival_s`.

        Raises:
            CodecError: of a stream that the board does not have, or of another shape than it says.
        """
        stream = self._streams.get(frame.stream)
        if stream is None:
            raise CodecError(f"stream {frame.stream} is not in the hello")
        info = stream.info
        values, offsets_us = _content(frame, info)
        first_us, lost = self._place(stream, frame, arrival_s)
        times_us = first_us + offsets_us
        self.model.observe(int(times_us[-1]), arrival_s)
        hosts_s = stream.timeline.host_s(times_us)
        if info.rate_hz is not None:
            hosts_s = hosts_s[0] + np.arange(len(times_us)) / info.rate_hz
        seq = stream.number(frame.seq, lost, float(hosts_s[0]))
        told = 0 if stream.restarted else (lost or None)
        stream.follow(frame.seq, seq, times_us, hosts_s)
        bench_s = self._clock.from_monotonic(0.0)
        block = SampleBlock(
            stream=info.name,
            seq=seq,
            t0_s=float(hosts_s[0]) + bench_s,
            values=values,
            rate_hz=info.rate_hz,
            times_s=hosts_s + bench_s if info.rate_hz is None else None,
            unit=info.unit,
            scale=info.scale,
            device_t0_s=first_us * 1e-6,
            arrival_s=arrival_s + bench_s,
        )
        return Arrival(block, told)

    def _place(self, stream: _Stream, frame: Samples | Times, arrival_s: float) -> tuple[int, int | None]:
        """Extended time of the first sample, and how many are missing before it (None: a segment begins)."""
        goes_on = not (stream.begins or stream.restarted)
        first_us = self._extended(frame.t_us, arrival_s)
        lost = stream.lost(frame.seq, first_us) if goes_on and first_us is not None else None
        if first_us is None or (goes_on and lost is None):
            self._restart()
            return frame.t_us, None
        return first_us, lost

    def _extended(self, t_us: int, arrival_s: float) -> int | None:
        """The device time nearest to what the clock model expects; None where it lies in the future."""
        if not self.model.ready:
            return t_us
        expected_us = self.model.device_us(arrival_s)
        ahead_us = _signed(t_us - expected_us)
        return None if ahead_us > FUTURE_S * 1e6 else expected_us + ahead_us

    def _restart(self) -> None:
        self.model = ClockModel(self._max_drift_ppm)
        for stream in self._streams.values():
            stream.timeline.restart(self.model)
            stream.restarted |= not stream.begins


def _signed(difference_us: int) -> int:
    """A difference of two u32 times as the shorter way round."""
    half = TIME_MODULUS // 2
    return (difference_us + half) % TIME_MODULUS - half


def _content(frame: Samples | Times, info: StreamInfo) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Values, shape (n, channels), and device time of each sample since the first in us, shape (n,)."""
    channels = len(info.channels)
    if isinstance(frame, Samples):
        if info.rate_hz is None or len(frame.values) % channels:
            raise CodecError(f"{info.name}: {len(frame.values)} values fit neither its channels nor its rate")
        values = frame.values.reshape(-1, channels)
        return values, np.rint(np.arange(len(values)) * (1e6 / info.rate_hz)).astype(np.int64)
    offsets_us = (frame.times_us - np.uint32(frame.t_us)).view(np.int32).astype(np.int64)
    if info.rate_hz is not None or channels != 1 or offsets_us[0] < 0 or np.any(np.diff(offsets_us) < 0):
        raise CodecError(f"{info.name}: times of its own do not fit its rate, its channels or their order")
    return frame.values.reshape(-1, 1), offsets_us
