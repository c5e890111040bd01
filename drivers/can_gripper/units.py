"""SSG-48: what it counts ⇄ SI."""

from __future__ import annotations

import math
from typing import Final

LONGEST_S: Final = 0.05
"""Longest time between two states while all is well, s. Assumption: five at 100 Hz."""

STROKE_M: Final = 0.048
"""Travel of the opening (data sheet)."""

POSITION_COUNTS: Final = 255
"""Positions run from 0, open, to this, closed: 0.19 mm a count (docs/reference/can_gripper.md)."""

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

FORCE_N_PER_MA: Final = 0.0462
"""Force of the jaws for each milliampere: a public driver's fit to the data sheet's curve."""

STEADY_MA: Final = 150
"""Least current at which the gripper is stable (data sheet: "below 150 are unstable")."""

MOST_MA: Final = 1300
"""Greatest current (data sheet)."""


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


def opening_m(position: int) -> float:
    """By how much the jaws are open at a position: 0 closed, `STROKE_M` open."""
    return STROKE_M * (POSITION_COUNTS - position) / POSITION_COUNTS


def position_count(opening_m_: float) -> int:
    """The position nearest to an opening."""
    return round(POSITION_COUNTS * (1.0 - opening_m_ / STROKE_M))
