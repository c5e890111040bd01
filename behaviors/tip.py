"""What the experiments with a fingertip on a table share: the arm that carries it, down, up and home."""

from __future__ import annotations

import math

from pydantic import Field

from behaviors.approach import Approaching
from behaviors.machine import StatePlan
from drivers.core.messages import Home, MoveAt, Twist
from drivers.core.settings import DeviceName, Settings, StreamName


class TipTrialSettings(Settings):
    """The arm, and how it goes down and up."""

    mover: DeviceName = "arm"
    """Device that carries and turns the tip."""

    pose_stream: StreamName = "arm.pose"
    """Where its tool is (m, rotation vector in rad)."""

    descend_m_s: float = Field(default=0.002, gt=0.0, le=0.05)
    """Speed of descent, and of pressing on. Assumption: the paper prints none."""

    descend_limit_m: float = Field(default=0.006, gt=0.0, le=1.0)
    """Where a descent without contact ends, on the approach axis."""

    lift_m_s: float = Field(default=0.01, gt=0.0, le=0.25)
    """Speed of lifting off."""

    motion_timeout_s: float = Field(default=30.0, gt=0.0, le=600.0)
    """Longest stay in any state that waits for the mover, beyond what its motion takes."""

    home_timeout_s: float = Field(default=150.0, gt=0.0, le=600.0)
    """Longest homing. An arm turns home as slowly as it moves home: 1.5 rad at 0.02 rad/s take 75 s."""


class TipTrial(Approaching):
    """What such a trial commands."""

    settings: TipTrialSettings

    def descent(self, detector: str, plan: StatePlan) -> StatePlan:
        """What the descent needs, until the contact of a detector; as `approach`."""
        limit_m = self.settings.descend_limit_m
        return self.approach(detector, self.settings.descend_m_s, limit_m, limit_m, plan)

    def enter_DESCENDING(self) -> None:
        """Towards the table, bounded by the device."""
        self.go_until_contact()

    def enter_LIFTING(self) -> None:
        """Off the table, turned as it is."""
        self.command(MoveAt(self.settings.mover, -self.settings.lift_m_s, 0.0))

    def enter_RETURNING(self) -> None:
        """To where the next trial begins."""
        self.command(Home(self.settings.mover))

    def turn(self, turn_rad: float, speed_rad_s: float) -> None:
        """About the tip's own axis. From rest a tool goes as far as its twist times the duration: the ramp down comes
        after it."""
        rate_rad_s = math.copysign(speed_rad_s, turn_rad)
        self.command(Twist(self.settings.mover, (0.0, 0.0, 0.0, 0.0, rate_rad_s, 0.0), turn_rad / rate_rad_s))
