"""The detector interface, and the reading that a detector shows."""

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
    several inputs a detector decides about time t once all inputs have reached t, however they interleave. An
    event's time is the time of the sample that decided.
    """

    name: str

    @property
    def inputs(self) -> tuple[str, ...]:
        """Streams it subscribes to, as `device.stream`."""

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next block of one of the inputs; returns events in order of time."""

    def reset(self) -> None:
        """Return to the initial state."""


class Reading(NamedTuple):
    """The statistic that a detector compared with its threshold.

    Attributes:
        t_s: Time of the sample.
        statistic: The largest value in the last block.
        threshold: NaN until it is known.
    """

    t_s: float
    statistic: float
    threshold: float


def reading_of(detector: object) -> Reading | None:
    """The detector's `reading` after its last `push`; None where nothing was compared with the threshold. Optional for
    user detectors; an attribute of another type, or one that raises, counts as None."""
    try:
        reading = getattr(detector, "reading", None)
    except Exception:
        return None
    return reading if isinstance(reading, Reading) else None


def largest(times_s: NDArray[np.float64], statistic: NDArray[np.float64], threshold: float) -> Reading | None:
    """The reading of a block: times (n,), and the statistic after each sample (n,), NaN where it decides nothing."""
    most = float(np.fmax.reduce(statistic, initial=math.nan))
    if math.isnan(most):
        return None
    return Reading(float(times_s[int((statistic == most).argmax())]), most, threshold)


@runtime_checkable
class Compiled(Protocol):
    """A detector or signal whose numerics are compiled code."""

    def warm_up(self) -> None:
        """Load the compiled code, compiling it on first use; leaves the state unchanged."""


@runtime_checkable
class EnvelopeDetector(Protocol):
    """A detector whose input is a finger's envelope: raw sound is demodulated to I and Q first."""

    envelope: str
    """Which of its inputs is the envelope."""
