"""Which commands an arm takes, and how they are clamped. Every number is checked here, before it goes anywhere."""

import math
from collections.abc import Collection
from dataclasses import replace

from drivers.arm.axis import Axis
from drivers.arm.settings import ArmSettings
from drivers.core.errors import CommandError
from drivers.core.messages import Command, Home, Lead, Listen, MoveAt, MovePose, MoveTo, Stop, Tare, Twist

ROUNDING_M = 1e-9
"""A place at the very end of the travel is inside it, however its sum is rounded (assumption)."""

TWIST_MAX_S = 60.0
"""Longest `Twist`: what takes longer is sent again (assumption)."""


def valid(device: str, settings: ArmSettings, streams: Collection[str], command: Command) -> Command:
    """The command as it will be sent: too great a speed is clamped.

    Raises:
        CommandError: not for an arm, not finite, or out of range.
    """
    match command:
        case Home() | Stop() | Lead() | Listen():
            # What a Listen names of other devices is their business: one command names all streams.
            return command
        case Tare(stream=stream):
            if stream != f"{device}.force":
                reason = f"{stream} cannot be tared"
                raise CommandError(device, "taring", reason, f"its streams are {', '.join(sorted(streams))}")
            return command
        case MoveAt() | MoveTo():
            return settings.checked(device, command)
        case Twist():
            return _checked_twist(device, settings, command)
        case MovePose():
            return _checked_pose(device, settings, command)
    raise CommandError(device, f"applying {command}", "an arm only moves", "send it to another device")


def _checked_twist(device: str, settings: ArmSettings, command: Twist) -> Twist:
    doing = f"moving with {command.twist} for {command.duration_s} s"
    if len(command.twist) != 6 or not all(math.isfinite(part) for part in command.twist):
        raise CommandError(device, doing, "this is no twist", "give six finite numbers: m/s and rad/s")
    if not 0.0 < command.duration_s <= TWIST_MAX_S:
        advice = f"choose a duration above 0 and up to {TWIST_MAX_S:g} s"
        raise CommandError(device, doing, f"{command.duration_s} s is no duration", advice)
    linear, angular = command.twist[:3], command.twist[3:]
    # One factor for all six keeps the direction of the motion.
    factor = min(
        1.0,
        settings.max_speed_m_s / max(math.hypot(*linear), settings.max_speed_m_s),
        settings.max_turn_rad_s / max(math.hypot(*angular), settings.max_turn_rad_s),
    )
    x, y, z, rx, ry, rz = (factor * part for part in command.twist)
    return replace(command, twist=(x, y, z, rx, ry, rz))


def _checked_pose(device: str, settings: ArmSettings, command: MovePose) -> MovePose:
    offset = command.offset
    doing = f"moving to {offset} from start_pose at {command.speed_m_s} m/s"
    if len(offset) != 6 or not all(math.isfinite(part) for part in offset):
        raise CommandError(device, doing, "this is no offset", "give six finite numbers: m and rad")
    if not (math.isfinite(command.speed_m_s) and command.speed_m_s > 0.0):
        raise CommandError(device, doing, "this is no speed", "choose one above zero")
    if math.hypot(*offset[3:]) > math.pi:
        raise CommandError(device, doing, "it turns by more than pi", "choose the shorter way round")
    if math.hypot(*offset[:3]) > settings.leash_m:
        reason = f"its leash is {settings.leash_m:g} m"
        advice = f"choose a place inside it, or give [devices.{device}] more leash_m"
        raise CommandError(device, doing, reason, advice)
    x, y, z = Axis(settings).displaced(offset)[:3]
    position_m = Axis(settings).position_m((x, y, z, 0.0, 0.0, 0.0))
    if not settings.travel_min_m - ROUNDING_M <= position_m <= settings.travel_max_m + ROUNDING_M:
        reason = f"its travel is {settings.travel_min_m:g} to {settings.travel_max_m:g} m"
        advice = f"choose a place inside it, or other travel_min_m and travel_max_m in [devices.{device}]"
        raise CommandError(device, doing, reason, advice)
    # Whether it only turns shows when it begins: then the limit of the translation holds where there is one.
    fastest = (
        max(settings.max_speed_m_s, settings.max_turn_rad_s) if any(offset[3:]) else settings.max_speed_m_s
    )
    return replace(command, speed_m_s=min(command.speed_m_s, fastest))
