"""An emulated linear stage: Zaber ASCII on the motion of a `StageAxis`; no port, no clock."""

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from drivers.core.errors import CodecError
from drivers.core.links import LineBuffer
from drivers.zaber_stage import codec
from drivers.zaber_stage.mounting import ZaberStageSettings
from simulator.devices.far_end import EmulatedDevice
from simulator.physics.bench import Bench
from simulator.physics.stage_axis import STAGE_HOME_M_S, STAGE_M_S, STAGE_M_S2, StageAxis

CONSTANTS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("zaber_constants.toml").read_text("utf-8"))
"""Settings that can be read and never change."""

OF_THE_DEVICE = ("comm.", "deviceid", "system.", "version")
"""Beginnings of the settings of the whole device, which no axis has (vendor's library: settings by scope)."""

STORAGE = (7, 30)
"""The first firmware with storage (Zaber Motion Library, `DeviceStorage`)."""

LASTING = codec.UNHOMED | {"FD", "WV", "WT"}
"""Flags that `warnings clear` leaves: what they say still holds (Zaber ASCII protocol)."""

DATA = 2**31 - 1
"""Greatest number of a command (Zaber ASCII protocol: 32 bits, signed)."""


ADDRESS, DEVICE_ID, SERIAL = 1, 1, 40001
"""Number on the line, model number (no model's, so that `microstep_m` may be any), serial number (assumption)."""

FIRMWARE = "7.38"
"""Firmware that it reports: one in which `move abs` takes a velocity."""


class EmulatedZaberStage(EmulatedDevice):
    """Answers as the stage does: bytes in, bytes out, and time from outside.

    Positions of the axis are metres of the rail, 0 at its home end. Bytes may arrive split anywhere. A line
    with a wrong checksum, for another device or of another protocol is dropped silently, as the
    device drops it. Replies carry a checksum once `comm.checksum` is set.

    Args:
        on_plan: Called with the time of each new plan of the axis.
        travel_m: Length of the rail.
        homed: True where it has been homed before the program starts.
    """

    called = "a stage"

    def __init__(
        self,
        axis: StageAxis,
        on_plan: Callable[[float], None] = lambda t_s: None,
        *,
        microstep_m: float = codec.MICROSTEP_M,
        travel_m: float = 0.0254,
        firmware: str = FIRMWARE,
        homed: bool = False,
    ) -> None:
        super().__init__()
        self._microstep_m, self._firmware = microstep_m, firmware
        self._axis = axis
        self._usual_m_s2 = axis.acceleration_m_s2
        self._storage: dict[str, str] = {}
        self._on_plan = on_plan
        self._lines = LineBuffer(codec.MAX_LINE)
        self._refuses_next = False
        self._stalls_next = False
        self._moving = False
        self._homing = False
        self._flags: set[str] = set() if homed else {"WR"}
        self._values = {
            "accel": round(axis.acceleration_m_s2 / codec.acceleration_m_s2(1, microstep_m)),
            "comm.address": ADDRESS,
            "comm.alert": 0,
            "comm.checksum": 0,
            "deviceid": DEVICE_ID,
            "limit.max": round(travel_m / microstep_m),
            "limit.min": 0,
            "maxspeed": codec.velocity_data(axis.max_speed_m_s, microstep_m),
            "resolution": 64,
            "system.axiscount": 1,
            "system.serial": SERIAL,
        }
        self._readings: dict[str, Callable[[float], float | str]] = {
            "pos": self._position,
            "vel": self._velocity,
            "driver.enabled": lambda t_s: int("FD" not in self._flags),
            "motion.accelonly": lambda t_s: self._values["accel"],
            "motion.decelonly": lambda t_s: self._values["accel"],
            "parking.state": lambda t_s: int(self._parked),
            "motion.busy": lambda t_s: int(self._moving),
            "limit.home.state": lambda t_s: int(self._position(t_s) <= 0),
            "system.uptime": int,
            "version": lambda t_s: firmware,
        }
        self._made = dict(self._values)
        self._parked = False
        rail = (0, self._values["limit.max"])
        self._writable = {
            "accel": (1, DATA),
            "comm.alert": (0, 1),
            "comm.checksum": (0, 1),
            "limit.max": rail,
            "limit.min": rail,
            "maxspeed": (1, self._values["maxspeed"]),
        }
        self._verbs: dict[str, Callable[[list[str], float], str]] = {
            "": lambda arguments, t_s: "0",
            "driver": self._driver,
            "home": self._home,
            "stop": self._stop,
            "estop": self._halt,
            "renumber": self._renumber,
            "storage": self._store,
            "system": self._system,
            "tools": self._tools,
            "move": self._move,
            "get": self._get,
            "set": self._set,
            "warnings": self._warnings,
        }

    def receive(self, data: bytes, t_s: float) -> bytes:
        """See `EmulatedDevice.receive`; alerts come by themselves."""
        self._run(t_s)
        return b"".join(self._answer(line, t_s) for line in self._lines.feed(data))

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """Faults: "refuse" (STATUSBUSY) the next movement; "stall" (FS) stops a movement dead, the next one where it
        stands still; "interrupt" (NI) ends a movement as a hand on the knob does; "disable" (FD) takes the motor's
        power."""
        return {
            "refuse": self._refuse_next,
            "stall": lambda: self._stall(t_s),
            "interrupt": lambda: self._stop([], t_s),
            "disable": lambda: self._break_down("FD", t_s),
        }

    def _refuse_next(self) -> None:
        self._refuses_next = True

    def _stall(self, t_s: float) -> None:
        if self._moving:
            self._break_down("FS", t_s)
        else:
            self._stalls_next = True

    def _answer(self, line: bytes, t_s: float) -> bytes:
        try:
            request = codec.decode_request(line)
        except CodecError:
            return b""
        if request.device not in (0, self._values["comm.address"]):
            return b""
        try:
            accepted, data = True, self._obey(request, t_s)
        except _RejectedError as rejection:
            accepted, data = False, str(rejection)
        flag = next((name for name in codec.FLAGS if name in self._flags), codec.NO_FLAG)
        address = self._values["comm.address"]
        reply = codec.StageReply(address, request.axis, request.id, accepted, self._moving, flag, data)
        checksum = self._values["comm.checksum"] == 1
        return codec.encode_message(reply, checksum=checksum)

    def _obey(self, request: codec.StageRequest, t_s: float) -> str:
        if request.axis not in (0, 1):
            raise _RejectedError("BADAXIS")
        verb, *arguments = request.text.split() or [""]
        if verb not in self._verbs:
            raise _RejectedError("BADCOMMAND")
        of_the_device = verb in ("renumber", "storage", "system") or (
            verb in ("get", "set") and " ".join(arguments).startswith(OF_THE_DEVICE)
        )
        if request.axis and of_the_device:
            raise _RejectedError("DEVICEONLY")
        return self._verbs[verb](arguments, t_s)

    def _store(self, arguments: list[str], t_s: float) -> str:
        """Texts under keys, kept for good: `set`, `get`, `erase`."""
        if tuple(map(int, self._firmware.split("."))) < STORAGE:
            raise _RejectedError("BADCOMMAND")
        match arguments:
            case ["set", key, *words] if words:
                self._storage[key] = " ".join(words)
                return "0"
            case ["get" | "erase" as verb, key]:
                if key not in self._storage:
                    raise _RejectedError("BADDATA")
                text = self._storage[key]
                if verb == "erase":
                    del self._storage[key]
                return text if verb == "get" else "0"
        raise _RejectedError("BADCOMMAND")

    def _renumber(self, arguments: list[str], t_s: float) -> str:
        if len(arguments) != 1:
            raise _RejectedError("BADCOMMAND")
        address = _integer(arguments[0])
        if not 1 <= address <= 99:
            raise _RejectedError("BADDATA")
        self._values["comm.address"] = address
        return "0"

    def _system(self, arguments: list[str], t_s: float) -> str:
        """Begin as after power-up; `restore` puts the maker's settings back and empties the storage besides."""
        if arguments not in (["reset"], ["restore"]):
            raise _RejectedError("BADCOMMAND")
        if arguments == ["restore"]:
            self._values = {**self._made, "comm.address": self._values["comm.address"]}
            self._usual_m_s2 = codec.acceleration_m_s2(self._values["accel"], self._microstep_m)
            self._storage.clear()
        if self._moving:
            self._axis.stall(t_s)
            self._on_plan(t_s)
        self._moving = self._homing = False
        self._flags = set() if self._parked else {"WR"}
        return "0"

    def _tools(self, arguments: list[str], t_s: float) -> str:
        if arguments in (["parking", "park"], ["parking", "unpark"]):
            if self._moving:
                raise _RejectedError("STATUSBUSY")
            self._parked = arguments[1] == "park"
            return "0"
        if arguments[:1] != ["echo"]:
            raise _RejectedError("BADCOMMAND")
        return " ".join(arguments[1:]) or "0"

    def _halt(self, arguments: list[str], t_s: float) -> str:
        if self._moving:
            self._break_down("NI", t_s)
        return "0"

    def _driver(self, arguments: list[str], t_s: float) -> str:
        if arguments == ["enable"]:
            self._flags.discard("FD")
        elif arguments == ["disable"]:
            self._break_down("FD", t_s)
        else:
            raise _RejectedError("BADCOMMAND")
        return "0"

    def _home(self, arguments: list[str], t_s: float) -> str:
        self._begin(t_s, 0.0, STAGE_HOME_M_S)
        self._homing = True
        return "0"

    def _stop(self, arguments: list[str], t_s: float) -> str:
        if self._moving:
            self._flags.add("NI")
            self._homing = False
            self._axis.stop(t_s)
            self._on_plan(t_s)
        return "0"

    def _move(self, arguments: list[str], t_s: float) -> str:
        """A target (`abs`, `rel`) or a velocity (`vel`) or neither (`min`, `max`), then what it may go with."""
        kind, *numbers = arguments or [""]
        first = {"abs": 1, "rel": 1, "vel": 0, "min": 0, "max": 0}.get(kind)
        if first is None or not first + (kind == "vel") <= len(numbers) <= first + 2:
            raise _RejectedError("BADCOMMAND")
        values = [_integer(number) for number in numbers]
        lowest, highest = self._values["limit.min"], self._values["limit.max"]
        speed, *given = values[first:] or [self._values["maxspeed"]]
        if kind in ("abs", "rel"):
            target = values[0] + (self._position(t_s) if kind == "rel" else 0)
        else:
            target = lowest if kind == "min" or (kind == "vel" and speed < 0) else highest
        if not lowest <= target <= highest or (kind != "vel" and speed <= 0) or min(given, default=1) <= 0:
            raise _RejectedError("BADDATA")
        if kind != "vel" and "WR" in self._flags:  # that position is unknown
            raise _RejectedError("BADDATA")
        if speed == 0:
            return self._stop([], t_s)
        unit_m = self._microstep_m
        acceleration_m_s2 = codec.acceleration_m_s2(given[0], unit_m) if given else None
        speed_m_s = abs(codec.velocity_m_s(speed, unit_m))
        self._begin(t_s, target * unit_m, speed_m_s, acceleration_m_s2)
        return "0"

    def _begin(
        self, t_s: float, target_m: float, speed_m_s: float, acceleration_m_s2: float | None = None
    ) -> None:
        if "FD" in self._flags:
            raise _RejectedError("DRIVERDISABLED")
        if self._parked:
            raise _RejectedError("PARKED")
        if self._refuses_next:
            self._refuses_next = False
            raise _RejectedError("STATUSBUSY")
        self._flags -= {"FS", "NI"}
        if self._moving:
            self._flags.add("NI")
        self._homing = False
        self._moving = True
        self._axis.acceleration_m_s2 = acceleration_m_s2 or self._usual_m_s2
        self._axis.move_to(t_s, target_m, speed_m_s)
        self._on_plan(t_s)
        if self._stalls_next:
            self._stalls_next = False
            self._break_down("FS", t_s)

    def _break_down(self, flag: str, t_s: float) -> None:
        self._flags.add(flag)
        self._homing = False
        self._axis.stall(t_s)
        self._on_plan(t_s)

    def _get(self, arguments: list[str], t_s: float) -> str:
        name = " ".join(arguments)
        if name in self._readings:
            return str(self._readings[name](t_s))
        if name in self._values or name in CONSTANTS:
            return str(self._values.get(name, CONSTANTS.get(name)))
        raise _RejectedError("BADCOMMAND")

    def _set(self, arguments: list[str], t_s: float) -> str:
        if len(arguments) != 2 or arguments[0] not in self._writable:
            raise _RejectedError("BADCOMMAND")
        name, value = arguments[0], _integer(arguments[1])
        lowest, highest = self._writable[name]
        if not lowest <= value <= highest:
            raise _RejectedError("BADDATA")
        self._values[name] = value
        if name == "accel":
            self._usual_m_s2 = codec.acceleration_m_s2(value, self._microstep_m)
        return "0"

    def _warnings(self, arguments: list[str], t_s: float) -> str:
        active = [name for name in codec.FLAGS if name in self._flags]
        if arguments == ["clear"]:
            self._flags &= LASTING
        elif arguments:
            raise _RejectedError("BADCOMMAND")
        return " ".join([f"{len(active):02d}", *active])

    def _position(self, t_s: float) -> int:
        return round(self._axis.position(t_s) / self._microstep_m)

    def _velocity(self, t_s: float) -> int:
        return codec.velocity_data(self._axis.velocity(t_s), self._microstep_m)

    def _run(self, t_s: float) -> None:
        """Note that a movement has ended."""
        if not self._moving or self._axis.moving(t_s):
            return
        self._moving = False
        if self._homing:
            self._homing = False
            self._flags -= codec.UNHOMED
        if self._values["comm.alert"]:
            flag = next((name for name in codec.FLAGS if name in self._flags), codec.NO_FLAG)
            alert = codec.StageReply(self._values["comm.address"], 1, None, True, False, flag, "", lead="!")
            checksum = self._values["comm.checksum"] == 1
            self._outbox += codec.encode_message(alert, checksum=checksum)


class _RejectedError(Exception):
    """The reason of an RJ reply."""


def _integer(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise _RejectedError("BADDATA") from None
    if abs(value) > DATA:
        raise _RejectedError("BADDATA")
    return value


def emulated(settings: ZaberStageSettings, bench: Bench) -> EmulatedZaberStage:
    """The stage, with the bench's probe on it: of the pitch and the travel that its driver's settings state."""
    axis = StageAxis(acceleration_m_s2=STAGE_M_S2, max_speed_m_s=STAGE_M_S)
    bench.mount(axis)
    unit_m, travel_m = settings.microstep_m, settings.travel_m
    return EmulatedZaberStage(axis, bench.on_plan, microstep_m=unit_m, travel_m=travel_m)
