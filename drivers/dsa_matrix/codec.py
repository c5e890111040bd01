"""Messages between controller and host: payloads ⇄ values. No I/O.

Source: docs/reference/sensors.md; the layout of the infos is that of the maker's public library.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

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


# --- host to controller ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class AskMatrices:
    """Asks for `ControllerInfo` or `SensorInfo`."""

    id: Id


@dataclass(frozen=True, slots=True)
class AskMatrix:
    """Asks for the `MatrixInfo` of a matrix, or for its `Threshold`."""

    id: Id
    matrix: int


@dataclass(frozen=True, slots=True)
class Acquire:
    """Send frames, so many a second, run-length encoded or not; or send none."""

    run: bool
    rle: bool
    frames_per_s: int


@dataclass(frozen=True, slots=True)
class SetThreshold:
    """Texels below this are sent as 0, in all matrices."""

    counts: int


Request = AskMatrices | AskMatrix | Acquire | SetThreshold


# --- controller to host ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ControllerInfo:
    """The controller's identity."""

    error: int
    serial: int
    hardware: int
    software: int
    status: int


@dataclass(frozen=True, slots=True)
class SensorInfo:
    """The sensor that is connected to it."""

    error: int
    matrices: int
    hardware: int
    serial: int


@dataclass(frozen=True, slots=True)
class MatrixInfo:
    """One matrix: its cells, their size in mm."""

    error: int
    texel_width_mm: float
    texel_height_mm: float
    cells_x: int
    cells_y: int
    uid: bytes


@dataclass(frozen=True, slots=True)
class Done:
    """The answer to `Acquire` and `SetThreshold`; error 0 is success."""

    id: Id
    error: int


@dataclass(frozen=True, slots=True)
class Threshold:
    """The threshold of a matrix."""

    error: int
    counts: int


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """All texels at one time.

    Attributes:
        time_ms: The controller's clock, u32.
        rle: Whether it came run-length encoded.
        texels: Shape (cells,): matrix after matrix, each row after row; 12 bits.
    """

    time_ms: int
    rle: bool
    texels: NDArray[np.uint16]


Answer = ControllerInfo | SensorInfo | MatrixInfo | Done | Threshold | Frame

_CONTROLLER: Final = struct.Struct("<HIBHBBBBIB")
"""18 bytes: the last field is u16 in the maker's library, and the controller sends one byte of it."""

_SENSOR: Final = struct.Struct("<HHHBIB")
_MATRIX: Final = struct.Struct("<HffHH6s2xB24xfB")
_CAN_BAUD: Final = 1_000_000


def encode_request(request: Request) -> MatrixPacket:
    """A request as a packet."""
    match request:
        case AskMatrices(id=number):
            return MatrixPacket(number)
        case AskMatrix(id=number, matrix=matrix):
            return MatrixPacket(number, bytes([matrix]))
        case Acquire():
            flags = RUN_BIT * request.run | RLE_BIT * request.rle
            return MatrixPacket(Id.ACQUIRE, struct.pack("<BH", flags, request.frames_per_s))
        case SetThreshold(counts=counts):
            return MatrixPacket(Id.SET_THRESHOLD, struct.pack("<BBH", ALL_MATRICES_BIT, 0, counts))


def decode_request(packet: MatrixPacket) -> Request:
    """Decode a packet to the controller.

    Raises:
        CodecError: no request of this protocol.
    """
    data = packet.payload
    if packet.id in (Id.CONTROLLER, Id.SENSOR) and not data:
        return AskMatrices(Id(packet.id))
    if packet.id in (Id.MATRIX, Id.THRESHOLD) and len(data) == 1:
        return AskMatrix(Id(packet.id), data[0])
    if packet.id == Id.ACQUIRE and len(data) == 3:
        flags, frames_per_s = struct.unpack("<BH", data)
        return Acquire(bool(flags & RUN_BIT), bool(flags & RLE_BIT), frames_per_s)
    if packet.id == Id.SET_THRESHOLD and len(data) == 4:
        return SetThreshold(*struct.unpack_from("<H", data, 2))
    raise CodecError(f"no request: {packet}")


def encode_answer(answer: Answer) -> MatrixPacket:
    """An answer as a packet."""
    match answer:
        case ControllerInfo():
            a = answer
            data = _CONTROLLER.pack(
                a.error, a.serial, a.hardware, a.software, a.status, 0, 0, 0, _CAN_BAUD, 0
            )
            return MatrixPacket(Id.CONTROLLER, data)
        case SensorInfo():
            data = _SENSOR.pack(answer.error, answer.matrices, 0, answer.hardware, answer.serial, 0)
            return MatrixPacket(Id.SENSOR, data)
        case MatrixInfo():
            size = (answer.texel_width_mm, answer.texel_height_mm, answer.cells_x, answer.cells_y)
            return MatrixPacket(Id.MATRIX, _MATRIX.pack(answer.error, *size, answer.uid, 1, TEXEL_MAX, 0))
        case Done(id=number, error=error):
            return MatrixPacket(number, struct.pack("<H", error))
        case Threshold():
            return MatrixPacket(Id.THRESHOLD, struct.pack("<HH", answer.error, answer.counts))
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
                return ControllerInfo(*_CONTROLLER.unpack(data)[:5])
            case Id.SENSOR:
                error, matrices, _, hardware, serial, _ = _SENSOR.unpack(data)
                return SensorInfo(error, matrices, hardware, serial)
            case Id.MATRIX:
                return MatrixInfo(*_MATRIX.unpack(data)[:6])
            case Id.ACQUIRE | Id.SET_THRESHOLD:
                return Done(Id(packet.id), *struct.unpack("<H", data))
            case Id.THRESHOLD:
                return Threshold(*struct.unpack("<HH", data))
    except struct.error as error_:
        raise CodecError(f"packet {packet.id:#04x} of {len(data)} bytes: {error_}") from error_
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
