"""BarrettHand: CAN frames ⇄ queries, settings and replies. No I/O.

Source: docs/reference/sensors.md. An identifier is `sender << 5 | receiver`, with bit 0x400 where the receiver
is a group. A query is `[property]`, a setting `[0x80 | property, 0, i32]`, a reply, which goes to group 6,
`[0x80 | property, 0, i16 or i32]`; numbers are little-endian.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, NamedTuple

from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError

HOST: Final = 0
"""Node of the host (docs/reference/sensors.md: a finger's reply is to a group, so it need not be given)."""

FINGERS: Final = (11, 12, 13)
SPREAD: Final = 14
"""Nodes of the hand (docs/reference/sensors.md)."""

HAND: Final = 5
REPLIES: Final = 6
"""Groups: the whole hand, and the receivers of replies (docs/reference/sensors.md)."""

GROUP_BIT: Final = 0x400
REPLY_BIT: Final = 0x80

COUNTS_MAX: Final = 4095
"""Strain gauges are read with 12 bits (docs/reference/sensors.md)."""

UNLOADED_COUNTS: Final = 2000
"""About what an unloaded finger reads (docs/reference/sensors.md)."""

NEWTON_PER_COUNT: Final = 2.0 * 9.80665 / 2048.0
"""Force at the fingertip for each count: "roughly +-2 kg" over the range (docs/reference/sensors.md)."""

SAFE_COUNTS: Final = (667, 3460)
"""Outside these the hand protects itself (docs/reference/sensors.md)."""


class Property(IntEnum):
    """Properties of a node (docs/reference/sensors.md)."""

    MODE = 8
    STRAIN = 25
    COMMAND = 29
    TARGET = 42
    POSITION = 48


class HandRequest(NamedTuple):
    """Queries a property of a node or a group, or sets it to a value."""

    receiver: int
    property: int
    value: int | None = None
    group: bool = False


class HandReply(NamedTuple):
    """A node's property."""

    sender: int
    property: int
    value: int


def encode_request(request: HandRequest) -> CanFrame:
    """A query or a setting as the frame on the wire."""
    identifier = HOST << 5 | request.receiver | GROUP_BIT * request.group
    if request.value is None:
        return CanFrame(identifier, bytes([request.property]))
    return CanFrame(identifier, struct.pack("<BBi", REPLY_BIT | request.property, 0, request.value))


def decode_request(frame: CanFrame) -> HandRequest:
    """Decode a frame to a node.

    Raises:
        CodecError: neither a query nor a setting.
    """
    group, receiver, data = bool(frame.id & GROUP_BIT), frame.id & 0x1F, frame.data
    if not frame.remote and len(data) == 1 and not data[0] & REPLY_BIT:
        return HandRequest(receiver, data[0], group=group)
    if not frame.remote and len(data) == 6 and data[0] & REPLY_BIT:
        (value,) = struct.unpack_from("<i", data, 2)
        return HandRequest(receiver, data[0] & ~REPLY_BIT, value, group)
    raise CodecError(f"no request: {frame}")


def reply_id(sender: int) -> int:
    """Identifier of a node's replies."""
    return GROUP_BIT | sender << 5 | REPLIES


def encode_reply(reply: HandReply) -> CanFrame:
    """A reply as the frame on the wire: 16 bits where the value fits, else 32."""
    kind = "<BBh" if -(2**15) <= reply.value < 2**15 else "<BBi"
    return CanFrame(reply_id(reply.sender), struct.pack(kind, REPLY_BIT | reply.property, 0, reply.value))


def decode_reply(frame: CanFrame) -> HandReply:
    """Decode a frame to the host.

    Raises:
        CodecError: no reply.
    """
    data = frame.data
    to_replies = frame.id & (GROUP_BIT | 0x1F) == GROUP_BIT | REPLIES
    if frame.remote or not to_replies or len(data) not in (4, 6) or not data[0] & REPLY_BIT:
        raise CodecError(f"no reply: {frame}")
    value = int.from_bytes(data[2:], "little", signed=True)
    return HandReply(frame.id >> 5 & 0x1F, data[0] & ~REPLY_BIT, value)
