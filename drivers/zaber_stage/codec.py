"""Zaber ASCII: lines of bytes ⇄ messages, and microsteps ⇄ metres. No I/O.

Source: the Zaber ASCII protocol, as the vendor's own library implements it.
A command is `/device axis [id] text[:LRC]`; a reply is
`@dd a [id] OK|RJ BUSY|IDLE WW data[:LRC]`; an alert `!dd a BUSY|IDLE WW [data]` and an info line
`#dd a [id] text` are unsolicited.
"""

import re
from dataclasses import dataclass

from drivers.core.errors import CodecError

AXIS = 1
"""The stage has one axis (Zaber ASCII protocol: axes count from 1)."""

OF_THE_DEVICE = re.compile(r"storage |[gs]et (comm\.|deviceid|system\.|version)")
"""Lines about the whole device: rejected with DEVICEONLY where they name an axis (Zaber ASCII protocol; Zaber Motion
Library sends them to axis 0)."""

IDS = 100
"""Message ids are 0 to 99 (Zaber ASCII protocol)."""

MAX_LINE = 160
"""Longest line that is kept, in bytes: far more than any line that was seen (assumption)."""

MICROSTEP_M = 0.49609375e-6
"""Metres per microstep of the bench's stage: 5,120 microsteps/s are 2.54 mm/s, as found on the bench."""

VELOCITY_SCALE = 1.6384
"""Velocity data is microsteps per second times this (Zaber ASCII protocol)."""

ACCELERATION_SCALE = 1.6384e-4
"""Acceleration data is microsteps per second squared times this (Zaber ASCII protocol)."""

FIRMWARE = (7, 25)
"""The first firmware in which `move abs` takes a speed (Zaber Motion Library, `move_absolute`)."""

LONGEST_S = 0.05
"""Longest time between two positions while all is well, s. Assumption: five at 100 Hz."""

NO_FLAG = "--"

FLAGS = {
    "FD": "its driver is disabled",
    "FE": "it hit a limit",
    "FS": "it stalled",
    "WL": "it met a limit switch that it did not expect",
    "WV": "its supply voltage is out of range",
    "WT": "it is too hot",
    "WS": "it stalled and went on",
    "WH": "it is not homed",
    "WR": "it has no reference position",
    "WM": "it was displaced while it stood still",
    "NC": "it is under manual control",
    "NI": "its movement was interrupted",
}
"""Warning flags and what they mean, most severe first (Zaber ASCII protocol)."""

UNHOMED = frozenset({"WH", "WR"})
"""Flags of a device that does not know where it is."""

NOT_HOME = UNHOMED | {"NC", "NI"}
"""Flags with which a way home that was begun without them did not end at home: a knob or another master took over."""

REJECTIONS = {
    "BADCOMMAND": "it does not know this command",
    "BADDATA": "a number is out of range",
    "DRIVERDISABLED": "its motor driver is off, see its lamps, then switch it off and on",
    "PARKED": "it was parked, release it: tools parking unpark",
    "STATUSBUSY": "it is moving",
}
"""Reasons of a rejection, and what they mean (Zaber ASCII protocol)."""

_TAIL = re.compile(rb":([0-9A-Fa-f]{2})$")


@dataclass(frozen=True, slots=True)
class StageRequest:
    """A command from the host; device or axis 0 means all."""

    device: int
    axis: int
    id: int | None
    text: str


@dataclass(frozen=True, slots=True)
class StageReply:
    """A line to the host.

    Attributes:
        lead: "@" answers a command; what comes unasked is "!", the end of a movement, or "#", for people, whose text
            is `data`.
    """

    device: int
    axis: int
    id: int | None
    accepted: bool
    busy: bool
    flag: str
    data: str
    lead: str = "@"


def lrc(body: bytes) -> int:
    """Checksum of what stands between the lead character and the colon: two's complement of the byte sum."""
    return -sum(body) & 0xFF


def scope(text: str) -> int:
    """The axis to which a command is sent; 0 where it is about the whole device."""
    return 0 if OF_THE_DEVICE.match(text) else AXIS


def encode_request(request: StageRequest, *, checksum: bool = True) -> bytes:
    """A command as the bytes on the wire."""
    head = f"{request.device} {request.axis}" + ("" if request.id is None else f" {request.id:02d}")
    return _frame("/", f"{head} {request.text}".rstrip(), checksum, "\n")


def decode_request(line: bytes) -> StageRequest:
    """Decode a line to a device.

    Raises:
        CodecError: the line is no command, or its checksum is wrong.
    """
    fields = _body(line, "/", checksum=False).split()
    numbers: list[int] = []
    while fields and len(numbers) < 3 and fields[0].isdecimal():
        numbers.append(int(fields.pop(0)))
    device, axis, *rest = [*numbers, 0, 0][: max(2, len(numbers))]
    return StageRequest(device, axis, rest[0] if rest else None, " ".join(fields))


def encode_message(message: StageReply, *, checksum: bool = True) -> bytes:
    """A line to the host as the bytes on the wire."""
    words = [f"{message.device:02d} {message.axis}"]
    if message.id is not None:
        words.append(f"{message.id:02d}")
    if message.lead == "@":
        words.append("OK" if message.accepted else "RJ")
    if message.lead != "#":
        words += ["BUSY" if message.busy else "IDLE", message.flag]
    return _frame(message.lead, " ".join([*words, message.data]).rstrip(), checksum, "\r\n")


def decode_message(line: bytes, *, checksum: bool = True) -> StageReply:
    """Decode a line to the host.

    Args:
        line: Without its end.
        checksum: True where a line without a checksum is an error.

    Raises:
        CodecError: the line is no message of this protocol, or its checksum is wrong, or missing where it is asked for.
    """
    lead = line[:1].decode("latin-1")
    fields = _body(line, lead if lead in ("@", "!", "#") else "@", checksum=checksum).split(" ")
    try:
        device, axis = int(fields[0]), int(fields[1])
        rest = fields[2:]
        number = None
        if lead != "!" and rest and rest[0].isdecimal():
            number = int(rest.pop(0))
        if lead == "#":
            return StageReply(device, axis, number, True, False, NO_FLAG, " ".join(rest), lead)
        accepted = lead == "!" or _either(rest.pop(0), "OK", "RJ")
        busy = _either(rest.pop(0), "BUSY", "IDLE")
        return StageReply(device, axis, number, accepted, busy, rest[0], " ".join(rest[1:]), lead)
    except (ValueError, IndexError) as error:
        raise CodecError(f"no Zaber ASCII message: {line!r}") from error


def meaning(flag: str) -> str:
    """The meaning of a warning flag."""
    return FLAGS.get(flag, "it reports a fault")


def astray(flag: str) -> bool:
    """Whether a flag means that the device is not where its commands put it: all faults, and some warnings."""
    return flag.startswith("F") or flag in ("WL", "WS", "WM")


def velocity_data(velocity_m_s: float, microstep_m: float) -> int:
    """Velocity data nearest to a velocity."""
    return round(velocity_m_s / microstep_m * VELOCITY_SCALE)


def velocity_m_s(data: int, microstep_m: float) -> float:
    """Metres per second of velocity data."""
    return data / VELOCITY_SCALE * microstep_m


def acceleration_m_s2(data: int, microstep_m: float) -> float:
    """Metres per second squared of acceleration data."""
    return data / ACCELERATION_SCALE * microstep_m


def _frame(lead: str, body: str, checksum: bool, end: str) -> bytes:
    raw = body.encode("ascii")
    tail = f":{lrc(raw):02X}" if checksum else ""
    return lead.encode("ascii") + raw + tail.encode("ascii") + end.encode("ascii")


def _body(line: bytes, lead: str, *, checksum: bool) -> str:
    """The text between the lead character and the checksum, which is verified."""
    if not line.startswith(lead.encode()):
        raise CodecError(f"no Zaber ASCII line: {line!r}")
    body = line[1:]
    tail = _TAIL.search(body)
    if tail is not None:
        body = body[: tail.start()]
        if lrc(body) != int(tail[1], 16):
            raise CodecError(f"wrong checksum: {line!r}")
    elif checksum:
        raise CodecError(f"no checksum: {line!r}")
    try:
        return body.decode("ascii")
    except UnicodeDecodeError as error:
        raise CodecError(f"not ASCII: {line!r}") from error


def _either(field: str, yes: str, no: str) -> bool:
    if field not in (yes, no):
        raise ValueError(field)
    return field == yes
