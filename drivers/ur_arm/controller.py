"""What a UR controller's status means."""

from __future__ import annotations

PLAYING = 2
"""`runtime_state` of a running program (RTDE guide)."""

PROTECTIVE_STOP = "the arm is in a protective stop"

STOPPED = "the controller's program has stopped"

SAFETY = {
    7: "the emergency stop is pressed",
    6: "the robot's emergency stop is pressed",
    5: "the system's emergency stop is pressed",
    9: "the arm reports a fault",
    8: "the arm reports a safety violation",
    4: "the safeguard stop is on",
    2: PROTECTIVE_STOP,
}
"""Bits of `safety_status_bits` that forbid motion, gravest first (RTDE guide)."""


def fault_of(safety_bits: int, running: bool) -> str:
    """Why the arm will not move, or "": a safety function, else its program has stopped."""
    danger = next((reason for bit, reason in SAFETY.items() if safety_bits >> bit & 1), "")
    return danger or ("" if running else STOPPED)
