"""The arm's controller as commands see it: its calls, and the meaning of its rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from drivers.ur_arm.pipe import ArmRow
from drivers.ur_arm.settings import Pose

PLAYING = 2
"""`runtime_state` of a running program (RTDE guide)."""

SAFETY = {
    7: "the emergency stop is pressed",
    6: "the robot's emergency stop is pressed",
    5: "the system's emergency stop is pressed",
    9: "the arm reports a fault",
    8: "the arm reports a safety violation",
    4: "the safeguard stop is on",
    2: "the arm is in a protective stop",
}
"""Bits of `safety_status_bits` that forbid motion, gravest first (RTDE guide)."""

PROTECTIVE_STOP = 1 << 2

STILL_M_S, STILL_RAD_S = 1e-3, 5e-3
"""Speeds below which nothing moves (assumption: noise of the joints' speeds at the tool)."""


class Seen(NamedTuple):
    """What is known of the arm: its latest row, and since when it has stood still (infinity where it moves)."""

    row: ArmRow
    still_since_s: float


class Client(Protocol):
    """The arm's controller as commands see it. False where the command was refused."""

    def speed(self, twist: Pose, acceleration_m_s2: float) -> bool:
        """Bring the tool to a twist, and keep it until the next one."""

    def end_speed(self) -> bool:
        """End tool speeds; the tool stands."""

    def move(self, pose: Pose, speed_m_s: float, acceleration_m_s2: float) -> bool:
        """Begin a straight move."""

    def end_move(self, deceleration_m_s2: float) -> bool:
        """Begin to stop a straight move."""

    def busy(self) -> bool:
        """Whether a move, or its stop, is under way."""

    def kick(self) -> bool:
        """Feed the controller's watchdog."""

    def zero_force(self) -> bool:
        """Take the present force for zero."""

    def halt(self) -> None:
        """Stop the controller's program from outside it."""

    def recover(self) -> str:
        """Unlock a protective stop and start the program again; why not, or ""."""


def trouble(row: ArmRow) -> str:
    """Why the arm will not move, or ""."""
    for bit, reason in SAFETY.items():
        if row.safety_bits >> bit & 1:
            return reason
    return "" if row.runtime == PLAYING else "the controller's program has stopped"


def still(twist: Sequence[float]) -> bool:
    """Whether a tool with this twist stands."""
    return math.hypot(*twist[:3]) < STILL_M_S and math.hypot(*twist[3:]) < STILL_RAD_S
