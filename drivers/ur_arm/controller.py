"""What a UR controller's status means."""

from __future__ import annotations

from typing import NamedTuple

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


class ControllerState(NamedTuple):
    """Of one row: `safety_status_bits` and `runtime_state`."""

    safety_bits: int
    runtime: int

    @property
    def playing(self) -> bool:
        """Whether its program runs."""
        return self.runtime == PLAYING

    @property
    def danger(self) -> str:
        """Which safety function forbids motion, or ""."""
        return next((reason for bit, reason in SAFETY.items() if self.safety_bits >> bit & 1), "")

    @property
    def fault(self) -> str:
        """Why the arm will not move, or ""."""
        return self.danger or ("" if self.playing else "the controller's program has stopped")
