"""An emulated linear stage: Zaber ASCII on the motion of a `StageAxis`; no port, no clock."""

from collections.abc import Callable, Mapping

from drivers.core.errors import CodecError
from drivers.core.links import LineBuffer
from drivers.zaber_stage import codec
from drivers.zaber_stage.mounting import ZaberStageSettings
from simulator.devices.faults import break_by
from simulator.physics.bench import Bench
from simulator.physics.stage_axis import STAGE_HOME_M_S, STAGE_M_S, STAGE_M_S2, StageAxis

STORAGE = (7, 30)
"""The first firmware with storage (Zaber Motion Library, `DeviceStorage`)."""

DATA = 2**31 - 1
"""Greatest number of a command (Zaber ASCII protocol: 32 bits, signed)."""

ADDRESS, DEVICE_ID, SERIAL = 1, 1, 40001
"""Number on the line, model number (no model's, so that `microstep_m` may be any), serial number (assumption)."""

FIRMWARE = "7.38"
"""Firmware that it reports: one in which `move abs` takes a velocity."""


class EmulatedZaberStage:
    """Answers as the stage does: bytes in, bytes out, and time from outside.

    Positions of the axis are metres of the rail, 0 at its home end. Bytes may arrive split anywhere. A line
    with a wrong checksum, for another device or of another protocol is dropped silently, as the
    device drops it. Replies carry a checksum once `comm.checksum` is set.

    Args:
        on_plan: Called with the time of each new plan of the axis.
        travel_m: Length of the rail.
        homed: True where it has been homed before the program starts.
    """

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
        self._microstep_m, self._firmware = microstep_m, firmware
        self._axis = axis
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
            "comm.checksum": 0,
            "deviceid": DEVICE_ID,
            "limit.max": round(travel_m / microstep_m),
            "limit.min": 0,
            "maxspeed": codec.velocity_data(axis.max_speed_m_s, microstep_m),
            "resolution": 64,
            "system.serial": SERIAL,
        }
        rail = (0, self._values["limit.max"])
        self._writable = {
            "comm.checksum": (0, 1),
            "limit.max": rail,
            "limit.min": rail,
            "maxspeed": (1, self._values["maxspeed"]),
        }
        self._verbs: dict[str, Callable[[list[str], float], str]] = {
            "": lambda arguments, t_s: "0",
            "home": self._home,
            "stop": self._stop,
            "storage": self._store,
            "move": self._move,
            "get": self._get,
            "set": self._set,
            "warnings": self._warnings,
        }

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take bytes from the host at `t_s`; what it answers at once."""
        self._settle(t_s)
        return b"".join(self._answer(line, t_s) for line in self._lines.feed(data))

    def step(self, t_s: float) -> bytes:
        """It sends nothing on its own."""
        self._settle(t_s)
        return b""

    def inject(self, kind: str, t_s: float) -> None:
        """Break something at `t_s`.

        Args:
            kind: "refuse" (STATUSBUSY) the next movement; "stall" (FS) stops a movement dead, the next one
                where it stands still; "interrupt" (NI) ends a movement as a hand on the knob does;
                "disable" (FD) takes the motor's power.

        Raises:
            ValueError: it cannot break in that way.
        """
        self._settle(t_s)
        ways: Mapping[str, Callable[[], object]] = {
            "refuse": self._refuse_next,
            "stall": lambda: self._stall(t_s),
            "interrupt": lambda: self._stop([], t_s),
            "disable": lambda: self._break_down("FD", t_s),
        }
        break_by(kind, ways, "a stage")

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
        if request.device not in (0, ADDRESS):
            return b""
        try:
            accepted, data = True, self._obey(request, t_s)
        except _RejectedError as rejection:
            accepted, data = False, str(rejection)
        flag = next((name for name in codec.FLAGS if name in self._flags), codec.NO_FLAG)
        reply = codec.StageReply(ADDRESS, request.axis, request.id, accepted, self._moving, flag, data)
        checksum = self._values["comm.checksum"] == 1
        return codec.encode_message(reply, checksum=checksum)

    def _obey(self, request: codec.StageRequest, t_s: float) -> str:
        if request.axis not in (0, 1):
            raise _RejectedError("BADAXIS")
        verb, *arguments = request.text.split() or [""]
        if verb not in self._verbs:
            raise _RejectedError("BADCOMMAND")
        if request.axis and codec.scope(request.text) == 0:
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
        """`abs`, a target, and how fast to go there at the most."""
        if not 2 <= len(arguments) <= 3 or arguments[0] != "abs":
            raise _RejectedError("BADCOMMAND")
        target, speed, *_ = (*map(_integer, arguments[1:]), self._values["maxspeed"])
        if not self._values["limit.min"] <= target <= self._values["limit.max"] or speed <= 0:
            raise _RejectedError("BADDATA")
        if "WR" in self._flags:  # that position is unknown
            raise _RejectedError("BADDATA")
        unit_m = self._microstep_m
        self._begin(t_s, target * unit_m, codec.velocity_m_s(speed, unit_m))
        return "0"

    def _begin(self, t_s: float, target_m: float, speed_m_s: float) -> None:
        if "FD" in self._flags:
            raise _RejectedError("DRIVERDISABLED")
        if self._refuses_next:
            self._refuses_next = False
            raise _RejectedError("STATUSBUSY")
        self._flags -= {"FS", "NI"}
        if self._moving:
            self._flags.add("NI")
        self._homing = False
        self._moving = True
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
        if name == "pos":
            return str(self._position(t_s))
        if name == "version":
            return self._firmware
        if name in self._values:
            return str(self._values[name])
        raise _RejectedError("BADCOMMAND")

    def _set(self, arguments: list[str], t_s: float) -> str:
        if len(arguments) != 2 or arguments[0] not in self._writable:
            raise _RejectedError("BADCOMMAND")
        name, value = arguments[0], _integer(arguments[1])
        lowest, highest = self._writable[name]
        if not lowest <= value <= highest:
            raise _RejectedError("BADDATA")
        self._values[name] = value
        return "0"

    def _warnings(self, arguments: list[str], t_s: float) -> str:
        active = [name for name in codec.FLAGS if name in self._flags]
        if arguments == ["clear"]:
            self._flags &= codec.UNHOMED | {"FD"}
        elif arguments:
            raise _RejectedError("BADCOMMAND")
        return " ".join([f"{len(active):02d}", *active])

    def _position(self, t_s: float) -> int:
        return round(self._axis.position(t_s) / self._microstep_m)

    def _settle(self, t_s: float) -> None:
        """Note that a movement has ended."""
        if not self._moving or self._axis.moving(t_s):
            return
        self._moving = False
        if self._homing:
            self._homing = False
            self._flags -= codec.UNHOMED


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
