"""How near the border of a fingertip its contact is, from its angle (Fernandez et al., sections 2 and 4.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from behaviors.events import BorderLeft, BorderNear, Detected
from controller.detectors.protocol import Hysteresis, Quantity, decisions
from controller.detectors.stream import OnStream, RunningMean
from drivers.core.messages import Floats, SampleBlock
from drivers.core.settings import Settings, StreamName

FORCES = (0, 1)
"""Channels of the input: Fx, Fy."""


class BorderSettings(Settings):
    """When a contact is near the border."""

    input: StreamName = "signals.tip"
    """Forces of the fingertip, Fx and Fy first; it needs a rate."""

    threshold: float = Field(default=0.8, gt=0.0, le=1.57)
    """Angle from the middle beyond which it is near, rad, on either side. Assumption: half of what the tip has, a
    quarter turn."""

    release_ratio: float = Field(default=0.5, gt=0.0, le=1.0)
    """Share of the threshold within which it is near no more,"""

    hold_s: float = Field(default=0.05, ge=0.0, le=60.0)
    """where it has stayed there for so long, s."""

    average_s: float = Field(default=0.02, gt=0.0, le=10.0)
    """Length of the running mean of the forces, s. Assumption: noise of 35 mN turns 4 N by 2 mrad then."""

    least_n: float = Field(default=0.5, gt=0.0, le=1e3)
    """Force below which there is no angle, N. Assumption: at 0.5 N the running mean's noise is 0.02 rad."""


class BorderDetector(OnStream[BorderSettings]):
    """Near the border while the contact's angle, atan2 of the forces' running means, is beyond a threshold.

    Emits `BorderNear`, with the angle's sign in `angle_rad`, and `BorderLeft` in turn. Where the tip is hardly pressed
    it says nothing and keeps its state. A gap begins a new running mean; samples that are not finite are ignored.

    Example:
        >>> detector = BorderDetector("border", BorderSettings(threshold=0.8))
        >>> angle_rad = np.linspace(0.0, -1.0, 1001)
        >>> forces_n = 4.0 * np.column_stack([np.sin(angle_rad), np.cos(angle_rad)])
        >>> [round(e.angle_rad, 2) for e in detector.push(SampleBlock("signals.tip", 0, 0.0, forces_n, rate_hz=1000.0))]
        [-0.8]
    """

    doing = "following the contact's angle"
    quantity = Quantity("angle of the contact from the middle of the tip", "rad")

    def reset(self) -> None:
        """Nothing is near."""
        super().reset()
        self._mean = RunningMean()
        self._near = Hysteresis()

    def _channels(self) -> Sequence[int]:
        return FORCES

    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        self._mean.restart()
        return ()

    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        settings = self.settings
        means_n, times_s = self._mean.push(values, times_s, max(1, round(settings.average_s * rate_hz)))
        x_n, y_n = means_n.T
        pressed = np.hypot(x_n, y_n) >= settings.least_n
        angles_rad, times_s = np.arctan2(x_n, y_n)[pressed], times_s[pressed]
        away_rad, threshold = np.abs(angles_rad), settings.threshold
        self.readings = decisions(times_s, away_rad, threshold)
        release, hold = settings.release_ratio * threshold, round(settings.hold_s * rate_hz)
        events: list[Detected] = []
        for i, near in self._near.changes(away_rad, threshold, release, hold):
            found = float(times_s[i]), self.name, float(away_rad[i]), threshold
            events.append(BorderNear(*found, float(angles_rad[i])) if near else BorderLeft(*found))
        return events
