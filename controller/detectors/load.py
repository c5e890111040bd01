"""The load that a finger carries, told wherever it has changed: what a grip that follows its load needs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from behaviors.events import BaselineReady, Detected, LoadChanged
from controller.detectors.protocol import Quantity, decisions
from controller.detectors.stream import OnStream, RunningMean
from drivers.core.messages import Floats, SampleBlock
from drivers.core.settings import Settings, StreamName

RESTS, RESTED = 0.6, 0.2
"""See `LoadSettings.rest_s`: shares of a step. Assumption: a load that an arm raises at 2 mm/s does not rest."""


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

    rest_s: float = Field(default=0.1, gt=0.0, le=10.0)
    """A load whose mean over this time is about the mean over `mean_s` rests: a change of that mean by a fifth of a
    step is told as well. Assumption: some periods of what swings in the pads."""


class LoadDetector(OnStream[LoadSettings]):
    """Tells the load, in `LoadChanged`, where it differs from what was told last by more than a step.

    A gap begins the mean anew, not the level. Samples that are not finite are passed over.

    Example:
        >>> detector = LoadDetector("load", LoadSettings(channel=0, learn_s=0.01, step_n=0.5))
        >>> force = np.repeat([0.0, 2.0], 20)[:, None]
        >>> [event.t_s for event in detector.push(SampleBlock("signals.pad", 0, 0.0, force, rate_hz=1000.0))]
        [0.009, 0.021]
    """

    doing = "following a load"
    quantity = Quantity("load", None)

    def reset(self) -> None:
        """Forget the level and what was told."""
        super().reset()
        self._level: float | None = None
        self._learned: list[float] = []
        self._mean, self._resting = RunningMean(), RunningMean()
        self._told = 0.0

    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        self._mean.restart()
        self._resting.restart()
        return ()

    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        settings, fit = self.settings, np.isfinite(values[:, 0])
        times_s, values = times_s[fit], values[fit]
        events: list[Detected] = []
        if self._level is None:
            missing = max(1, round(settings.learn_s * rate_hz)) - len(self._learned)
            self._learned += values[:missing, 0].tolist()
            if len(values) < missing:
                return events
            self._level, self._learned = float(np.mean(self._learned)), []
            events.append(BaselineReady(float(times_s[missing - 1]), self.name, self._level, settings.step_n))
            times_s, values = times_s[missing:], values[missing:]
        long, _ = self._resting.push(values, times_s, max(1, round(settings.rest_s * rate_hz)))
        means, times_s = self._mean.push(values, times_s, max(1, round(settings.mean_s * rate_hz)))
        loads_n, resting_n = means[:, 0] - self._level, np.full(len(means), np.nan)
        both = min(len(means), len(long))
        resting_n[len(means) - both :] = long[len(long) - both :, 0] - self._level
        self.readings = decisions(times_s, loads_n, math.nan)
        begin = 0
        while begin < len(loads_n):
            step_n = max(settings.step_n, settings.step_share * abs(self._told))
            steps = np.abs(loads_n[begin:] - self._told) > step_n
            rests = np.abs(resting_n[begin:] - loads_n[begin:]) < RESTS * step_n
            rests &= np.abs(resting_n[begin:] - self._told) > RESTED * step_n
            changed = np.flatnonzero(steps | rests)
            if not len(changed):
                break
            place = begin + int(changed[0])
            self._told = float(loads_n[place] if steps[place - begin] else resting_n[place])
            events.append(LoadChanged(float(times_s[place]), self.name, self._told, step_n))
            begin = place + 1
        return events
