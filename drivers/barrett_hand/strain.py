"""One finger's strain gauge: raw readings → blocks in newtons, zero, saturation. Pure."""

from collections import deque
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from drivers.barrett_hand import codec
from drivers.core.messages import SampleBlock, Saturated, StreamInfo
from drivers.core.scaled import tare_samples
from drivers.core.settings import Settings


class FingerStrainSettings(Settings):
    """Which gauges are read, how often, their scale and zero: of the real hand and of the mock one."""

    fingers: Annotated[tuple[int, ...], Strict(False)] = codec.FINGERS
    """Nodes of the fingers that have a strain gauge (docs/reference/sensors.md)."""
    poll_hz: float = Field(default=1000.0, ge=1.0, le=1000.0)
    """How often the gauges are polled; samples that the bus does not carry are reported as lost (the paper: 1 kHz)."""
    newton_per_count: float = Field(default=codec.NEWTON_PER_COUNT, gt=0.0, le=1.0)
    """Force at the fingertip for each count; roughly, until it is calibrated."""
    zero_counts: int = Field(default=codec.UNLOADED_COUNTS, ge=0, le=codec.COUNTS_MAX)
    """Reading of an unloaded finger, until it is tared."""


class FingerStrain:
    """The gauge of one finger.

    Values are raw counts less the zero, so that a force is value times scale; the zero is a whole count.

    Attributes:
        info: Its stream, `<device>.strain_<finger>`.
        zero: Raw counts at no force.
    """

    def __init__(self, device: str, finger: int, rate_hz: float, settings: FingerStrainSettings) -> None:
        name = f"{device}.strain_{finger}"
        self.info = StreamInfo(name, ("force",), "N", settings.newton_per_count, rate_hz, noisy=True)
        self.zero = settings.zero_counts
        self._device = device
        self._recent: deque[int] = deque(maxlen=tare_samples(rate_hz))
        self._saturated = False

    def forget(self) -> None:
        """Forget earlier readings: they are of another subscription."""
        self._recent.clear()
        self._saturated = False

    def tare(self) -> bool:
        """Take the mean of the latest readings as zero; False where there are none."""
        if not self._recent:
            return False
        self.zero = round(sum(self._recent) / len(self._recent))
        return True

    def block(self, seq: int, t0_s: float, raw: NDArray[np.int64], arrival_s: float | None) -> SampleBlock:
        """Consecutive readings, shape (n,), the first of them number `seq` at bench time `t0_s`."""
        self._recent.extend(raw.tolist())
        return self.info.block(seq, t0_s, (raw - self.zero)[:, None], arrival_s=arrival_s)

    def saturation(self, block: SampleBlock) -> list[Saturated]:
        """Where this block leaves the range in which the hand works, once for each excursion."""
        lowest, highest = codec.SAFE_COUNTS
        raw = block.values[:, 0] + self.zero
        excursions = []
        for place in np.flatnonzero(np.diff((raw < lowest) | (raw > highest), prepend=self._saturated)):
            self._saturated = not self._saturated
            if self._saturated:
                value_n = float(block.physical[place, 0])
                excursions.append(Saturated(float(block.times[place]), self._device, self.info.name, value_n))
        return excursions
