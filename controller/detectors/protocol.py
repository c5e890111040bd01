"""What every detector is, and how several inputs are kept in step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

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
