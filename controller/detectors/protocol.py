"""The detector interface, and the readings that a detector shows."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from behaviors.events import Detected
from drivers.core.messages import Floats, SampleBlock


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


class Quantity(NamedTuple):
    """What the number is that a detector compares with its threshold.

    Attributes:
        name: In words, as a report prints it.
        unit: Of number and threshold; "" where it has none, None for the unit of the detector's first input.
        learned: Unit of what `BaselineReady` reports, where that is another quantity; None where it is this one.
    """

    name: str
    unit: str | None
    learned: str | None = None


UNDECLARED = Quantity("statistic", "")
"""Of a detector that does not say."""


def quantity_of(detector: object) -> Quantity:
    """The detector's `quantity`, what its `readings` are. Optional for user detectors."""
    quantity = getattr(detector, "quantity", None)
    return quantity if isinstance(quantity, Quantity) else UNDECLARED


def quantities_of(detectors: Mapping[str, Detector], units: Mapping[str, str]) -> Mapping[str, Quantity]:
    """What each detector's `readings` are, by its name, with the unit known."""
    found = {}
    for name, detector in detectors.items():
        quantity = quantity_of(detector)
        if quantity.unit is None:
            quantity = quantity._replace(unit=units.get(detector.inputs[0], ""))
        found[name] = quantity
    return found


NOTHING: Floats = np.empty((0, 3))
"""No reading."""


def readings_of(detector: object) -> Floats:
    """The detector's `readings` after its last `push`, shape (n, 3): of each decision the sample's time, the statistic
    and the threshold, NaN until it is known. Optional for user detectors; an attribute of another type, or one that
    raises, counts as none."""
    try:
        readings = getattr(detector, "readings", None)
    except Exception:
        return NOTHING
    if isinstance(readings, np.ndarray) and readings.ndim == 2 and readings.shape[1] == 3:
        return readings
    return NOTHING


def decisions(times_s: Floats, statistic: Floats, threshold: float) -> Floats:
    """The readings of a block: times (n,), and the statistic after each sample (n,), NaN where it decides nothing."""
    known = ~np.isnan(statistic)
    readings = np.empty((int(known.sum()), 3))
    readings[:, 0], readings[:, 1], readings[:, 2] = times_s[known], statistic[known], threshold
    return readings


class Hysteresis:
    """A comparator that lets go only where the statistic has stayed down for some samples.

    Attributes:
        on: Its state after the last sample.
    """

    def __init__(self) -> None:
        self.on = False
        self._below = 0

    def changes(
        self, statistic: Floats, threshold: float, release: float, hold: int = 1
    ) -> Iterator[tuple[int, bool]]:
        """Samples at which the state changes, and the new state.

        Args:
            statistic: After each sample, shape (n,).
            threshold: It is on above.
            release: It is off where the statistic has been at this value, or below,
            hold: for so many samples in a row, at least one.
        """
        if not self.on and not (statistic > threshold).any():
            return
        for i, value in enumerate(statistic.tolist()):
            self._below = self._below + 1 if self.on and value <= release else 0
            if self._below >= max(1, hold) if self.on else value > threshold:
                self.on, self._below = not self.on, 0
                yield i, self.on


def rate_of(block: SampleBlock, doing: str) -> float:
    """The block's sample rate, Hz.

    Raises:
        ValueError: its samples are at irregular times.
    """
    if block.rate_hz is None:
        raise ValueError(
            f"{block.stream}: samples at irregular times while {doing}; give it a stream with a rate"
        )
    return block.rate_hz


def channels_of(values: Floats, channels: Sequence[int] | None, stream: str, doing: str) -> Floats:
    """Some channels of samples of shape (n, channels), shape (n, len(channels)); None is all of them.

    Raises:
        ValueError: the stream has fewer channels.
    """
    if channels is None:
        return values
    missing = [channel for channel in channels if not 0 <= channel < values.shape[1]]
    if missing:
        raise ValueError(
            f"{stream}: no channel {missing[0]} while {doing}: it has {values.shape[1]}; count from 0"
        )
    # in this order in memory: a sum's last bit depends on it
    return np.ascontiguousarray(values[:, list(channels)])


@runtime_checkable
class Compiled(Protocol):
    """A detector or signal whose numerics are compiled code."""

    def warm_up(self) -> None:
        """Load the compiled code, compiling it on first use; leaves the state unchanged."""


def envelope_of(detector: object) -> str | None:
    """The detector's `envelope`, that of its inputs which is a finger's envelope: raw sound is demodulated to I and Q
    first. Optional for user detectors."""
    envelope = getattr(detector, "envelope", None)
    return envelope if isinstance(envelope, str) else None
