"""A recorder on the network: bytes ⇄ values, no I/O. Layouts: docs/reference/sensors.md.

The host writes lines of JSON; the recorder writes frames, each a header of 16 bytes and a payload:

    bytes 0-3   magic "TBA1"
    byte  4     kind: 1 sound, 2 message
    byte  5     channels (message: 0)
    bytes 6-7   u16: sound: frames in it; message: bytes of JSON
    bytes 8-15  u64: counter of the converter's frames: of the first in it; message: when it was sent

All numbers are little-endian; sound is packed signed 24-bit counts, the channels of a frame side by side.
"""

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import CodecError

MAGIC: Final = b"TBA1"

HEADER: Final = struct.Struct("<4sBBHQ")

BYTES: Final = 3
"""Of a sample."""

MAX_LINE_BYTES: Final = 4096
"""Longest line that a recorder reads (assumption)."""


SOUND: Final = 1
MESSAGE: Final = 2
"""Kinds of frames."""


@dataclass(frozen=True, slots=True, eq=False)
class Sound:
    """Consecutive frames of the converter.

    Attributes:
        frame: Counter of the first.
        counts: 24-bit counts of all channels of the source, shape (n, channels).
        arrival_s: Monotonic time in seconds at which the host had them.
    """

    frame: int
    counts: NDArray[np.int32]
    arrival_s: float = math.nan


@dataclass(frozen=True, slots=True)
class SoundMessage:
    """A message of the recorder.

    Attributes:
        frame: The converter's counter when it was sent; for a drive, the first frame that it applies to.
    """

    frame: int
    content: Mapping[str, Any]


def unpack24(data: bytes | bytearray | memoryview | NDArray[np.uint8]) -> NDArray[np.int32]:
    """Packed little-endian signed 24-bit counts as int32, shape (n,).

    Raises:
        CodecError: they are no whole number of samples.
    """
    if len(data) % BYTES:
        raise CodecError(f"{len(data)} bytes are no whole number of 24-bit samples")
    packed = np.frombuffer(data, np.uint8).reshape(-1, BYTES)
    wide = np.zeros((len(packed), 4), np.uint8)
    wide[:, 1:] = packed
    # The three bytes are the upper ones of an int32; the arithmetic shift brings them down with their sign.
    return np.asarray(wide.view("<i4")[:, 0] >> 8, dtype=np.int32)


def pack24(counts: NDArray[np.int32]) -> bytes:
    """Counts of any shape as packed little-endian 24-bit samples, in C order.

    Raises:
        CodecError: a count does not fit 24 bits.
    """
    if counts.size and not (counts.min() >= -(1 << 23) and counts.max() < 1 << 23):
        raise CodecError(f"counts from {counts.min()} to {counts.max()} do not fit 24 bits")
    wide = np.ascontiguousarray(counts, "<i4").reshape(-1, 1).view(np.uint8)
    return wide[:, :BYTES].tobytes()


def encode(message: Sound | SoundMessage) -> bytes:
    """A frame of the recorder's.

    Raises:
        CodecError: it does not fit.
    """
    try:
        if isinstance(message, SoundMessage):
            payload = json.dumps(message.content, separators=(",", ":")).encode()
            return HEADER.pack(MAGIC, MESSAGE, 0, len(payload), message.frame) + payload
        n, channels = message.counts.shape
        return HEADER.pack(MAGIC, SOUND, channels, n, message.frame) + pack24(message.counts)
    except struct.error as error:
        raise CodecError(f"it does not fit a frame: {error}") from error


def encode_line(request: Mapping[str, Any]) -> bytes:
    """A request of the host as a line."""
    return json.dumps(request, separators=(",", ":")).encode() + b"\n"


def decode_line(line: bytes) -> Mapping[str, Any]:
    """The request in a line.

    Raises:
        CodecError: no JSON object.
    """
    try:
        request = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise CodecError(f"no JSON: {error}") from error
    if not isinstance(request, dict):
        raise CodecError("no JSON object")
    return request


class FrameDecoder:
    """Cuts what a recorder writes into its frames, however the bytes arrive."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, data: bytes) -> list[Sound | SoundMessage]:
        """The frames that end in these bytes, in order.

        Raises:
            CodecError: this is no recorder, or frames are out of step: nothing after it can be read.
        """
        self._waiting += data
        frames: list[Sound | SoundMessage] = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        return frames

    def _next(self) -> Sound | SoundMessage | None:
        waiting = self._waiting
        begin = bytes(waiting[: len(MAGIC)])
        if not MAGIC.startswith(begin):
            raise CodecError(f"a frame begins with {MAGIC!r}, not with {begin!r}")
        if len(waiting) < HEADER.size:
            return None
        _, kind, channels, n, frame = HEADER.unpack_from(waiting)
        if kind not in (SOUND, MESSAGE) or (kind == SOUND and not (channels and n)):
            raise CodecError(f"a frame of kind {kind} with {channels} channels and a length of {n}")
        end = HEADER.size + (n * channels * BYTES if kind == SOUND else n)
        if len(waiting) < end:
            return None
        payload = bytes(waiting[HEADER.size : end])
        del waiting[:end]
        if kind == SOUND:
            return Sound(frame, unpack24(payload).reshape(n, channels))
        return SoundMessage(frame, decode_line(payload))
