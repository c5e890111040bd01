"""What every detector is, and how several inputs are kept in step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Detected
from drivers.messages import SampleBlock


class Detector(Protocol):
    """Turns samples into events.

    The same samples give the same events, whether they come one by one, in blocks of 64 or all at once; with
    several inputs a detector speaks of time t when all inputs have reached t, however they interleave. An
    event's time is the time of the sample that decided.
    """

    name: str

    @property
    def inputs(self) -> tuple[str, ...]:
        """Streams it hears, as `device.stream`."""

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Hear the next block of one of the inputs; returns what it found, in order of time."""

    def reset(self) -> None:
        """Forget everything, as on the day it was made."""


class Reading(NamedTuple):
    """What a detector held against its threshold.

    Attributes:
        t_s: Time of the sample.
        statistic: The largest number of what was heard last.
        threshold: NaN while it is not known yet.
    """

    t_s: float
    statistic: float
    threshold: float


def reading_of(detector: object) -> Reading | None:
    """What a detector shows of its last `push`, as its attribute `reading`: None where nothing was held against the
    threshold. One of the user's own need not, and what it shows wrongly counts for nothing."""
    try:
        reading = getattr(detector, "reading", None)
    except Exception:
        return None
    return reading if isinstance(reading, Reading) else None


def largest(times_s: NDArray[np.float64], statistic: NDArray[np.float64], threshold: float) -> Reading | None:
    """The reading of a block: times (n,), and the number after each sample (n,), NaN where it decides nothing."""
    most = float(np.fmax.reduce(statistic, initial=math.nan))
    if math.isnan(most):
        return None
    return Reading(float(times_s[int((statistic == most).argmax())]), most, threshold)


@runtime_checkable
class Compiled(Protocol):
    """A detector or signal whose numerics are compiled code."""

    def warm_up(self) -> None:
        """Let it load, or compile on first use; leaves the detector as on the day it was made."""


@runtime_checkable
class HearsEnvelope(Protocol):
    """A detector that hears the envelope of a finger: where there is sound alone, I and Q are made of it first."""

    envelope: str
    """Which of its inputs that is."""
