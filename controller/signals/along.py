"""Samples of an envelope, each with the mover's position: the input of the pre-touch detectors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.messages import SampleBlock

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]

UNKNOWN = -1
"""In `missing`: the stream restarted, so the length of the gap is unknown."""

LONGEST_STEP_S = 0.1
"""Positions are not interpolated across a longer gap. Assumption: 50 samples at 500 Hz; an arm at 0.3 m/s stops within
this time."""


class EnvelopeSamples(NamedTuple):
    """Consecutive samples of an envelope.

    Attributes:
        times_s: Bench time, shape (n,).
        z: I + jQ in full scales, shape (n,); Q is 0 where the stream has one channel.
        position_m: Of the mover, NaN where unknown, shape (n,).
        missing: Samples lost just before each, `UNKNOWN` where the stream restarted, shape (n,).
    """

    times_s: Floats
    z: Complexes
    position_m: Floats
    missing: Ints


def as_complex(values: Floats) -> Complexes:
    """I + jQ of the first two columns, or the only one, shape (n,)."""
    if values.shape[1] == 1:
        return values[:, 0].astype(np.complex128)
    return np.ascontiguousarray(values[:, :2]).view(np.complex128)[:, 0]


class Along:
    """Synchronizes an envelope with an encoder: a sample is released once the encoder has reached its time.

    Between two readings of the encoder the position is interpolated linearly. Readings that are not finite are
    ignored. Without an encoder samples pass at once.

    Args:
        signal: Stream of the envelope; it needs a rate.
        encoder: Stream of the mover's position (one channel, m) or pose (three or more, the first three in m).
        direction: Along which a pose is measured, any length but 0.
        doing: The purpose, as text for the error message.
    """

    def __init__(
        self, signal: str, encoder: str | None, direction: tuple[float, float, float], doing: str
    ) -> None:
        self._signal = signal
        self._encoder = encoder
        unit = np.asarray(direction, dtype=np.float64)
        unit = unit / np.max(np.abs(unit))  # whose square is a number
        self._direction = unit / np.linalg.norm(unit)
        self._doing = doing
        self.rate_hz: float | None = None
        self.reset()

    def reset(self) -> None:
        """Drop the waiting samples."""
        self._next_seq: int | None = None
        self._waiting: list[tuple[Floats, Complexes, Ints]] = []
        self._known_s = np.empty(0)
        self._known_m = np.empty(0)

    def push(self, block: SampleBlock) -> EnvelopeSamples:
        """Process the next block of either stream; returns the samples whose position is now known, maybe none.

        Raises:
            ValueError: an envelope at irregular times.
        """
        if block.stream == self._encoder:
            self._know(block)
        elif block.stream == self._signal:
            self._queue(block)
        return self._ready()

    def _queue(self, block: SampleBlock) -> None:
        if block.rate_hz is None:
            raise ValueError(
                f"{block.stream}: samples at irregular times while {self._doing}; give it a stream with a rate"
            )
        self.rate_hz = block.rate_hz
        missing = np.zeros(len(block), np.int64)
        if len(block) and self._next_seq is not None:
            jump = block.seq - self._next_seq
            missing[0] = jump if jump >= 0 else UNKNOWN
        self._next_seq = block.seq + len(block)
        self._waiting.append((block.times, as_complex(block.physical), missing))

    def _know(self, block: SampleBlock) -> None:
        values = block.physical
        metres = values[:, 0] if values.shape[1] < 3 else values[:, :3] @ self._direction
        good = np.isfinite(metres)
        self._known_s = np.concatenate((self._known_s, block.times[good]))
        self._known_m = np.concatenate((self._known_m, metres[good]))

    def _ready(self) -> EnvelopeSamples:
        if not self._waiting:
            return _nothing()
        times_s, z, missing = (np.concatenate(parts) for parts in zip(*self._waiting, strict=True))
        if self._encoder is None:
            self._waiting = []
            return EnvelopeSamples(times_s, z, np.full(len(times_s), np.nan), missing)
        count = int(np.searchsorted(times_s, self._known_s[-1], side="right")) if len(self._known_s) else 0
        self._waiting = [(times_s[count:], z[count:], missing[count:])] if count < len(times_s) else []
        if not count:
            return _nothing()
        samples = EnvelopeSamples(
            times_s[:count], z[:count], self._positions(times_s[:count]), missing[:count]
        )
        # the reading before the first sample that waits is still needed
        kept = max(0, int(np.searchsorted(self._known_s, times_s[count - 1], side="right")) - 1)
        self._known_s, self._known_m = self._known_s[kept:], self._known_m[kept:]
        return samples

    def _positions(self, times_s: Floats) -> Floats:
        known_s = self._known_s
        found: Floats = np.interp(times_s, known_s, self._known_m, left=np.nan)
        after = np.minimum(np.searchsorted(known_s, times_s), len(known_s) - 1)
        before = np.maximum(after - 1, 0)
        # a sample at the time of a reading needs no interpolation
        guessed = (known_s[after] - known_s[before] > LONGEST_STEP_S) & (times_s != known_s[after])
        found[guessed] = np.nan
        return found


def silence() -> EnvelopeSamples:
    """A few zero samples: input for warming up compiled code."""
    return EnvelopeSamples(np.zeros(8), np.zeros(8, np.complex128), np.zeros(8), np.zeros(8, np.int64))


def _nothing() -> EnvelopeSamples:
    return EnvelopeSamples(np.empty(0), np.empty(0, np.complex128), np.empty(0), np.empty(0, np.int64))
