"""The controller's rows as sample blocks: sequence, loss and bench time. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.messages import Lost, SampleBlock, StreamInfo
from drivers.ur_arm.pipe import Row
from drivers.ur_arm.settings import Axis, UrArmSettings

RATE_HZ = 500.0
"""Rows a second of an e-Series controller (RTDE guide)."""

DRIFT = 200e-6
"""How fast the controller's clock may drift from the host's: two crystals of 100 ppm (assumption)."""

UNITS = {"position": "m", "pose": "m", "force": "N"}
"""Unit of each stream; rotation vectors (rad) and torques (N m) are named by their channels."""

CHANNELS = {
    "position": ("position",),
    "pose": ("x", "y", "z", "rx_rad", "ry_rad", "rz_rad"),
    "force": ("fx", "fy", "fz", "tx_n_m", "ty_n_m", "tz_n_m"),
}


def infos(name: str) -> dict[str, StreamInfo]:
    """The streams of an arm, by `device.stream`."""
    return {
        f"{name}.{short}": StreamInfo(f"{name}.{short}", CHANNELS[short], unit, rate_hz=RATE_HZ)
        for short, unit in UNITS.items()
    }


class ControllerClock:
    """Host time of a controller time, by the quickest arrival: no row arrives before it was taken.

    What one-way arrivals cannot tell is the least delay itself: host times are late by that much.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._device_s = 0.0

    def observe(self, device_s: float, arrival_s: float) -> None:
        """Learn from one row."""
        offset_s = arrival_s - device_s
        if self._offset_s is None or device_s < self._device_s:
            self._offset_s = offset_s
        else:
            self._offset_s = min(offset_s, self._offset_s + DRIFT * (device_s - self._device_s))
        self._device_s = device_s

    def host_s(self, device_s: float) -> float:
        """The host's monotonic time of a controller time."""
        assert self._offset_s is not None, "no row has been observed yet"
        return self._offset_s + device_s


class _Sample(NamedTuple):
    seq: int
    row: Row


class Streams:
    """The streams of one arm.

    Args:
        name: Of the device.
        settings: Of the arm.
        bench_s: Bench time of a host monotonic time.

    Attributes:
        info: What can be listened to, by `device.stream`.
        listening: Which streams are sent.
        rows: How many rows have come.
        missed: How many the controller took that did not come.
    """

    def __init__(self, name: str, settings: UrArmSettings, bench_s: Callable[[float], float]) -> None:
        self.info = infos(name)
        self.listening: frozenset[str] = frozenset()
        self.rows = 0
        self.missed = 0
        self._name = name
        self._axis = Axis(settings)
        self._bench_s = bench_s
        self._clock = ControllerClock()
        self._samples: list[_Sample] = []
        self._last: Row | None = None
        self._seq = 0
        self._floor_s = 0.0  # half a cycle after the last sample that was given out, host time

    def take(self, rows: Sequence[Row]) -> list[Lost]:
        """Take rows in order; what was lost between them, for each stream that is listened to.

        A row that the client skipped is a jump in the controller's time. A controller whose time has gone back
        was started anew: a new segment. What nobody listened to does not count.
        """
        lost = []
        for row in rows:
            steps = 1 if self._last is None else round((row.device_s - self._last.device_s) * RATE_HZ)
            self._clock.observe(row.device_s, row.arrival_s)
            self.rows += 1
            if steps != 1:
                t_s = self._bench_s(self._clock.host_s(row.device_s))
                missed = max(0, steps - 1)
                self.missed += missed
                lost += [Lost(t_s, self._name, stream, missed) for stream in sorted(self.listening)]
            self._last = row
            if self.listening:
                # A new segment is a jump as well, if of unknown length: nothing is joined across it.
                self._seq += steps if steps >= 1 else 2
                self._samples.append(_Sample(self._seq, row))
        return lost

    def blocks(self) -> list[SampleBlock]:
        """What has been taken since the last call, in blocks without gaps."""
        samples, self._samples = self._samples, []
        if not samples or not self.listening:
            return []
        cuts = [0, *(i + 1 for i, (a, b) in enumerate(pairwise(samples)) if b.seq != a.seq + 1), len(samples)]
        runs = [samples[start:end] for start, end in pairwise(cuts) if end > start]
        return [block for run in runs for block in self._blocks(run)]

    def _blocks(self, run: Sequence[_Sample]) -> list[SampleBlock]:
        start_s = max(self._clock.host_s(run[0].row.device_s), self._floor_s)
        self._floor_s = start_s + (len(run) - 0.5) / RATE_HZ
        return [self._block(stream, run, start_s) for stream in sorted(self.listening)]

    def _block(self, stream: str, run: Sequence[_Sample], start_s: float) -> SampleBlock:
        first, last = run[0], run[-1]
        return SampleBlock(
            stream,
            first.seq,
            self._bench_s(start_s),
            self._values(stream.rpartition(".")[2], [sample.row for sample in run]),
            rate_hz=RATE_HZ,
            unit=self.info[stream].unit,
            device_t0_s=first.row.device_s,
            arrival_s=self._bench_s(last.row.arrival_s),
        )

    def _values(self, short: str, rows: Sequence[Row]) -> NDArray[np.float64]:
        if short == "position":
            return np.array([[self._axis.position_m(row.pose)] for row in rows])
        return np.array([row.pose if short == "pose" else row.force for row in rows])
