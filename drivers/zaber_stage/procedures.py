"""The lines that open the stage and carry out a command.

A procedure is a generator: it yields lines and is sent the reply to each. It touches no port and no clock. A line that
begins with one of `SETS_OUT` sets the stage in motion.
"""

import math
from collections.abc import Generator, Mapping
from typing import NamedTuple

from drivers.core.messages import Command, MoveAt, MoveTo
from drivers.zaber_stage import codec
from drivers.zaber_stage.models import AS_DELIVERED, StageModel, stage_model
from drivers.zaber_stage.mounting import NOT_HOMED, Mounting, ZaberStageSettings

SETS_OUT = ("home", "move")

RENEWED_SHARE = 0.25
"""How much of the blind travel is used up before the stage is sent on (assumption: it leaves three more chances)."""


AGREES = 0.01
"""How far the own limit of a stage of unknown model may be from the profile's travel (assumption: pitches differ by
more; an X-LSQ150A counts 1 % more than its 150 mm)."""

SAME = 1e-3
"""How far a profile's microstep may be from a known model's: data sheets print rounded ones."""

CHANGED = ("comm.checksum", "limit.min", "limit.max", "maxspeed")
"""What opening changes; the device keeps it when it is switched off."""

NOTE = "touchbench."
"""Keys in the device's own storage, of firmware 7.30 or later: what was found in a setting, and what it was set to."""

DATA_SHEET = "hold travel and speed in the profile against the stage's data sheet"


class RejectedError(Exception):
    """Why a procedure cannot go on."""

    def __init__(self, reason: str, advice: str = DATA_SHEET) -> None:
        super().__init__(reason)
        self.advice = advice


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


Opening = Generator[str, codec.StageReply, dict[str, object]]
"""Ends with what it found and set; limits as the device has them, in metres from its home end."""

Moving = Generator[str, codec.StageReply, StageWay | None]
"""Ends with the stage's way, or None where it goes to its home end."""


class Procedures:
    """The procedures of one stage; remembers what opening changed in it."""

    def __init__(self, settings: ZaberStageSettings, mounting: Mounting) -> None:
        self._settings = settings
        self._mounting = mounting
        self._serial = ""
        self._found: dict[str, int] = {}
        self._acceleration_m_s2 = math.nan

    def identify(self) -> Opening:
        """Queries its identity, stops it where it moves, holds it against the profile, sets travel and speed limits.

        Raises:
            RejectedError: it is too old, disagrees with the profile, or does not take a limit.
        """
        s = self._settings
        status = yield ""
        if status.busy:
            yield from _accepted("stop")
        firmware = yield from _accepted("get version")
        _check_firmware(firmware.data)
        serial = yield from _accepted("get system.serial")
        if serial.data != self._serial:
            self._serial = serial.data
            self._found.clear()
        left_changed = yield from self._recall()
        yield from self._hold("comm.checksum", 1)
        device_id = yield from _accepted("get deviceid")
        model = yield from self._known(device_id.data)
        acceleration = yield from _asked("motion.decelonly")  # at which it brakes
        if acceleration <= 0:
            raise RejectedError(
                f"its motion.decelonly is {acceleration}: how it brakes is not known",
                "set accel to what its data sheet says",
            )
        self._acceleration_m_s2 = codec.acceleration_m_s2(acceleration, s.microstep_m)
        limits = {}
        for name in ("limit.min", "limit.max"):
            held = yield from _asked(name)
            limits[name] = self._found.get(name, held)
        wanted = self._mounting.limits()
        if not model:
            self._check_pitch(limits["limit.max"], wanted["limit.max"], device_id.data)
        self._check_limits(limits, wanted)
        for name, value in wanted.items():
            yield from self._hold(name, value)
        yield from self._hold("maxspeed", codec.velocity_data(s.max_speed_m_s, s.microstep_m))
        warnings = yield from _accepted("warnings clear")
        flags = tuple(warnings.data.split()[1:])
        return {
            "device_id": device_id.data,
            "pitch_by": f"device id, {model.name}"
            if model
            else "limit.max and travel_m alone: jog 10 mm and measure",
            "serial": serial.data,
            "firmware": firmware.data,
            "microstep_m": s.microstep_m,
            "travel_m": s.travel_m,
            "acceleration_m_s2": self._acceleration_m_s2,
            "limits_found_m": self._metres(limits),
            "limits_set_m": self._metres(wanted),
            "max_speed_m_s": s.max_speed_m_s,
            "left_changed_by_another_run": left_changed,
            "flags": flags,
            "homed": codec.UNHOMED.isdisjoint(flags),
        }

    def put_back(self) -> Generator[str, codec.StageReply, None]:
        """Sets what opening changed to what it found: the device keeps its settings for good."""
        for name, value in reversed(self._found.items()):
            yield f"set {name} {value}"
            yield f"storage erase {NOTE}{name}"
        self._found.clear()

    def carry_out(self, command: Command) -> Moving:
        """Homes or moves.

        Raises:
            RejectedError: it is not homed, is beyond the target, or rejects a line.
        """
        warnings = yield from _accepted("warnings clear")
        if not isinstance(command, MoveAt | MoveTo):
            yield from _accepted("home")
            flagged = yield from _accepted("warnings")
            # What was interrupted is the motion that this replaced, or a way home whose reply was lost, and not this
            # one: it goes on, or it is over and the stage is home.
            if "NI" in flagged.data.split() and (flagged.busy or (yield from _asked("pos")) == 0):
                yield from _accepted("warnings clear")
            return None
        if codec.UNHOMED.intersection(warnings.data.split()):
            raise RejectedError(NOT_HOMED)
        mounting = self._mounting
        target = mounting.target(command)
        velocity_m_s = command.velocity_m_s if isinstance(command, MoveAt) else command.speed_m_s
        here = mounting.counts((yield from _asked("pos")))
        reason = mounting.refusal(command, here, self._acceleration_m_s2)
        if reason:
            raise RejectedError(reason)
        speed = max(1, codec.velocity_data(abs(velocity_m_s), self._settings.microstep_m))
        bound = mounting.ahead(here, target, command.blind_travel_m)
        way = StageWay(target, bound, speed, command.blind_travel_m)
        yield from _accepted(self.towards(way))
        return way

    def towards(self, way: StageWay) -> str:
        """The line that sends the stage to the bound of its way; one that moves goes on at its speed."""
        return f"move abs {self._mounting.device(way.bound)} {way.speed}"

    def renewed(self, way: StageWay, here: int) -> StageWay | None:
        """The way with its bound moved on; None where that may wait until more of what was given is used up."""
        bound = self._mounting.ahead(here, way.target, way.blind_travel_m)
        used = abs(bound - way.bound) * self._settings.microstep_m
        enough = used >= RENEWED_SHARE * way.blind_travel_m or (bound == way.target and used)
        return way._replace(bound=bound) if enough else None

    def _known(self, device_id: str) -> Generator[str, codec.StageReply, StageModel | None]:
        """The model of the device, where its id is known; the profile must state its microstep."""
        model, s = stage_model(device_id), self._settings
        if model is None:
            return None
        resolution = yield from _asked("resolution")
        microstep_m = model.microstep_m * AS_DELIVERED / resolution
        if abs(s.microstep_m - microstep_m) > SAME * microstep_m:
            counts = yield from _asked("limit.max")
            raise RejectedError(
                f"device id {device_id} is an {model.name}, whose microsteps are {microstep_m:.10g} m, not"
                f" microstep_m = {s.microstep_m:g}",
                f"enter microstep_m = {microstep_m:.10g}, and travel_m from the data sheet: its limit.max is"
                f" {counts * microstep_m:.4g} m",
            )
        return model

    def _check_pitch(self, counts: int, wanted: int, device_id: str) -> None:
        """The limit tells the pitch: a device counts its rail in microsteps, and names neither.

        Where it is what this profile sets, it was set after this check, by a program that was killed.
        """
        s = self._settings
        length_m = counts * s.microstep_m
        if counts != wanted and abs(length_m - s.travel_m) > AGREES * s.travel_m:
            raise RejectedError(
                f"its limit.max of {counts} microsteps is {length_m:.4g} m at microstep_m = {s.microstep_m:g}, not"
                f" travel_m = {s.travel_m:g}, which asks for microsteps of {s.travel_m / max(counts, 1):.4g} m",
                f"enter both from the data sheet of device id {device_id}; where they are right, its limit was"
                " changed: the maker's comes back with 'system restore'",
            )

    def _check_limits(self, found: Mapping[str, int], wanted: Mapping[str, int]) -> None:
        if wanted["limit.min"] < found["limit.min"] or wanted["limit.max"] > found["limit.max"]:
            lowest_m, highest_m = self._metres(found)
            raise RejectedError(
                f"its own limits are at {lowest_m:.6g} and {highest_m:.6g} m from its home end, inside the profile's",
                "choose travel_min_m and travel_max_m inside them",
            )

    def _recall(self) -> Generator[str, codec.StageReply, tuple[str, ...]]:
        """Takes what a program that died noted in the device as what was found; what was changed since stays so."""
        recalled = []
        for name in CHANGED:
            note = yield f"storage get {NOTE}{name}"
            found, _, left = note.data.partition(",")
            if not note.accepted:  # there is none, or the firmware has no storage
                continue
            held = yield from _asked(name)
            if str(held) == left and found.lstrip("-").isdecimal():
                self._found.setdefault(name, int(found))
                recalled.append(name)
            else:
                yield f"storage erase {NOTE}{name}"
        return tuple(recalled)

    def _hold(self, setting: str, value: int) -> Generator[str, codec.StageReply, None]:
        """Sets what differs, and reads it back; what was found is kept for `put_back`, and noted in the device."""
        found = yield from _asked(setting)
        if found == value:
            return
        self._found.setdefault(setting, found)  # of this stage, before it was first changed
        yield f"storage set {NOTE}{setting} {self._found[setting]},{value}"
        yield from _accepted(f"set {setting} {value}")
        held = yield from _asked(setting)
        if held != value:
            raise RejectedError(f"it was sent {setting} = {value} and holds {held}")

    def _metres(self, limits: Mapping[str, int]) -> tuple[float, float]:
        microstep_m = self._settings.microstep_m
        return limits["limit.min"] * microstep_m, limits["limit.max"] * microstep_m


def _check_firmware(found: str) -> None:
    """Raises `RejectedError` where it is too old for `move abs` with a speed."""
    major, _, minor = found.partition(".")
    if not (major.isdecimal() and minor.isdecimal()):
        raise RejectedError(f"it answers 'get version' with {found!r}")
    if (int(major), int(minor)) < codec.FIRMWARE:
        oldest = "{}.{}".format(*codec.FIRMWARE)
        raise RejectedError(
            f"its firmware {found} takes no speed in 'move abs', {oldest} is the first that does",
            "update it, or use another stage",
        )


def _accepted(line: str) -> Generator[str, codec.StageReply, codec.StageReply]:
    reply = yield line
    if not reply.accepted:
        reason = codec.REJECTIONS.get(reply.data, "it gives no reason")
        raise RejectedError(f"it rejects {line!r} with {reply.data}: {reason}")
    return reply


def _asked(setting: str) -> Generator[str, codec.StageReply, int]:
    reply = yield from _accepted(f"get {setting}")
    try:
        return int(reply.data)
    except ValueError:
        raise RejectedError(f"it answers 'get {setting}' with {reply.data!r}") from None
