"""Which commands a stage takes, how they are clamped, and which it refuses: for driver and mock alike. Pure."""

from __future__ import annotations

from drivers.core.errors import CommandError
from drivers.core.messages import Command, Home, Listen, MoveAt, MoveTo, Stop
from drivers.zaber_stage.mounting import Mounting, StageLimits

RENEWAL_S = 0.05
"""How long a stage at speed must be able to go on before it is sent on: five looks at its position (assumption)."""

NOT_HOMED = "it does not know where it is; send Home first"
"""Why a stage that has lost its reference refuses every motion but `Home`."""


def valid(device: str, limits: StageLimits, command: Command) -> Command:
    """The command as it will be sent: too great a speed is clamped.

    Raises:
        CommandError: not for a stage, not finite or out of range.
    """
    match command:
        case Home() | Stop() | Listen():
            return command
        case MoveAt() | MoveTo():
            return limits.checked(device, command)
    raise CommandError(device, f"applying {command}", "a stage only moves", "send it to another device")


def refusal(mounting: Mounting, command: MoveAt | MoveTo, here: int, acceleration_m_s2: float) -> str:
    """Why a stage that knows where it is refuses a valid motion, or "".

    Args:
        mounting: Of the stage.
        command: The motion.
        here: Where it is, in counts.
        acceleration_m_s2: At which it brakes.
    """
    target = mounting.target(command)
    speed_m_s = abs(command.velocity_m_s) if isinstance(command, MoveAt) else command.speed_m_s
    forward = isinstance(command, MoveTo) or command.velocity_m_s > 0.0
    if isinstance(command, MoveAt) and (here > target if forward else here < target):
        return f"it is beyond the limit already, at {mounting.position_m(here):.6f} m"
    needed_m = speed_m_s**2 / (2.0 * acceleration_m_s2) + speed_m_s * RENEWAL_S
    if mounting.ahead(here, target, command.blind_travel_m) != target and needed_m > command.blind_travel_m:
        return (
            f"a stage at {speed_m_s:g} m/s needs {needed_m:.2g} m to brake and be sent on in time, but"
            f" limits.blind_travel_m is {command.blind_travel_m:g}; give it more, or go slower"
        )
    return ""


def doing(command: Command | None) -> str:
    """What the stage does while a command is carried out, for error messages."""
    match command:
        case MoveAt(limit_m=target_m) | MoveTo(position_m=target_m):
            return f"moving to {target_m:g} m"
        case Home():
            return "homing"
    return "standing"
