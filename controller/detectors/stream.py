"""What detectors on one stream of samples share: the head of `push`, the running mean, the converter's step."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, Protocol, TypeVar

import numpy as np

from behaviors.events import Detected
from controller.detectors.protocol import NOTHING, channels_of, rate_of
from drivers.core.messages import Floats, SampleBlock


class OfStream(Protocol):
    """Settings that name a stream."""

    @property
    def input(self) -> str:
        """The stream."""


S = TypeVar("S", bound=OfStream)


class OnStream(ABC, Generic[S]):
    """A detector on one stream of samples at a fixed rate.

    Attributes:
        doing: The purpose, as text for error messages.
    """

    doing: ClassVar[str]

    def __init__(self, name: str, settings: S) -> None:
        self.name = name
        self.settings = settings
        self.inputs = (settings.input,)
        self.reset()

    def reset(self) -> None:
        """Return to the initial state."""
        self.readings = NOTHING
        self._next_seq: int | None = None

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next samples.

        Raises:
            ValueError: samples at irregular times, or a channel that is not there.
        """
        rate_hz, values = rate_of(block, self.doing), self._chosen(block.physical)
        lost = 0 if self._next_seq is None else block.seq - self._next_seq
        events = [*self._missed(lost, block, rate_hz)] if lost else []
        self._next_seq, self.readings = block.seq + len(block), NOTHING
        return [*events, *self._decide(values, block.times, rate_hz)]

    def _channels(self) -> Sequence[int] | None:
        """Which channels are used: the setting's `channel`, where there is one; None: all."""
        channel: int | None = getattr(self.settings, "channel", None)
        return None if channel is None else (channel,)

    def _chosen(self, values: Floats) -> Floats:
        return channels_of(values, self._channels(), self.settings.input, self.doing)

    @abstractmethod
    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        """So many samples are missing before the block; of less than none, the stream begins anew."""

    @abstractmethod
    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        """Events from the next samples of the channels, shape (n, channels); sets `readings`."""


AT_ONCE = 1 << 20
"""Values of windows that are held at once: a minute of sound has a thousand million."""


def running(values: Floats, size: int) -> Floats:
    """Means of `size` values in a row, shape (n - size + 1, channels); the same to the bit however they are cut."""
    count, places = len(values) - size + 1, np.arange(size)
    means = np.empty((max(0, count), values.shape[1]))
    rows = max(1, AT_ONCE // (size * values.shape[1]))
    for begin in range(0, count, rows):
        part = np.arange(begin, min(begin + rows, count))
        # one sum for each window, in the same order each time: a cumulative sum would depend on where it began
        windows = values[part[:, None] + places].transpose(0, 2, 1)
        means[part] = np.ascontiguousarray(windows).sum(axis=-1) / size
    return means


def step_of(samples: Floats) -> float:
    """Least difference of two neighbours, of samples of shape (n, channels): the converter's step where it can be seen,
    infinite where nothing changes."""
    steps = np.abs(np.diff(samples, axis=0))
    return float(steps.min(initial=math.inf, where=steps > 0.0))


class RunningMean:
    """Means of so many finite samples in a row, over blocks."""

    def __init__(self) -> None:
        self._past: Floats | None = None

    def restart(self) -> None:
        """Forget the last samples."""
        self._past = None

    def push(self, values: Floats, times_s: Floats, size: int) -> tuple[Floats, Floats]:
        """Of samples of shape (n, channels): the means that are now known, and their times, those of their last
        samples; a sample with a value that is not finite is left out."""
        finite = np.isfinite(values).all(axis=1)
        values, times_s = values[finite], times_s[finite]
        joined = values if self._past is None else np.concatenate([self._past, values])
        self._past = joined[len(joined) - min(len(joined), size - 1) :]
        means = running(joined, size)
        return means, times_s[len(times_s) - len(means) :]
