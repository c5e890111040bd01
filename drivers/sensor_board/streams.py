"""From the board's frames to sample blocks."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import Clock
from drivers.core.clock_model import DeviceClock
from drivers.core.errors import CodecError
from drivers.core.messages import SampleBlock, StreamInfo
from drivers.core.numbering import StreamTrack
from drivers.sensor_board.codec import COUNTER_MODULUS, TIME_MODULUS, BoardSamples

PERIOD_S = 0.2
"""Longest time between two samples of an irregular stream, s. Assumption: five periods of a finger at 28 Hz."""


def stream_info(
    name: str, channels: tuple[str, ...], unit: str, scale: float, rate_hz: float | None
) -> StreamInfo:
    """A stream as the board describes it; a converter's last bits never stand still."""
    longest_s = PERIOD_S if rate_hz is None else None
    return StreamInfo(
        name, channels, unit, scale, rate_hz, longest_s, noisy=rate_hz is not None and unit != "m"
    )


class BoardStreams:
    """All streams of a board on its one clock. Pure: it asks no clock.

    The u16 counter and the u32 time are extended (`numbering.StreamTrack`). The numbers of a stream's first segment are
    the board's.

    Args:
        max_drift_ppm: Bound on the drift of the board's clock.

    Attributes:
        clock: The board's.
    """

    def __init__(self, infos: Mapping[int, StreamInfo], clock: Clock, max_drift_ppm: float) -> None:
        self.clock = DeviceClock(max_drift_ppm, wrap_s=TIME_MODULUS * 1e-6)
        self._bench = clock
        self._infos = infos
        self._tracks = {
            number: StreamTrack(self.clock, info.rate_hz, COUNTER_MODULUS) for number, info in infos.items()
        }

    def begin(self, numbers: Iterable[int]) -> None:
        """These streams were subscribed again: what is missing before their next samples is not lost."""
        for number in numbers:
            self._tracks[number].begin()

    def push(self, frame: BoardSamples, arrival_s: float) -> tuple[SampleBlock, int | None]:
        """The block in a frame that was in hand at monotonic time `arrival_s`, and what was lost before it (`Placed`).

        Raises:
            CodecError: of a stream that the board does not have, or not of its shape.
        """
        info = self._infos.get(frame.stream)
        if info is None:
            raise CodecError(f"stream {frame.stream} is not in the hello")
        values, offsets_s = _content(frame, info)
        span_s = 0.0 if offsets_s is None else float(offsets_s[-1])
        track = self._tracks[frame.stream]
        placed = track.place(frame.t_us * 1e-6, arrival_s, len(values), span_s, counter=frame.seq)
        bench_s = self._bench.from_monotonic(0.0)
        t0_s = placed.t0_s + bench_s
        block = info.block(
            placed.seq,
            t0_s,
            values,
            times_s=None if offsets_s is None else t0_s + offsets_s * self.clock.pace,
            device_t0_s=placed.device_s,
            arrival_s=arrival_s + bench_s,
        )
        return block, placed.lost


def _content(frame: BoardSamples, info: StreamInfo) -> tuple[NDArray[np.int32], NDArray[np.float64] | None]:
    """Values, shape (n, channels); device time since the first in s, shape (n,), where samples are irregular."""
    channels, regular = len(info.channels), frame.times_us is None
    if regular is (info.rate_hz is None) or len(frame.values) % channels or not (regular or channels == 1):
        raise CodecError(f"{info.name}: {len(frame.values)} values fit neither its channels nor its rate")
    if frame.times_us is None:
        return frame.values.reshape(-1, channels), None
    offsets_us = (frame.times_us - np.uint32(frame.t_us)).view(np.int32)
    if offsets_us[0] < 0 or np.any(np.diff(offsets_us) < 0):
        raise CodecError(f"{info.name}: times of its own are not in their order")
    return frame.values.reshape(-1, 1), np.asarray(offsets_us * 1e-6, dtype=np.float64)
