"""What every mover on an approach axis has: bounds of travel and speed, and commands held against them."""

import math
from dataclasses import replace
from typing import Self

from pydantic import Field, model_validator

from drivers.core.errors import CommandError
from drivers.core.messages import MoveAt, MoveTo
from drivers.core.settings import Settings


class AxisLimits(Settings):
    """How far and how fast a mover may go; a device gives these its defaults, ranges and sources."""

    travel_min_m: float = Field()
    """Least position in metres."""
    travel_max_m: float = Field()
    """Greatest position in metres."""
    max_speed_m_s: float = Field(gt=0.0)
    """Greatest speed in m/s."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.travel_min_m < self.travel_max_m:
            raise ValueError(
                f"travel_min_m = {self.travel_min_m} is not below travel_max_m = {self.travel_max_m}"
            )
        return self

    def checked(self, device: str, command: MoveAt | MoveTo) -> MoveAt | MoveTo:
        """The command with too great a speed clamped.

        Raises:
            CommandError: not finite or out of range.
        """
        if isinstance(command, MoveAt):
            speed_m_s, target_m, sound = command.velocity_m_s, command.limit_m, command.velocity_m_s != 0.0
        else:
            speed_m_s, target_m, sound = command.speed_m_s, command.position_m, command.speed_m_s > 0.0
        doing = f"moving to {target_m:g} m at {speed_m_s:g} m/s"
        if not (sound and math.isfinite(speed_m_s)):
            raise CommandError(device, doing, f"{speed_m_s:g} m/s is no speed", "choose one above zero")
        if not self.travel_min_m <= target_m <= self.travel_max_m:
            reason = f"its travel is {self.travel_min_m:g} to {self.travel_max_m:g} m"
            advice = (
                f"choose a target inside it, or other travel_min_m and travel_max_m in [devices.{device}]"
            )
            raise CommandError(device, doing, reason, advice)
        if not command.blind_travel_m > 0.0:
            reason = f"a blind travel of {command.blind_travel_m:g} m lets it go nowhere"
            raise CommandError(device, doing, reason, "choose one above zero")
        clamped_m_s = math.copysign(min(abs(speed_m_s), self.max_speed_m_s), speed_m_s)
        if isinstance(command, MoveAt):
            return replace(command, velocity_m_s=clamped_m_s)
        return replace(command, speed_m_s=clamped_m_s)
