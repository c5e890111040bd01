"""The controller's rows as sample blocks: sequence, loss and bench time. Pure."""

from collections.abc import Sequence, Set

import numpy as np

from drivers.arm.axis import Axis
from drivers.arm.link import ArmRow
from drivers.arm.settings import ArmSettings
from drivers.core.clock import Clock
from drivers.core.clock_model import DeviceClock
from drivers.core.messages import Lost, SampleBlock, StreamInfo
from drivers.core.numbering import Samples, StreamTrack

MAX_DRIFT_PPM = 200.0
"""Bound on the drift between the controller's clock and the host's: two crystals of 100 ppm (assumption)."""

LONGEST_ROWS = 10
"""Longest time between two rows that is no hole, in rows. Assumption: the client skips some; in ten of them (20 ms at
500 Hz) a tool's mass jumps nowhere, and a mean over a second does not miss them."""

STREAMS = {
    "position": ("m", ("position",)),
    "pose": ("m", ("x", "y", "z", "rx_rad", "ry_rad", "rz_rad")),
    "force": ("N", ("fx", "fy", "fz", "tx_n_m", "ty_n_m", "tz_n_m")),
}
"""Unit and channels of each stream; rotation vectors (rad) and torques (N m) are named by their channels."""


def infos(name: str, rate_hz: float) -> dict[str, StreamInfo]:
    """The streams of an arm, by `device.stream`; rows a second."""
    return {
        f"{name}.{short}": StreamInfo(
            f"{name}.{short}",
            channels,
            unit,
            rate_hz=rate_hz,
            longest_s=LONGEST_ROWS / rate_hz,
            noisy=short == "force",
        )
        for short, (unit, channels) in STREAMS.items()
    }


class Streams:
    """The streams of one arm.

    Args:
        bench: Turns monotonic time into bench time.

    Attributes:
        info: The streams, by `device.stream`.
        missed: How many the controller took that did not come.
    """

    def __init__(self, name: str, settings: ArmSettings, bench: Clock) -> None:
        self.info = infos(name, settings.rate_hz)
        self._since_s: dict[str, float] = {}
        self.rows = 0
        self.missed = 0
        self._name = name
        self._axis = Axis(settings)
        self._bench = bench
        self._track = StreamTrack(DeviceClock(MAX_DRIFT_PPM), settings.rate_hz)
        self._samples = {stream: Samples(info, np.float64) for stream, info in self.info.items()}

    def begin(self) -> None:
        """The arm was opened again: what the controller took meanwhile is not lost."""
        self._track.begin()

    def listen(self, streams: Set[str], now_s: float) -> None:
        """Subscribe to these alone. Rows that came before monotonic time `now_s` and still wait are of no new one."""
        self._since_s = {stream: self._since_s.get(stream, now_s) for stream in streams & self.info.keys()}

    def take(self, rows: Sequence[ArmRow]) -> list[Lost]:
        """Take rows in order; what was lost between them, for each subscribed stream.

        A row that the client skipped is a jump in the controller's time. A controller whose time has gone back
        was restarted: a new segment. Without a subscriber a row is not lost, but still counted.
        """
        lost = []
        for row in rows:
            placed = self._track.place(row.device_s, row.arrival_s, joins=any(self._samples.values()))
            self.rows += 1
            heard = [stream for stream, since_s in self._since_s.items() if row.arrival_s >= since_s]
            if placed.lost is not None:
                self.missed += placed.lost
                t_s = self._bench.from_monotonic(placed.t0_s)
                lost += [Lost(t_s, self._name, stream, placed.lost) for stream in sorted(heard)]
            for stream in heard:
                values = self._values(stream.rpartition(".")[2], row)
                self._samples[stream].push(placed.seq, placed.t0_s, row.arrival_s, values, row.device_s)
        return lost

    def blocks(self) -> list[SampleBlock]:
        """The rows since the last call, in blocks without gaps."""
        bench_s = self._bench.from_monotonic(0.0)
        return [
            block
            for stream, samples in sorted(self._samples.items())
            for block in samples.take(bench_s)
            if stream in self._since_s
        ]

    def _values(self, short: str, row: ArmRow) -> Sequence[float]:
        if short == "position":
            return (self._axis.position_m(row.pose),)
        return row.pose if short == "pose" else row.force
