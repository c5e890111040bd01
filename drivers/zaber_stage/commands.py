"""Which commands a stage takes, how they are clamped, and which it refuses: for driver and mock alike. Pure."""

from __future__ import annotations

import math
from dataclasses import replace

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
        case MoveAt(velocity_m_s=speed_m_s, limit_m=target_m):
            pass
        case MoveTo(position_m=target_m, speed_m_s=speed_m_s):
            pass
        case _:
            raise CommandError(
                device, f"applying {command}", "a stage only moves", "send it to another device"
            )
    doing = f"moving to {target_m:g} m at {speed_m_s:g} m/s"
    if not math.isfinite(speed_m_s) or speed_m_s == 0.0 or (speed_m_s < 0.0 and isinstance(command, MoveTo)):
        raise CommandError(device, doing, f"{speed_m_s:g} m/s is no speed", "choose one above zero")
    if not limits.travel_min_m <= target_m <= limits.travel_max_m:
        reason = f"its travel is {limits.travel_min_m:g} to {limits.travel_max_m:g} m"
        raise CommandError(device, doing, reason, "choose a target inside it")
    if not command.blind_travel_m > 0.0:
        reason = f"a blind travel of {command.blind_travel_m:g} m lets it go nowhere"
        raise CommandError(device, doing, reason, "choose one above zero")
    clamped_m_s = math.copysign(min(abs(speed_m_s), limits.max_speed_m_s), speed_m_s)
    if isinstance(command, MoveAt):
        return replace(command, velocity_m_s=clamped_m_s)
    return replace(command, speed_m_s=clamped_m_s)


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
