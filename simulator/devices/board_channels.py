"""What an emulated sensor board samples: its source, its clock and its converters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.sensor_board.codec import COUNTER_MODULUS, TIME_MODULUS
from simulator.physics.bench import StreamSpec

INT32 = np.iinfo(np.int32)


class BoardSource(Protocol):
    """What the board is wired to. Its time is passed in."""

    def streams(self) -> Sequence[StreamSpec]:
        """What can be observed, in the order of the board's stream ids."""

    def advance(self, t_s: float, observe: frozenset[str]) -> None:
        """Let time pass until `t_s`; only streams named in `observe` will be sampled."""

    def sample(self, stream: str, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """A regular stream, in its unit, at ascending times between the board's last two calls of `advance`.

        Returns:
            Shape (n,) or (n, channels) for times of shape (n,).
        """

    def events(self, stream: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times in seconds and values in the unit of an irregular stream since the last call, shapes (n,)."""

    def excite(self, on: bool) -> None:
        """Switch the excitation, from the present time on."""

    def set_tendon(self, position_m: float) -> None:
        """Set the tendon, from the present time on."""


@dataclass(frozen=True, slots=True)
class BoardClock:
    """The board's own clock.

    Attributes:
        power_s: Host time at which it began.
        start_us: What it showed then, in us.
        rate: Its seconds for each second of the host.
    """

    power_s: float
    start_us: int
    rate: float

    def tick(self, t_s: float, rate_hz: float) -> int:
        """Number of the last tick of `rate_hz`, by this clock, at or before host time `t_s`."""
        return math.floor((t_s - self.power_s) * self.rate * rate_hz)

    def host_s(self, ticks: NDArray[np.int64], rate_hz: float) -> NDArray[np.float64]:
        """Host times of ticks."""
        return np.asarray(self.power_s + ticks / (rate_hz * self.rate))

    def tick_us(self, tick: int, rate_hz: float) -> int:
        """What the clock shows at a tick."""
        return (self.start_us + round(tick * 1e6 / rate_hz)) % TIME_MODULUS

    def shown_us(self, times_s: NDArray[np.float64]) -> NDArray[np.uint32]:
        """What the clock shows at host times."""
        since_us = np.floor((times_s - self.power_s) * self.rate * 1e6).astype(np.int64)
        return ((self.start_us + since_us) % TIME_MODULUS).astype(np.uint32)


class Channel:
    """One stream of the board: its converter, its zero, its counter, and what waits to fill a block.

    Args:
        bits: Width of the converter, sign included.
        tare_samples: Samples that a new zero is the mean of.
    """

    def __init__(self, number: int, spec: StreamSpec, bits: int, tare_samples: int) -> None:
        self.number = number
        self.spec = spec
        self.on = False
        self.tick = 0
        self._limit = 2 ** (bits - 1)
        self._tare_samples = tare_samples
        self.restart()

    def restart(self) -> None:
        """Counter, zero and block are as after power-on."""
        self.seq = 0
        self._zero = np.zeros(len(self.spec.channels), np.int64)
        self._recent = np.empty((0, len(self.spec.channels)), np.int64)
        self.waiting = np.empty((0, len(self.spec.channels)), np.int32)

    def start(self, tick: int) -> None:
        """Sample from this tick on."""
        self.on = True
        self.tick = tick
        self._recent = self._recent[:0]

    def convert(self, values: NDArray[np.float64]) -> NDArray[np.int32]:
        """What the converter makes of values in the unit: counts, saturated, from its zero; (n, channels)."""
        ideal = np.rint(values.reshape(-1, len(self.spec.channels)) / self.spec.scale)
        # What is no number leaves the converter at its lower rail.
        held = np.clip(np.nan_to_num(ideal, nan=-self._limit), -self._limit, self._limit - 1)
        counts = held.astype(np.int64)
        self._recent = np.concatenate([self._recent, counts])[-self._tare_samples :]
        return np.asarray(np.clip(counts - self._zero, INT32.min, INT32.max), dtype=np.int32)

    def tare(self) -> bool:
        """Take the latest samples as zero; False where there are none."""
        if not (self.on and len(self._recent)):
            return False
        self._zero = np.rint(self._recent.mean(axis=0)).astype(np.int64)
        return True

    def number_block(self, samples: int) -> int:
        """Counter of the first of the next samples."""
        seq, self.seq = self.seq, (self.seq + samples) % COUNTER_MODULUS
        return seq
