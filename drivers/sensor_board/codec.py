"""Messages of the sensor board: bytes ⇄ values, no I/O. Layouts: docs/reference/sensors.md.

The counter of a sample frame is that of its first sample: it counts samples of its stream modulo 65,536, not
frames. It stands beside the time of the first sample, and only so is the number of samples lost known in
a stream of irregular times or of changing block size.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.core.errors import CodecError
from drivers.sensor_board.framing import frame

MAX_STREAMS: Final = 32
"""Streams of a board: one bit each in the mask of `BoardCode.START`."""

COUNTER_MODULUS: Final = 1 << 16
"""The sample counter is a u16."""

TIME_MODULUS: Final = 1 << 32
"""Device time is a u32 of microseconds: it wraps every 71.6 minutes."""

_HEADER = struct.Struct("<BBHI")
_TIMED = np.dtype([("t_us", "<u4"), ("value", "<i4")])
_I32 = np.dtype("<i4")


class BoardKind(IntEnum):
    """First byte of a body."""

    SAMPLES = 0x01
    TIMES = 0x02
    HELLO = 0x03
    COMMAND = 0x80
    REPLY = 0x81


class BoardCode(IntEnum):
    """What a command asks for."""

    HELLO = 1
    START = 2
    STOP = 3
    EXCITE = 4
    TENDON = 5
    TARE = 6
    WATCHDOG = 7


class ReplyStatus(IntEnum):
    """The board's reply to a command."""

    OK = 0
    UNKNOWN = 1
    REFUSED = 2
    BUSY = 3


ARGUMENTS: Final[Mapping[int, struct.Struct]] = {
    BoardCode.HELLO: struct.Struct("<"),
    BoardCode.START: struct.Struct("<I"),
    BoardCode.STOP: struct.Struct("<"),
    BoardCode.EXCITE: struct.Struct("<B"),
    BoardCode.TENDON: struct.Struct("<i"),
    BoardCode.TARE: struct.Struct("<B"),
    BoardCode.WATCHDOG: struct.Struct("<H"),
}
"""Layout of each command's argument: stream mask, on, position in um, stream, time in ms."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardSamples:
    """Consecutive samples of a stream; an irregular one has one channel and brings the time of each.

    Attributes:
        stream: Its id in the hello.
        seq: Counter of the first sample, modulo 65,536.
        t_us: Device time of the first sample, modulo 2^32.
        values: Raw counts, shape (n * channels,), the channels of a sample side by side.
        times_us: Of an irregular stream: device time of each sample, modulo 2^32, shape (n,).
    """

    stream: int
    seq: int
    t_us: int
    values: NDArray[np.int32]
    times_us: NDArray[np.uint32] | None = None


class _Json(BaseModel):
    """What the board reports of itself; unknown keys of newer boards are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)


class HelloStream(_Json):
    """One stream that the board has.

    Attributes:
        id: Its number in frames, and its bit in the mask of `BoardCode.START`.
        name: Its name, as profiles write it behind the device's.
        channels: Names of the channels, or how many there are.
        rate_hz: Sample rate, or None where every sample brings its own time.
        unit: SI unit of `count * scale`.
        scale: Units per raw count.
        kind: The board's own name for its kind; not used.
    """

    id: int = Field(ge=0, lt=MAX_STREAMS)
    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    channels: Annotated[int, Field(ge=1)] | Annotated[tuple[str, ...], Field(min_length=1)] = 1
    rate_hz: float | None = Field(default=None, gt=0.0)
    unit: str
    scale: float
    kind: str = ""

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels; numbers where the board gives none, the stream's name for a single one."""
        if isinstance(self.channels, tuple):
            return self.channels
        return (self.name,) if self.channels == 1 else tuple(map(str, range(self.channels)))


class BoardHello(_Json):
    """The board's identity and streams."""

    board: str
    serial: str
    version: str
    streams: tuple[HelloStream, ...] = Field(max_length=MAX_STREAMS)

    @model_validator(mode="after")
    def _distinct(self) -> BoardHello:
        if any(stream.scale == 0.0 for stream in self.streams):
            raise ValueError("a stream has a scale of 0")
        for what in ("id", "name"):
            if len({getattr(stream, what) for stream in self.streams}) < len(self.streams):
                raise ValueError(f"two streams have one {what}")
        return self


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """A command to the board; `argument` is None where its code takes none or is not known here."""

    code: int
    tag: int
    argument: int | None = None


@dataclass(frozen=True, slots=True)
class BoardReply:
    """The board's answer to the command with this code and tag; `status` as in `ReplyStatus`."""

    code: int
    tag: int
    status: int


Message = BoardSamples | BoardHello | CommandFrame | BoardReply


def encode(message: Message) -> bytes:
    """A message as a whole frame, delimiter included.

    Raises:
        CodecError: a number does not fit its field, or there are no samples.
        ValueError: the frame would be longer than any that is read.
    """
    return frame(_body(message))


def decode(body: bytes) -> Message:
    """The message in a body whose CRC was right.

    Raises:
        CodecError: of no known kind, of a wrong length, or an unusable hello.
    """
    kind = body[0] if body else -1
    try:
        if kind in (BoardKind.SAMPLES, BoardKind.TIMES):
            return _decode_samples(body)
        if kind == BoardKind.HELLO:
            return BoardHello.model_validate_json(body[1:])
        if kind == BoardKind.COMMAND:
            return _decode_command(body)
        if kind == BoardKind.REPLY:
            _, code, tag, status = struct.unpack("<BBBB", body)
            return BoardReply(code, tag, status)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise CodecError(f"hello{f' ({where})' if where else ''}: {first['msg']}") from error
    except (struct.error, ValueError) as error:
        raise CodecError(f"kind 0x{kind:02x} with {len(body)} bytes: {error}") from error
    raise CodecError(f"no kind of message begins with {body[:1].hex() or 'nothing'}")


def _body(message: Message) -> bytes:
    if isinstance(message, BoardHello):
        return bytes([BoardKind.HELLO]) + message.model_dump_json().encode()
    try:
        if isinstance(message, BoardSamples):
            place = (message.stream, message.seq, message.t_us)
            if message.times_us is None:
                values = _some(message.values).astype(_I32, copy=False)
                return _HEADER.pack(BoardKind.SAMPLES, *place) + values.tobytes()
            rows = np.empty(len(_some(message.values)), _TIMED)
            rows["t_us"], rows["value"] = message.times_us, message.values
            return _HEADER.pack(BoardKind.TIMES, *place) + rows.tobytes()
        if isinstance(message, CommandFrame):
            argument = () if message.argument is None else (message.argument,)
            layout = ARGUMENTS[message.code]
            return struct.pack("<BBB", BoardKind.COMMAND, message.code, message.tag) + layout.pack(*argument)
        return struct.pack("<BBBB", BoardKind.REPLY, message.code, message.tag, message.status)
    except (struct.error, KeyError) as error:
        raise CodecError(f"{message} does not fit into a frame: {error}") from error


def _some(values: NDArray[np.int32]) -> NDArray[np.int32]:
    if not len(values):
        raise CodecError("a frame without samples")
    return values


def _decode_samples(body: bytes) -> BoardSamples:
    kind, stream, seq, t_us = _HEADER.unpack_from(body)
    if kind == BoardKind.SAMPLES:
        values = np.frombuffer(body, _I32, offset=_HEADER.size)
        return BoardSamples(stream, seq, t_us, _some(values.astype(np.int32)))
    rows = np.frombuffer(body, _TIMED, offset=_HEADER.size)
    values, times_us = rows["value"].astype(np.int32), rows["t_us"].astype(np.uint32)
    return BoardSamples(stream, seq, t_us, _some(values), times_us)


def _decode_command(body: bytes) -> CommandFrame:
    _, code, tag = struct.unpack_from("<BBB", body)
    if code not in ARGUMENTS:
        return CommandFrame(code, tag)
    argument = ARGUMENTS[code].unpack(body[3:])
    return CommandFrame(code, tag, *argument)
