"""The lines that open the stage and carry out a command.

A procedure is a generator: it yields lines and is sent the reply to each. It touches no port and no clock.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import NamedTuple

from drivers.messages import Command, MoveAt, MoveTo
from drivers.zaber_stage import codec
from drivers.zaber_stage.commands import NOT_HOMED, refusal
from drivers.zaber_stage.mounting import Mounting, ZaberStageSettings

RENEWED_SHARE = 0.25
"""How much of the blind travel is used up before the stage is sent on (assumption: it leaves three more chances)."""


class StageLine(NamedTuple):
    """A line to send; `decisive` where it sets the stage in motion."""

    text: str
    decisive: bool = False


class RejectedError(Exception):
    """Why a procedure cannot go on."""


@dataclass(frozen=True, slots=True)
class StageFound:
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


class StageWay(NamedTuple):
    """Where a motion leads, in counts.

    Attributes:
        target: Where it ends.
        bound: Where the device has been sent so far: it stops there unless it is sent on.
        speed: Velocity data.
        blind_travel_m: How far ahead of its last known position it may be sent.
    """

    target: int
    bound: int
    speed: int
    blind_travel_m: float


Opening = Generator[StageLine, codec.StageReply, StageFound]
Moving = Generator[StageLine, codec.StageReply, StageWay | None]
"""Ends with the stage's way, or None where it goes to its home end."""


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
        self._acceleration_m_s2 = math.nan

    def identify(self) -> Opening:
        """Queries its identity, stops it where it moves, sets travel and speed limits.

        Raises:
            RejectedError: it does not take a limit.
        """
        s, mounting = self._settings, self._mounting
        status = yield StageLine("")
        if status.busy:
            yield from _accepted(StageLine("stop"))
        checksums = (yield StageLine("set comm.checksum 1")).accepted
        device_id = yield from _accepted(StageLine("get deviceid"))
        serial = yield from _accepted(StageLine("get system.serial"))
        firmware = yield from _accepted(StageLine("get version"))
        acceleration = yield from _asked("accel")
        self._acceleration_m_s2 = codec.acceleration_m_s2(acceleration, s.microstep_m)
        for name in ("limit.min", "limit.max"):
            self._limits[name] = yield from _asked(name)
        found_m = self._limits_m()
        yield from self._set_limits(mounting.lowest, mounting.highest)
        yield from _set("maxspeed", codec.velocity_data(s.max_speed_m_s, s.microstep_m))
        warnings = yield from _accepted(StageLine("warnings clear"))
        return StageFound(
            device_id=device_id.data,
            serial=serial.data,
            firmware=firmware.data,
            acceleration_m_s2=self._acceleration_m_s2,
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
        warnings = yield from _accepted(StageLine("warnings clear"))
        if not isinstance(command, MoveAt | MoveTo):
            yield from _accepted(StageLine("home", decisive=True))
            return None
        if codec.UNHOMED.intersection(warnings.data.split()):
            raise RejectedError(NOT_HOMED)
        mounting = self._mounting
        target, ends = mounting.target(command), (mounting.lowest, mounting.highest)
        velocity_m_s = command.velocity_m_s if isinstance(command, MoveAt) else command.speed_m_s
        if isinstance(command, MoveAt):  # the device itself holds the limit
            ends = (mounting.lowest, target) if velocity_m_s > 0.0 else (target, mounting.highest)
        yield from self._set_limits(*ends)
        here = mounting.counts((yield from _asked("pos")))
        reason = refusal(mounting, command, here, self._acceleration_m_s2)
        if reason:
            raise RejectedError(reason)
        speed = max(1, codec.velocity_data(abs(velocity_m_s), self._settings.microstep_m))
        bound = mounting.ahead(here, target, command.blind_travel_m)
        way = StageWay(target, bound, speed, command.blind_travel_m)
        yield from _accepted(self.towards(way))
        return way

    def towards(self, way: StageWay) -> StageLine:
        """The line that sends the stage to the bound of its way; one that moves goes on at its speed."""
        return StageLine(f"move abs {self._mounting.device(way.bound)} {way.speed}", decisive=True)

    def renewed(self, way: StageWay, here: int) -> StageWay | None:
        """The way with its bound moved on; None where that may wait until more of what was given is used up."""
        bound = self._mounting.ahead(here, way.target, way.blind_travel_m)
        used = abs(bound - way.bound) * self._settings.microstep_m
        enough = used >= RENEWED_SHARE * way.blind_travel_m or (bound == way.target and used)
        return way._replace(bound=bound) if enough else None

    def _set_limits(self, lowest: int, highest: int) -> Generator[StageLine, codec.StageReply, None]:
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


def _accepted(line: StageLine) -> Generator[StageLine, codec.StageReply, codec.StageReply]:
    reply = yield line
    if not reply.accepted:
        reason = codec.REJECTIONS.get(reply.data, "it gives no reason")
        raise RejectedError(f"it rejects {line.text!r} with {reply.data}: {reason}")
    return reply


def _asked(setting: str) -> Generator[StageLine, codec.StageReply, int]:
    reply = yield from _accepted(StageLine(f"get {setting}"))
    try:
        return int(reply.data)
    except ValueError:
        raise RejectedError(f"it answers 'get {setting}' with {reply.data!r}") from None


def _set(setting: str, value: int) -> Generator[StageLine, codec.StageReply, None]:
    """Sets and reads back."""
    yield from _accepted(StageLine(f"set {setting} {value}"))
    held = yield from _asked(setting)
    if held != value:
        raise RejectedError(f"it was sent {setting} = {value} and holds {held}")
