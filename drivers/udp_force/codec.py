"""The RDT protocol of a Net F/T box: requests of 8 bytes, records of 36, big-endian. No I/O."""

import re
import struct
from collections.abc import Iterator, Mapping
from typing import Final, Literal, NamedTuple

from drivers.core.errors import CodecError

PORT: Final = 49152
"""UDP port of the box."""

RECORD_BYTES: Final = 36
MODULUS: Final = 1 << 32
"""At which both sequence numbers are zero again."""

_HEADER = 0x1234
_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">3I6i")

COMMANDS: Final = {"stop": 0x0000, "start": 0x0002, "bias": 0x0042}
"""Of a request; `start` is real-time streaming, of a number of records, 0 for ever."""

ZERO_HERE: Final = 0xFF
"""What `bias` takes for its number: an OnRobot's box takes its zero away with 0, a Net F/T ignores it."""


class StatusWord(NamedTuple):
    """What the bits of a make's status word mean.

    Attributes:
        saturated: Beyond what it measures.
        passed: No error by themselves.
        faults: By number, errors of the box.
    """

    saturated: int
    passed: int
    faults: Mapping[int, str]


STATUS: Final[Mapping[str, StatusWord]] = {
    "net_ft": StatusWord(
        1 << 17,
        1 << 16 | 1 << 31,  # a threshold of its own was passed; any bit is set
        {
            30: "CPU or memory",
            29: "digital board",
            28: "analog board",
            27: "serial link",
            26: "program memory",
            25: "halted by its configuration",
            24: "settings",
            23: "configuration that does not fit the calibration",
            22: "network",
            21: "CAN",
            20: "RDT",
            19: "EtherNet/IP",
            18: "DeviceNet",
        },
    ),
    "axia": StatusWord(
        1 << 30 | 1 << 27,  # force or torque, a gage
        1 << 3 | 1 << 31,  # busy; any bit is set
        {
            29: "checksum of the calibration",
            28: "simulated error",
            2: "broken gage",
            1: "supply voltage",
            0: "temperature",
        },
    ),
}
"""Of ATI's Net F/T, whose lower half tells more of its errors, and Axia (manuals)."""

NEWTONS: Final = {
    **{"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605},
    **{"kg": 9.80665, "kgf": 9.80665, "g": 9.80665e-3, "gf": 9.80665e-3},
}
NEWTON_METRES: Final = {
    **{"Nm": 1.0, "N-m": 1.0, "kNm": 1e3, "kN-m": 1e3, "Nmm": 1e-3, "N-mm": 1e-3},
    **{"lbf-in": 0.1129848290276167, "lbf-ft": 1.3558179483314004, "kg-cm": 0.0980665, "kgf-cm": 0.0980665},
}
"""The box's names of units, in N and N m."""


class ForceRecord(NamedTuple):
    """A record.

    Attributes:
        rdt: Number of the record in its stream.
        ft: Number of the sample by the sensor's own clock.
        counts: Fx, Fy, Fz, Tx, Ty, Tz.
    """

    rdt: int
    ft: int
    status: int
    counts: tuple[int, ...]


def encode_request(command: Literal["stop", "start", "bias"], records: int = 0) -> bytes:
    """A request; `records` is the number in it, of whatever it is."""
    return _REQUEST.pack(_HEADER, COMMANDS[command], records)


def decode_request(data: bytes) -> tuple[str, int]:
    """Command and number.

    Raises:
        CodecError: it is no request.
    """
    names = {code: name for name, code in COMMANDS.items()}
    if len(data) != _REQUEST.size or (found := _REQUEST.unpack(data))[0] != _HEADER or found[1] not in names:
        raise CodecError(f"{data[:16].hex()} is no request")
    return names[found[1]], found[2]


def encode_record(record: ForceRecord) -> bytes:
    """A record."""
    return _RECORD.pack(record.rdt, record.ft, record.status, *record.counts)


def decode_records(data: bytes) -> Iterator[ForceRecord]:
    """The records of a datagram.

    Raises:
        CodecError: it is not made of them.
    """
    if not data or len(data) % RECORD_BYTES:
        raise CodecError(f"{len(data)} bytes are no records of {RECORD_BYTES}")
    for rdt, ft, status, *counts in _RECORD.iter_unpack(data):
        yield ForceRecord(rdt, ft, status, tuple(counts))


def faults_of(status: int, make: str) -> str:
    """What a status word of a make says is wrong with the box; "" where nothing is."""
    word = STATUS[make]
    wrong = status & ~(word.saturated | word.passed)
    if not wrong:
        return ""
    named = [name for bit, name in word.faults.items() if wrong >> bit & 1]
    return f"status {status:08x}: {', '.join(named) or 'see the table of status bits in its manual'}"


class BoxSettings(NamedTuple):
    """What the box's page of settings says: counts for each N and N m, records and samples a second."""

    counts_per_n: float
    counts_per_nm: float
    rate_hz: float
    sample_hz: float


def decode_settings(page: str) -> BoxSettings:
    """Read `netftapi2.xml`.

    Raises:
        CodecError: something is missing in it, or in a unit that is not known.
    """

    def text(name: str) -> str:
        found = re.search(rf"<{name}>\s*([^<]*?)\s*</{name}>", page)
        if found is None:
            raise CodecError(f"its page of settings has no {name}")
        return found[1]

    def number(name: str) -> float:
        given = text(name)
        if not re.fullmatch(r"\d+(\.\d*)?", given) or not 0.0 < float(given) < 1e12:
            raise CodecError(f"its {name} is {given[:20]!r}")
        return float(given)

    try:
        newtons, newton_metres = NEWTONS[text("scfgfu")], NEWTON_METRES[text("scfgtu")]
    except KeyError as error:
        raise CodecError(f"its unit {error} is not known") from None
    counts, torque_counts = number("cfgcpf") / newtons, number("cfgcpt") / newton_metres
    return BoxSettings(counts, torque_counts, number("comrdtrate"), number("runrate"))
