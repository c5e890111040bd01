"""Which commands any gripper takes; SI ⇄ what it counts is its make's. Pure."""

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar, Final

from drivers.core.errors import CommandError, wrong
from drivers.core.messages import Command, Grip, Home, Listen, Release, Stop

ROUNDING_M: Final = 1e-9
"""By how much a width may leave the travel and still count as its end (assumption)."""


class JawUnits(ABC):
    """Turns widths and forces into a gripper's counts and back; a make derives from it.

    Attributes:
        closed_width_m: Opening of the closed jaws.
        open_width_m: Of the open ones.
        force_min_n: Least force that it can be asked for.
        reach: What lets it open so far, for a refusal.
    """

    closed_width_m: float
    open_width_m: float
    force_min_n: float
    reach: ClassVar[str] = "it opens"

    @abstractmethod
    def width_m(self, position: int) -> float:
        """Opening at a position."""

    @abstractmethod
    def force_n(self, current_ma: int) -> float:
        """How hard what a `GripperState` has as current presses, whichever way."""

    @abstractmethod
    def rounded(self, command: Grip | Release) -> Grip | Release:
        """A valid command with its numbers rounded to the gripper's counts; force and speed down."""

    def checked(self, device: str, command: Command, max_speed_m_s: float, max_force_n: float) -> Command:
        """The command as it will be sent: too great a speed is clamped, numbers are rounded to the gripper's counts.

        Raises:
            CommandError: not for a gripper, not finite or out of range.
        """
        match command:
            case Home() | Stop() | Listen():
                return command
            case Release(speed_m_s=asked_m_s):
                doing = "opening"
            case Grip(speed_m_s=asked_m_s):
                doing = f"gripping at {command.width_m * 1e3:g} mm with {command.force_n:g} N"
            case _:
                advice = "a gripper can Home, Grip, Release, Stop and Listen"
                raise wrong(device, command, "it has no such command", advice)
        if not (math.isfinite(asked_m_s) and asked_m_s > 0.0):
            raise CommandError(device, doing, f"{asked_m_s:g} m/s is no speed", "choose one above zero")
        clamped_m_s = min(asked_m_s, max_speed_m_s)
        if isinstance(command, Release):
            return self.rounded(replace(command, speed_m_s=clamped_m_s))
        if not self.closed_width_m - ROUNDING_M <= command.width_m <= self.open_width_m + ROUNDING_M:
            reach = f"{self.closed_width_m * 1e3:g} to {self.open_width_m * 1e3:g} mm"
            advice = "choose a width inside that"
            raise CommandError(device, doing, f"{self.reach} {reach}", advice)
        if not self.force_min_n - ROUNDING_M <= command.force_n <= max_force_n + ROUNDING_M:
            advice = f"choose from {self.force_min_n:.3g} to {max_force_n:.3g} N"
            raise CommandError(device, doing, f"{command.force_n:g} N is out of range", advice)
        return self.rounded(replace(command, speed_m_s=clamped_m_s))
