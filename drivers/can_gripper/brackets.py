"""Where the gripper is, what its fingers stand on, how far, fast and hard it may go; SI ⇄ its orders."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Self

from pydantic import Field, model_validator

from drivers.can_gripper import units
from drivers.can_gripper.messages import DriveOrder, GripperState
from drivers.core.can_link import CanPort
from drivers.core.errors import CommandError
from drivers.core.messages import Command, Grip, Home, Listen, Release, Stop

CLOSED_MIN_M = 0.008
CLOSED_MAX_M = 0.085 - units.STROKE_M
"""Least and greatest opening of closed jaws: the brackets reach from 8 to 85 mm (the bench's page)."""

FORCE_MIN_N = units.STEADY_MA * units.FORCE_N_PER_MA
FORCE_MAX_N = units.MOST_MA * units.FORCE_N_PER_MA
"""6.9 N and 60 N: what the currents allow that the gripper is stable at."""

SPEED_MAX_M_S = units.speed_m_s(units.SPEED_COUNTS)
"""0.37 m/s: both jaws at their fastest."""

ROUNDING_M = 1e-9
"""By how much a width may leave the travel and still count as its end (assumption)."""


class CanGripperSettings(CanPort):
    """A gripper on a CAN bus; widths are the opening between its fingers."""

    node: int = Field(default=0, ge=0, le=15)
    """Node number on the bus (docs/reference/can_gripper.md: 0 by default)."""
    closed_width_m: float = Field(default=CLOSED_MIN_M, ge=CLOSED_MIN_M, le=CLOSED_MAX_M)
    """Opening of the closed jaws: set by the brackets that the fingers stand on, 48 mm less than the open ones."""
    max_speed_m_s: float = Field(default=0.1, gt=0.0, le=SPEED_MAX_M_S)
    """Greatest rate of the opening (assumption: a quarter of what it can do)."""
    max_force_n: float = Field(default=FORCE_MAX_N, ge=FORCE_MIN_N, le=FORCE_MAX_N)
    """Greatest force that may be asked for."""
    release_force_n: float = Field(default=15.0, ge=FORCE_MIN_N, le=FORCE_MAX_N)
    """How hard it may press outwards while it opens (assumption: twice what steady motion needs)."""
    force_n_per_ma: float = Field(default=units.FORCE_N_PER_MA, gt=0.0, le=1.0)
    """Force of the jaws in N for each mA of motor current."""
    watchdog_s: float = Field(default=1.0, ge=0.2, le=60.0)
    """The gripper opens its grip when the host is silent for this long (assumption: twice the tolerated silence)."""
    poll_interval_s: float = Field(default=0.01, ge=0.002, le=0.1)
    """Time between two questions while it moves, holds or is subscribed (data sheet: 50 Hz or faster)."""
    idle_interval_s: float = Field(default=0.1, ge=0.002, le=5.0)
    """The same otherwise: it feeds the watchdog (assumption)."""
    reply_timeout_s: float = Field(default=0.05, gt=0.0, le=5.0)
    """When an answer counts as lost. Assumption: three times the longest delay measured on a pty."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=30.0)
    """Silence after which the gripper has failed (assumption: ten lost answers)."""
    object_hold_s: float = Field(default=0.03, ge=0.0, le=1.0)
    """How long something must hold the jaws to be an object: a start at full current looks like one for some ms."""

    @model_validator(mode="after")
    def _fed_in_time(self) -> Self:
        slowest_s = max(self.idle_interval_s, self.poll_interval_s) + self.reply_timeout_s
        if self.watchdog_s < 2.0 * slowest_s:
            raise ValueError(
                f"watchdog_s = {self.watchdog_s:g} is less than twice idle_interval_s + reply_timeout_s"
                f" = {slowest_s:g}: one lost answer would open the grip"
            )
        return self


class Brackets:
    """Turns widths, speeds and forces into the gripper's orders, and its states into widths and forces.

    Args:
        closed_width_m: Opening of the closed jaws.
        force_n_per_ma: Force for each mA.
    """

    def __init__(self, closed_width_m: float, force_n_per_ma: float = units.FORCE_N_PER_MA) -> None:
        self.closed_width_m = closed_width_m
        self.open_width_m = closed_width_m + units.STROKE_M
        self._force_n_per_ma = force_n_per_ma

    def width_m(self, position: int) -> float:
        """Opening at a position."""
        return self.closed_width_m + units.opening_m(position)

    def position(self, width_m: float) -> int:
        """The position nearest to an opening."""
        return units.position_count(width_m - self.closed_width_m)

    def current_ma(self, force_n: float) -> int:
        """The greatest current that presses no harder than a force."""
        return math.floor(force_n / self._force_n_per_ma + 1e-9)

    def force_n(self, current_ma: int) -> float:
        """How hard a current presses, whichever way."""
        return abs(current_ma) * self._force_n_per_ma

    def grip(self, command: Grip) -> DriveOrder:
        """The order that carries out a command."""
        speed, current_ma = units.speed_count(command.speed_m_s), self.current_ma(command.force_n)
        return DriveOrder(self.position(command.width_m), speed, current_ma)

    def release(self, command: Release, force_n: float) -> DriveOrder:
        """The same."""
        return DriveOrder(0, units.speed_count(command.speed_m_s), self.current_ma(force_n))

    def hold(self, state: GripperState, order: DriveOrder) -> DriveOrder:
        """The order that stops a motion where it is."""
        return replace(order, position=state.position)

    def as_sent(self, command: Grip) -> Grip:
        """The command as the gripper's counts have it."""
        order = self.grip(command)
        return replace(
            command,
            width_m=self.width_m(order.position),
            speed_m_s=units.speed_m_s(order.speed),
            force_n=self.force_n(order.current_ma),
        )


def valid(
    device: str, brackets: Brackets, max_speed_m_s: float, max_force_n: float, command: Command
) -> Command:
    """The command as it will be sent: too great a speed is clamped, numbers are rounded to the gripper's counts.

    Raises:
        CommandError: not for a gripper, not finite or out of range.
    """
    match command:
        case Home() | Stop() | Listen():
            return command
        case Release(speed_m_s=speed_m_s):
            doing = "opening"
        case Grip(speed_m_s=speed_m_s):
            doing = f"gripping at {command.width_m * 1e3:g} mm with {command.force_n:g} N"
        case _:
            advice = "a gripper can Home, Grip, Release, Stop and Listen"
            raise CommandError(device, f"applying {type(command).__name__}", "it has no such command", advice)
    if not (math.isfinite(speed_m_s) and speed_m_s > 0.0):
        raise CommandError(device, doing, f"{speed_m_s:g} m/s is no speed", "choose one above zero")
    if isinstance(command, Release):
        return replace(command, speed_m_s=units.speed_m_s(units.speed_count(min(speed_m_s, max_speed_m_s))))
    lowest_m, highest_m = brackets.closed_width_m - ROUNDING_M, brackets.open_width_m + ROUNDING_M
    if not lowest_m <= command.width_m <= highest_m:
        reach = f"{brackets.closed_width_m * 1e3:g} to {brackets.open_width_m * 1e3:g} mm"
        raise CommandError(device, doing, f"its brackets let it open {reach}", "choose a width inside that")
    if not FORCE_MIN_N - ROUNDING_M <= command.force_n <= max_force_n + ROUNDING_M:
        advice = f"choose from {FORCE_MIN_N:.3g} to {max_force_n:.3g} N"
        raise CommandError(device, doing, f"{command.force_n:g} N is out of range", advice)
    return brackets.as_sent(replace(command, speed_m_s=min(speed_m_s, max_speed_m_s)))
