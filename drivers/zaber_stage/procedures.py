"""What is said to the stage, line by line, to open it and to carry out a command.

A procedure is a generator: it yields lines and is sent the reply to each. It touches no port and no clock.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import NamedTuple

from drivers.errors import CommandError
from drivers.messages import Command, Home, Listen, MoveAt, MoveTo, Stop
from drivers.zaber_stage import codec
from drivers.zaber_stage.mounting import Mounting, ZaberStageSettings


class Line(NamedTuple):
    """What is said next; `decisive` where it is the line that sets the stage in motion."""

    text: str
    decisive: bool = False


class RejectedError(Exception):
    """Why a procedure cannot go on."""


@dataclass(frozen=True, slots=True)
class Found:
    """What opening found and set; limits as the device has them, in metres from its home end."""

    device_id: str
    serial: str
    firmware: str
    acceleration_m_s2: float
    limits_found_m: tuple[float, float]
    limits_set_m: tuple[float, float]
    max_speed_m_s: float
    flags: tuple[str, ...]
    checksums: bool


Opening = Generator[Line, codec.Reply, Found]
Moving = Generator[Line, codec.Reply, int | None]
"""Ends with the count where the stage will stand, or None where that is the home end."""


def valid(device: str, settings: ZaberStageSettings, command: Command) -> Command:
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
    if not settings.travel_min_m <= target_m <= settings.travel_max_m:
        reason = f"its travel is {settings.travel_min_m:g} to {settings.travel_max_m:g} m"
        raise CommandError(device, doing, reason, "choose a target inside it")
    clamped_m_s = math.copysign(min(abs(speed_m_s), settings.max_speed_m_s), speed_m_s)
    if isinstance(command, MoveAt):
        return replace(command, velocity_m_s=clamped_m_s)
    return replace(command, speed_m_s=clamped_m_s)


def doing(command: Command | None) -> str:
    """What goes on while a command is carried out, for people."""
    match command:
        case MoveAt(limit_m=target_m) | MoveTo(position_m=target_m):
            return f"moving to {target_m:g} m"
        case Home():
            return "homing"
    return "standing"


class Procedures:
    """The procedures of one stage; remembers the limits that the device holds.

    Args:
        settings: Of the stage.
        mounting: Of the same.
    """

    def __init__(self, settings: ZaberStageSettings, mounting: Mounting) -> None:
        self._settings = settings
        self._mounting = mounting
        self._limits: dict[str, int] = {}

    def identify(self) -> Opening:
        """Asks who it is, stops it where it moves, sets travel and speed limits.

        Raises:
            RejectedError: it does not take a limit.
        """
        s, mounting = self._settings, self._mounting
        status = yield Line("")
        if status.busy:
            yield from _accepted(Line("stop"))
        checksums = (yield Line("set comm.checksum 1")).accepted
        device_id = yield from _accepted(Line("get deviceid"))
        serial = yield from _accepted(Line("get system.serial"))
        firmware = yield from _accepted(Line("get version"))
        acceleration = yield from _asked("accel")
        for name in ("limit.min", "limit.max"):
            self._limits[name] = yield from _asked(name)
        found_m = self._limits_m()
        yield from self._set_limits(mounting.lowest, mounting.highest)
        yield from _set("maxspeed", codec.velocity_data(s.max_speed_m_s, s.microstep_m))
        warnings = yield from _accepted(Line("warnings clear"))
        return Found(
            device_id=device_id.data,
            serial=serial.data,
            firmware=firmware.data,
            acceleration_m_s2=codec.acceleration_m_s2(acceleration, s.microstep_m),
            limits_found_m=found_m,
            limits_set_m=self._limits_m(),
            max_speed_m_s=s.max_speed_m_s,
            flags=tuple(warnings.data.split()[1:]),
            checksums=checksums,
        )

    def carry_out(self, command: Command) -> Moving:
        """Homes or moves.

        Raises:
            RejectedError: it is not homed, is beyond the limit, or rejects a line.
        """
        warnings = yield from _accepted(Line("warnings clear"))
        if not isinstance(command, MoveAt | MoveTo):
            yield from _accepted(Line("home", decisive=True))
            return None
        if codec.UNHOMED.intersection(warnings.data.split()):
            raise RejectedError("it does not know where it is; send Home first")
        mounting = self._mounting
        if isinstance(command, MoveTo):
            velocity_m_s = command.speed_m_s
            target = mounting.nearest(command.position_m)
            yield from self._set_limits(mounting.lowest, mounting.highest)
        else:
            velocity_m_s = command.velocity_m_s
            target = yield from self._limit(command)
        speed = max(1, codec.velocity_data(abs(velocity_m_s), self._settings.microstep_m))
        yield from _accepted(Line(f"move abs {mounting.device(target)} {speed}", decisive=True))
        return target

    def _limit(self, command: MoveAt) -> Generator[Line, codec.Reply, int]:
        """Makes the device itself hold the limit; where that is, in counts."""
        mounting = self._mounting
        forward = command.velocity_m_s > 0.0
        limit = mounting.at_most(command.limit_m) if forward else mounting.at_least(command.limit_m)
        yield from self._set_limits(*((mounting.lowest, limit) if forward else (limit, mounting.highest)))
        here = mounting.counts((yield from _asked("pos")))
        if here > limit if forward else here < limit:
            raise RejectedError(f"it is beyond the limit already, at {mounting.position_m(here):.6f} m")
        return limit

    def _set_limits(self, lowest: int, highest: int) -> Generator[Line, codec.Reply, None]:
        """Writes what differs, for the device keeps its limits in flash; the wider end comes first."""
        wanted = self._mounting.limits(lowest, highest)
        held = {name: self._limits.get(name, value) for name, value in wanted.items()}
        narrows = {
            "limit.min": wanted["limit.min"] > held["limit.min"],
            "limit.max": wanted["limit.max"] < held["limit.max"],
        }
        for name in sorted(wanted, key=narrows.__getitem__):
            if self._limits.get(name) != wanted[name]:
                self._limits.pop(name, None)  # unknown until it is read back: a stop may come in between
                yield from _set(name, wanted[name])
                self._limits[name] = wanted[name]

    def _limits_m(self) -> tuple[float, float]:
        microstep_m = self._settings.microstep_m
        return (
            codec.length_m(self._limits["limit.min"], microstep_m),
            codec.length_m(self._limits["limit.max"], microstep_m),
        )


def _accepted(line: Line) -> Generator[Line, codec.Reply, codec.Reply]:
    reply = yield line
    if not reply.accepted:
        reason = codec.REJECTIONS.get(reply.data, "it does not say why")
        raise RejectedError(f"it rejects {line.text!r} with {reply.data}: {reason}")
    return reply


def _asked(setting: str) -> Generator[Line, codec.Reply, int]:
    reply = yield from _accepted(Line(f"get {setting}"))
    try:
        return int(reply.data)
    except ValueError:
        raise RejectedError(f"it answers 'get {setting}' with {reply.data!r}") from None


def _set(setting: str, value: int) -> Generator[Line, codec.Reply, None]:
    """Sets and reads back."""
    yield from _accepted(Line(f"set {setting} {value}"))
    held = yield from _asked(setting)
    if held != value:
        raise RejectedError(f"it was told {setting} = {value} and holds {held}")
