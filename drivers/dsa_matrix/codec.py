"""Messages between controller and host: payloads ⇄ values. No I/O.

Source: docs/reference/sensors.md; the layout of the infos is that of the maker's public library.
"""

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import CodecError
from drivers.dsa_matrix.packets import MatrixPacket

TEXEL_MAX: Final = 0xFFF
"""Texels have 12 bits (docs/reference/sensors.md)."""

VOLT_PER_COUNT: Final = 1e-3
"""Texels are read in millivolts, roughly (the maker's public library; the paper's figures are in mV)."""

TIME_MODULUS: Final = 2**32
"""Frames carry a u32 of milliseconds (docs/reference/sensors.md)."""

POWER_UP_NOISE: Final = b"\x1b[5n"
"""Sent three times at power-up (docs/reference/sensors.md)."""

RUN_BIT: Final = 0x80
RLE_BIT: Final = 0x01
ALL_MATRICES_BIT: Final = 0x02

RUN_MAX: Final = 15
"""Longest run of a run-length unit: its four upper bits (docs/reference/sensors.md)."""

ERRORS: Final = (
    "success",
    "not available",
    "no sensor",
    "not initialized",
    "already running",
    "feature not supported",
    "inconsistent data",
    "timeout",
    "read error",
    "write error",
    "insufficient resources",
    "checksum error",
    "not enough parameters",
    "unknown command",
    "format error",
    "access denied",
)
"""The first error codes of the maker's public library."""


class Id(IntEnum):
    """Packet ids (docs/reference/sensors.md)."""

    FRAME = 0x00
    CONTROLLER = 0x01
    SENSOR = 0x02
    ACQUIRE = 0x03
    MATRIX = 0x0B
    SET_THRESHOLD = 0x13
    THRESHOLD = 0x14


REQUESTS: Final[Mapping[int, struct.Struct]] = {
    Id.CONTROLLER: struct.Struct(""),
    Id.SENSOR: struct.Struct(""),
    Id.ACQUIRE: struct.Struct("<BH"),
    Id.MATRIX: struct.Struct("<B"),
    Id.SET_THRESHOLD: struct.Struct("<BxH"),
    Id.THRESHOLD: struct.Struct("<B"),
}
"""Numbers of each request. `ACQUIRE`: flags, frames a second. `MATRIX`, `THRESHOLD`: number of the matrix.
`SET_THRESHOLD`: which matrices, counts below which texels are sent as 0."""


class ControllerInfo(NamedTuple):
    """The controller's identity."""

    error: int
    serial: int
    hardware: int
    software: int
    status: int
    can_baud: int = 1_000_000


class SensorInfo(NamedTuple):
    """The sensor that is connected to it."""

    error: int
    matrices: int
    hardware: int
    serial: int


class MatrixInfo(NamedTuple):
    """One matrix: its cells, their size in mm."""

    error: int
    texel_width_mm: float
    texel_height_mm: float
    cells_x: int
    cells_y: int
    uid: bytes
    hardware: int = 1
    full_scale: float = TEXEL_MAX


class Done(NamedTuple):
    """The answer to `ACQUIRE` and `SET_THRESHOLD`, and with a matrix's threshold to `THRESHOLD`; error 0 is success."""

    id: Id
    error: int
    counts: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """All texels at one time.

    Attributes:
        time_ms: The controller's clock, u32.
        texels: Shape (cells,): matrix after matrix, each row after row; 12 bits.
    """

    time_ms: int
    rle: bool
    texels: NDArray[np.uint16]


Answer = ControllerInfo | SensorInfo | MatrixInfo | Done | Frame

_CONTROLLER: Final = struct.Struct("<HIBHB3xIx")
"""18 bytes: the last field is u16 in the maker's library, and the controller sends one byte of it."""

_SENSOR: Final = struct.Struct("<HH2xBIx")
_MATRIX: Final = struct.Struct("<HffHH6s2xB24xfx")


def request(number: Id, *numbers: int) -> MatrixPacket:
    """A request with its numbers, as `REQUESTS` has them."""
    return MatrixPacket(number, REQUESTS[number].pack(*numbers))


def acquire(run: bool, rle: bool, frames_per_s: int) -> MatrixPacket:
    """Send frames, so many a second, run-length encoded or not; or send none."""
    return request(Id.ACQUIRE, RUN_BIT * run | RLE_BIT * rle, frames_per_s)


def decode_request(packet: MatrixPacket) -> tuple[int, ...]:
    """The numbers of a packet to the controller, as `REQUESTS` has them.

    Raises:
        CodecError: no request of this protocol.
    """
    layout = REQUESTS.get(packet.id)
    if layout is None or layout.size != len(packet.payload):
        raise CodecError(f"no request: {packet}")
    return layout.unpack(packet.payload)


def encode_answer(answer: Answer) -> MatrixPacket:
    """An answer as a packet."""
    match answer:
        case ControllerInfo():
            return MatrixPacket(Id.CONTROLLER, _CONTROLLER.pack(*answer))
        case SensorInfo():
            return MatrixPacket(Id.SENSOR, _SENSOR.pack(*answer))
        case MatrixInfo():
            return MatrixPacket(Id.MATRIX, _MATRIX.pack(*answer))
        case Done(number, error, None):
            return MatrixPacket(number, struct.pack("<H", error))
        case Done(number, error, counts):
            return MatrixPacket(number, struct.pack("<HH", error, counts))
        case Frame():
            texels = _runs(answer.texels) if answer.rle else answer.texels.astype("<u2").tobytes()
            return MatrixPacket(Id.FRAME, struct.pack("<IB", answer.time_ms, RLE_BIT * answer.rle) + texels)


def decode_answer(packet: MatrixPacket) -> Answer:
    """Decode a packet to the host.

    Raises:
        CodecError: no answer of this protocol.
    """
    data = packet.payload
    try:
        match packet.id:
            case Id.FRAME:
                return _frame(data)
            case Id.CONTROLLER:
                return ControllerInfo(*_CONTROLLER.unpack(data))
            case Id.SENSOR:
                return SensorInfo(*_SENSOR.unpack(data))
            case Id.MATRIX:
                return MatrixInfo(*_MATRIX.unpack(data))
            case Id.ACQUIRE | Id.SET_THRESHOLD:
                return Done(Id(packet.id), *struct.unpack("<H", data))
            case Id.THRESHOLD:
                return Done(Id.THRESHOLD, *struct.unpack("<HH", data))
    except struct.error as error:
        raise CodecError(f"packet {packet.id:#04x} of {len(data)} bytes: {error}") from error
    raise CodecError(f"packet {packet.id:#04x} is unknown")


def channel_names(shapes: Iterable[tuple[int, int]]) -> tuple[str, ...]:
    """Names of a frame's cells, `m<matrix>.r<row>.c<column>`, for matrices of (rows, columns)."""
    return tuple(
        f"m{number}.r{row}.c{column}"
        for number, (rows, columns) in enumerate(shapes)
        for row in range(rows)
        for column in range(columns)
    )


def meaning(error: int) -> str:
    """The meaning of an error code."""
    return ERRORS[error] if error < len(ERRORS) else f"error {error}"


def _frame(data: bytes) -> Frame:
    time_ms, flags = struct.unpack_from("<IB", data)
    body = data[5:]
    if len(body) % 2:
        raise CodecError(f"a frame with {len(body)} bytes of texels")
    units = np.frombuffer(body, dtype="<u2")
    rle = bool(flags & RLE_BIT)
    texels = np.repeat(units & TEXEL_MAX, units >> 12) if rle else units & TEXEL_MAX
    return Frame(time_ms, rle, texels.astype(np.uint16))


def _runs(texels: NDArray[np.uint16]) -> bytes:
    """Run-length units of texels."""
    ends = np.flatnonzero(np.diff(texels)) + 1
    units = bytearray()
    for run in np.split(texels & TEXEL_MAX, ends):
        left = len(run)
        while left:
            count = min(left, RUN_MAX)
            units += (count << 12 | int(run[0])).to_bytes(2, "little")
            left -= count
    return bytes(units)
