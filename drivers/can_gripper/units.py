"""SSG-48: SI ⇄ what it counts, and which commands it takes."""

import math
from dataclasses import replace
from typing import Final

from pydantic import Field

from drivers.can_gripper.codec import DriveOrder
from drivers.core.messages import Grip, Release
from drivers.core.settings import Settings
from drivers.gripper.units import JawUnits

LONGEST_S: Final = 0.05
"""Longest time between two states while all is well, s. Assumption: five at 100 Hz."""

STROKE_M: Final = 0.048
"""Travel of the opening (data sheet)."""

CLOSED_MIN_M: Final = 0.008
CLOSED_MAX_M: Final = 0.085 - STROKE_M
"""Least and greatest opening of closed jaws: the brackets reach from 8 to 85 mm (the bench's page)."""

POSITION_COUNTS: Final = 255
"""Positions run from 0, open, to this, closed: 0.19 mm a count (docs/reference/grippers.md)."""

PINION_M: Final = 0.006
"""Radius of the pinion between the two racks (data sheet, "Gripper linear speed")."""

TICKS_PER_TURN: Final = 2**14
"""Of the motor's encoder (data sheet)."""

TICKS_PER_M: Final = TICKS_PER_TURN / (2.0 * math.pi * PINION_M) / 2.0
"""Encoder ticks for each metre of opening: both jaws move, each by half of it."""

SLOWEST_TICKS_S: Final = 40.0
"""Speed 0 (data sheet)."""

FASTEST_TICKS_S: Final = 80_000.0
"""Speed 255 (data sheet)."""

SPEED_COUNTS: Final = 255

SPEED_MAX_M_S: Final = FASTEST_TICKS_S / TICKS_PER_M
"""0.37 m/s: both jaws at their fastest."""

FORCE_N_PER_MA: Final = 0.0462
"""Force of the jaws for each milliampere: a public driver's fit to the data sheet's curve."""

STEADY_MA: Final = 150
"""Least current at which the gripper is stable (data sheet: "below 150 are unstable")."""

MOST_MA: Final = 1300
"""Greatest current (data sheet)."""

FORCE_MIN_N: Final = STEADY_MA * FORCE_N_PER_MA
FORCE_MAX_N: Final = MOST_MA * FORCE_N_PER_MA
"""6.9 N and 60 N: what the currents allow that the gripper is stable at."""


def speed_count(speed_m_s: float) -> int:
    """The greatest speed that is not above this one; the slowest where there is none."""
    share = (speed_m_s * TICKS_PER_M - SLOWEST_TICKS_S) / (FASTEST_TICKS_S - SLOWEST_TICKS_S)
    return min(max(math.floor(share * SPEED_COUNTS + 1e-9), 0), SPEED_COUNTS)


def speed_ticks_s(count: int) -> float:
    """Encoder ticks per second of a speed."""
    return SLOWEST_TICKS_S + (FASTEST_TICKS_S - SLOWEST_TICKS_S) * count / SPEED_COUNTS


def speed_m_s(count: int) -> float:
    """How fast the opening changes at a speed, in m/s."""
    return speed_ticks_s(count) / TICKS_PER_M


class CanGripperLimits(Settings):
    """What a gripper may be asked for."""

    max_speed_m_s: float = Field(default=0.1, gt=0.0, le=SPEED_MAX_M_S)
    """Greatest rate of the opening (assumption: a quarter of what it can do)."""
    max_force_n: float = Field(default=FORCE_MAX_N, ge=FORCE_MIN_N, le=FORCE_MAX_N)
    """Greatest force that may be asked for."""
    release_force_n: float = Field(default=15.0, ge=FORCE_MIN_N, le=FORCE_MAX_N)
    """How hard it may press outwards while it opens (assumption: twice what steady motion needs)."""
    object_hold_s: float = Field(default=0.03, ge=0.0, le=1.0)
    """How long something must hold the jaws to be an object: a start at full current looks like one for some ms."""

    @property
    def forces_n(self) -> tuple[float, float]:
        """Least and greatest force that may be asked for."""
        return FORCE_MIN_N, self.max_force_n


class GripperUnits(JawUnits):
    """Turns widths and forces into the gripper's counts and back, and commands into its orders.

    Args:
        closed_width_m: Opening of the closed jaws: set by the brackets that the fingers stand on.
    """

    force_min_n = FORCE_MIN_N
    reach = "its brackets let it open"

    def __init__(self, closed_width_m: float, force_n_per_ma: float = FORCE_N_PER_MA) -> None:
        self.closed_width_m = closed_width_m
        self.open_width_m = closed_width_m + STROKE_M
        self._force_n_per_ma = force_n_per_ma

    def width_m(self, position: int) -> float:
        """Opening at a position."""
        return self.closed_width_m + STROKE_M * (POSITION_COUNTS - position) / POSITION_COUNTS

    def position(self, width_m: float) -> int:
        """The position nearest to an opening."""
        return round(POSITION_COUNTS * (1.0 - (width_m - self.closed_width_m) / STROKE_M))

    def ahead(self, position: int, order: DriveOrder, seconds: float) -> int:
        """The position that an order leads to from this one within a time, at its speed."""
        counts = math.floor(speed_m_s(order.speed) * seconds * POSITION_COUNTS / STROKE_M)
        return position + max(-counts, min(counts, order.position - position))

    def current_ma(self, force_n: float) -> int:
        """The greatest current that presses no harder than a force."""
        return math.floor(force_n / self._force_n_per_ma + 1e-9)

    def force_n(self, current_ma: int) -> float:
        """How hard a current presses, whichever way."""
        return abs(current_ma) * self._force_n_per_ma

    def grip(self, command: Grip) -> DriveOrder:
        """The order that carries out a command."""
        speed, current_ma = speed_count(command.speed_m_s), self.current_ma(command.force_n)
        return DriveOrder(self.position(command.width_m), speed, current_ma)

    def release(self, command: Release, force_n: float) -> DriveOrder:
        """The same; `force_n` is how hard it may press outwards."""
        return DriveOrder(0, speed_count(command.speed_m_s), self.current_ma(force_n))

    def rounded(self, command: Grip | Release) -> Grip | Release:
        """See `JawUnits.rounded`."""
        if isinstance(command, Release):
            return replace(command, speed_m_s=speed_m_s(speed_count(command.speed_m_s)))
        order = self.grip(command)
        return replace(
            command,
            width_m=self.width_m(order.position),
            speed_m_s=speed_m_s(order.speed),
            force_n=self.force_n(order.current_ma),
        )
