"""Streams whose unit, scale and zero a profile gives: columns of printed lines, inputs of a converter, counters."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from drivers.core.messages import StreamInfo
from drivers.core.settings import Settings

TARE_S, TARE_LEAST = 0.05, 10
"""A new zero is the mean of what came in so many seconds, and of so many samples at least (assumptions)."""


class ScaledStream(Settings):
    """A stream: a channel for each of its `sources`. A value is `scale` times the difference of what is read and
    `offset`."""

    channels: tuple[str, ...] = ()
    """Names of the channels; by default the stream's own, of several with the source's behind it."""
    unit: str = Field(min_length=1)
    """SI unit of the values: "N", "m/s2"."""
    scale: float = 1.0
    """Units for one of what is read; negative where the sensor is mounted the other way round."""
    offset: float = 0.0
    """What is read at zero. `Tare` replaces it until the device is opened again."""
    noisy: bool = False
    """Whether its last digit always moves, so that the guard may take a value that stands still for a stuck sensor."""
    shows: tuple[str, ...] = ()
    """Simulated benches alone: what of the plant each source shows, `load_cell` or `strain.fx`."""

    @property
    def sources(self) -> Sequence[int | str]:
        """Where its channels come from: columns by number, inputs by name."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.scale == 0.0:
            raise ValueError("scale is 0; how many units is one of what is read?")
        for key in ("channels", "shows"):
            if getattr(self, key) and len(getattr(self, key)) != len(self.sources):
                raise ValueError(f"{key} has {len(getattr(self, key))} names for {len(self.sources)} sources")
        return self

    def info(self, name: str, rate_hz: float | None, longest_s: float | None = None) -> StreamInfo:
        """What the stream `device.stream` is; see `StreamInfo`."""
        own = name.partition(".")[2]
        named = (own,) if len(self.sources) == 1 else tuple(f"{own}_{source}" for source in self.sources)
        return StreamInfo(
            name, self.channels or named, self.unit, abs(self.scale), rate_hz, longest_s, self.noisy
        )


def tare_samples(rate_hz: float | None) -> int:
    """How many of the latest samples make a new zero; of irregular ones as many as at 1 kHz."""
    return max(TARE_LEAST, round(TARE_S * (rate_hz or 1000.0)))


class ScaledStreams:
    """A device's streams and their zeros.

    Args:
        streams: By their own names.
        rate_hz: Of all of them; None where samples are irregular.

    Attributes:
        streams: By their full names, `device.stream`.
    """

    def __init__(self, device: str, streams: Mapping[str, Any], rate_hz: float | None) -> None:
        self._kept = tare_samples(rate_hz)
        self.streams: Mapping[str, Any] = {f"{device}.{own}": stream for own, stream in streams.items()}
        self.forget()

    def forget(self) -> None:
        """Zeros are the profile's again."""
        self.zeros = {full: [one.offset] * len(one.sources) for full, one in self.streams.items()}
        self._recent = {full: deque[Any](maxlen=self._kept) for full in self.streams}

    def begin(self, stream: str) -> None:
        """It was subscribed again: what came before is no reading of now."""
        self._recent[stream].clear()

    def counts(self, stream: str, read: NDArray[np.float64]) -> NDArray[np.float64]:
        """What was read less the zero, shape (n, channels), positive where the value is."""
        self._recent[stream].extend(read)
        return np.asarray((read - self.zeros[stream]) * math.copysign(1.0, self.streams[stream].scale))

    def setting(self, stream: str) -> str:
        """See `OwnZero.zero_setting`: a stream has one offset, whatever channels it has."""
        device, _, own = stream.partition(".")
        zero, *others = self.zeros[stream]
        return "" if others else f"offset = {zero:.9g}  # in [devices.{device}.streams.{own}]"

    def tare(self, stream: str) -> bool:
        """Take the latest samples for zero; False where there are none."""
        zero = np.mean(self._recent[stream], axis=0) if self._recent[stream] else np.full(1, math.nan)
        if taken := bool(np.isfinite(zero).all()):
            self.zeros[stream] = zero.tolist()
        return taken
