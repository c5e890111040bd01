"""What detectors on a finger's envelope share: its samples, each with the mover's position, and how they are pushed."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from typing import Annotated, ClassVar, Generic, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Strict

from behaviors.events import Detected
from controller.detectors.protocol import NOTHING, rate_of
from controller.detectors.stream import S
from drivers.core.messages import Floats, Ints, SampleBlock

Complexes = NDArray[np.complex128]


def _some_length(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(direction):
        raise ValueError("a direction has a length; give it one other than 0")
    return direction


Direction = Annotated[tuple[float, float, float], Strict(False), AfterValidator(_some_length)]
"""Setting: along which a pose is measured, in its own frame; any length but 0."""

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
    rate_hz: float


def recorded(z: Complexes, rate_hz: float, position_m: Floats | None = None) -> EnvelopeSamples:
    """A whole recording from its first sample, without a gap; its times begin at 0."""
    position_m = np.full(len(z), np.nan) if position_m is None else position_m
    return EnvelopeSamples(np.arange(len(z)) / rate_hz, z, position_m, np.zeros(len(z), np.int64), rate_hz)


def as_complex(values: Floats) -> Complexes:
    """I + jQ of the first two columns, or the only one, shape (n,)."""
    if values.shape[1] == 1:
        return values[:, 0].astype(np.complex128)
    return np.ascontiguousarray(values[:, :2]).view(np.complex128)[:, 0]


def with_position(values: Floats, kind: str) -> tuple[Complexes, Floats]:
    """I + jQ and the mover's position, m, of a recording, shape (n,) each.

    Args:
        values: I, Q and the mover's position in metres, shape (n, 3).
        kind: Of detector, as text for the error message.

    Raises:
        ValueError: there are not three columns.
    """
    if values.ndim != 2 or values.shape[1] != 3:
        raise ValueError(
            f"{kind}: a recording of I, Q and the mover's position (m), three columns, is needed to calibrate it"
        )
    # contiguous, as live samples are: a strided column would compile another specialization
    return as_complex(values[:, :2]), values[:, 2].copy()


class EncoderSync:
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
        self.reset()

    def reset(self) -> None:
        """Drop the waiting samples."""
        self._next_seq: int | None = None
        self._waiting = recorded(np.empty(0, np.complex128), 1.0)
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
        rate_hz = rate_of(block, self._doing)
        missing = np.zeros(len(block), np.int64)
        if len(block) and self._next_seq is not None:
            jump = block.seq - self._next_seq
            missing[0] = jump if jump >= 0 else UNKNOWN
        self._next_seq = block.seq + len(block)
        unknown_m = np.full(len(block), np.nan)
        fresh = EnvelopeSamples(block.times, as_complex(block.physical), unknown_m, missing, rate_hz)
        if len(self._waiting.times_s):
            old = self._waiting
            fresh = EnvelopeSamples(
                np.concatenate((old.times_s, fresh.times_s)),
                np.concatenate((old.z, fresh.z)),
                np.concatenate((old.position_m, fresh.position_m)),
                np.concatenate((old.missing, fresh.missing)),
                rate_hz,
            )
        self._waiting = fresh

    def _know(self, block: SampleBlock) -> None:
        values = block.physical
        metres = values[:, 0] if values.shape[1] < 3 else values[:, :3] @ self._direction
        good = np.isfinite(metres)
        self._known_s = np.concatenate((self._known_s, block.times[good]))
        self._known_m = np.concatenate((self._known_m, metres[good]))

    def _ready(self) -> EnvelopeSamples:
        times_s, z, position_m, missing, rate_hz = self._waiting
        count = len(times_s)
        if self._encoder is not None:
            known_s = self._known_s[-1:]
            count = int(np.searchsorted(times_s, known_s[0], side="right")) if len(known_s) else 0
        self._waiting = EnvelopeSamples(
            times_s[count:], z[count:], position_m[count:], missing[count:], rate_hz
        )
        times_s = times_s[:count]
        if self._encoder is not None and count:
            position_m = self._positions(times_s)
            # the reading before the first sample that waits is still needed
            kept = max(0, int(np.searchsorted(self._known_s, times_s[-1], side="right")) - 1)
            self._known_s, self._known_m = self._known_s[kept:], self._known_m[kept:]
        return EnvelopeSamples(times_s, z[:count], position_m[:count], missing[:count], rate_hz)

    def _positions(self, times_s: Floats) -> Floats:
        known_s = self._known_s
        found: Floats = np.interp(times_s, known_s, self._known_m, left=np.nan)
        after = np.minimum(np.searchsorted(known_s, times_s), len(known_s) - 1)
        before = np.maximum(after - 1, 0)
        # a sample at the time of a reading needs no interpolation
        guessed = (known_s[after] - known_s[before] > LONGEST_STEP_S) & (times_s != known_s[after])
        found[guessed] = np.nan
        return found


class OnEnvelope(ABC, Generic[S]):
    """A detector on one finger's envelope, the setting `input`; where they have a `position_input`, with the mover's
    position along `direction`.

    Attributes:
        doing: The purpose, as text for error messages.
    """

    doing: ClassVar[str]

    def __init__(self, name: str, settings: S) -> None:
        self.name = name
        self.settings = settings
        self.envelope = settings.input
        encoder: str | None = getattr(settings, "position_input", None)
        self.inputs = (settings.input,) if encoder is None else (settings.input, encoder)
        direction = getattr(settings, "direction", (1.0, 0.0, 0.0))
        self._sync = EncoderSync(settings.input, encoder, direction, self.doing)
        self.reset()

    def columns(self, values: Floats, times_s: Floats, blocks: Sequence[SampleBlock]) -> Floats:
        """Input of `statistic`: I, Q and the mover's position (m, NaN where unknown), shape (n, 3); without an encoder
        the values as they are.

        Args:
            values: The envelope, NaN where samples were lost, shape (n, channels).
            times_s: Their times, NaN likewise, shape (n,).
            blocks: The recording, with the encoder's blocks.
        """
        if len(self.inputs) == 1:
            return values
        signal, stream = self.inputs
        sync = self._fresh()._sync
        encoder = [block for block in blocks if len(block) and block.stream == stream]
        known = np.flatnonzero(np.isfinite(times_s))
        position_m = np.full(len(times_s), np.nan)
        if encoder and len(known):
            readings_s = np.concatenate([block.times for block in encoder])
            readings = np.concatenate([block.physical for block in encoder])
            sync.push(SampleBlock(stream, 0, readings_s[0], readings, times_s=readings_s))
            wanted_s = times_s[known]
            wanted = SampleBlock(signal, 0, wanted_s[0], values[known], rate_hz=1.0, times_s=wanted_s)
            found_m = sync.push(wanted).position_m
            position_m[known[: len(found_m)]] = found_m
        z = as_complex(values)
        return np.column_stack((z.real, z.imag, position_m))

    def reset(self) -> None:
        """Return to the initial state."""
        self.readings = NOTHING
        self._sync.reset()

    def warm_up(self) -> None:
        """Load the compiled code, compiling it on first use; leaves the state unchanged."""
        self._fresh()._decide(recorded(np.zeros(8, np.complex128), 1000.0, np.zeros(8)))

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next samples, of the envelope or of the encoder.

        Raises:
            ValueError: an envelope at irregular times.
        """
        samples, self.readings = self._sync.push(block), NOTHING
        return self._decide(samples) if len(samples.times_s) else ()

    @abstractmethod
    def _decide(self, samples: EnvelopeSamples) -> Sequence[Detected]:
        """Events from the next samples; sets `readings`."""

    def _fresh(self) -> Self:
        """The same detector in its initial state."""
        twin = deepcopy(self)
        twin.reset()
        return twin
