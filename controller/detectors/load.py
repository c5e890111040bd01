"""The load that a finger carries, told wherever it has changed: what a grip that follows its load needs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from behaviors.events import BaselineReady, Detected, LoadChanged
from controller.detectors.protocol import NOTHING, Floats, Quantity, channels_of, decisions, rate_of
from drivers.core.messages import SampleBlock
from drivers.core.settings import Settings, StreamName

DOING = "following a load"


class LoadSettings(Settings):
    """Settings of the detector that follows a load."""

    input: StreamName = "signals.pad"
    """Stream of the force sensor, N."""

    channel: int = Field(default=2, ge=0, le=4095)
    """Its channel along the finger."""

    learn_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Over this time the level without a load is learned; it is armed then."""

    mean_s: float = Field(default=0.004, gt=0.0, le=1.0)
    """The load is the mean over this time. Assumption: short beside a slip, long beside a converter's noise."""

    step_n: float = Field(default=0.05, gt=0.0, le=1000.0)
    """A change of more than this is told …"""

    step_share: float = Field(default=0.05, ge=0.0, le=1.0)
    """… and of more than this share of the load that was told last."""


class LoadDetector:
    """Tells the load, in `LoadChanged`, where it differs from what was told last by more than a step.

    A gap begins the mean anew, not the level. Samples that are not finite are passed over.

    Example:
        >>> detector = LoadDetector("load", LoadSettings(channel=0, learn_s=0.01, step_n=0.5))
        >>> force = np.repeat([0.0, 2.0], 20)[:, None]
        >>> [event.t_s for event in detector.push(SampleBlock("signals.pad", 0, 0.0, force, rate_hz=1000.0))]
        [0.009, 0.021]
    """

    quantity = Quantity("load", None)

    def __init__(self, name: str, settings: LoadSettings) -> None:
        self.name = name
        self.settings = settings
        self.inputs = (settings.input,)
        self.reset()

    def reset(self) -> None:
        """Forget the level and what was told."""
        self.readings = NOTHING
        self._level: float | None = None
        self._learned: list[float] = []
        self._last: Floats = np.empty(0)
        self._told = 0.0
        self._next_seq: int | None = None

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next samples."""
        rate_hz, settings = rate_of(block, DOING), self.settings
        if block.seq != self._next_seq:
            self._last = np.empty(0)
        self._next_seq = block.seq + len(block)
        values = channels_of(block.physical, (settings.channel,), settings.input, DOING)[:, 0]
        fit = np.isfinite(values)
        times_s, values = block.times[fit], values[fit]
        events: list[Detected] = []
        if self._level is None:
            missing = max(1, round(settings.learn_s * rate_hz)) - len(self._learned)
            self._learned += values[:missing].tolist()
            if len(values) < missing:
                self.readings = NOTHING
                return events
            self._level = float(np.mean(self._learned))
            events.append(BaselineReady(float(times_s[missing - 1]), self.name, self._level, settings.step_n))
            times_s, values = times_s[missing:], values[missing:]
        loads_n = self._means(values, max(1, round(settings.mean_s * rate_hz))) - self._level
        times_s = times_s[len(times_s) - len(loads_n) :]
        self.readings = decisions(times_s, loads_n, math.nan)
        begin = 0
        while begin < len(loads_n):
            step_n = max(settings.step_n, settings.step_share * abs(self._told))
            changed = np.flatnonzero(np.abs(loads_n[begin:] - self._told) > step_n)
            if not len(changed):
                break
            place = begin + int(changed[0])
            self._told = float(loads_n[place])
            events.append(LoadChanged(float(times_s[place]), self.name, self._told, step_n))
            begin = place + 1
        return events

    def _means(self, values: Floats, length: int) -> Floats:
        """Mean of each sample and those before it, as far as there are `length` of them; always summed in one order."""
        known = np.concatenate([self._last, values])
        self._last = known[max(0, len(known) - length + 1) :]
        count = len(known) - length + 1
        if count < 1:
            return np.empty(0)
        total = np.zeros(count)
        for shift in range(length):
            total += known[shift : shift + count]
        return np.asarray(total / length, np.float64)
