"""BarrettHand: CAN frames ⇄ queries and readings of the fingers' strain gauges. No I/O.

Source: docs/reference/sensors.md. An identifier is `sender << 5 | receiver`, with bit 0x400 where the receiver
is a group. A query is `[property]`, a reply, which goes to group 6, `[0x80 | property, 0, i16 or i32]`; numbers are
little-endian.
"""

import struct
from typing import Final

from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError

HOST: Final = 0
"""Node of the host (docs/reference/sensors.md: a finger's reply is to a group, so it need not be given)."""

FINGERS: Final = (11, 12, 13)
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

STRAIN: Final = 25
"""The property that a finger's gauge is read by (docs/reference/sensors.md)."""

STATUS: Final = 5
"""The property that says whether a finger's controller is awake (libbarrett: STAT)."""

READY: Final = 2
"""Its value of one that is; 0 after power-up, when it answers to this property alone (libbarrett)."""


def encode_query(receiver: int, *, group: bool = False, subject: int = STRAIN) -> CanFrame:
    """Asks a finger, or a group of nodes, for a property."""
    return CanFrame(HOST << 5 | receiver | GROUP_BIT * group, bytes([subject]))


def encode_wake(finger: int) -> CanFrame:
    """Wakes a finger's controller."""
    return CanFrame(HOST << 5 | finger, struct.pack("<BBi", REPLY_BIT | STATUS, 0, READY))


def decode_query(frame: CanFrame, subject: int = STRAIN) -> tuple[int, bool]:
    """Whom a frame asks for a property, and whether that is a group.

    Raises:
        CodecError: it asks nobody for that.
    """
    if frame.remote or frame.data != bytes([subject]):
        raise CodecError(f"no query: {frame}")
    return frame.id & 0x1F, bool(frame.id & GROUP_BIT)


def reading_id(finger: int) -> int:
    """Identifier of a finger's readings."""
    return GROUP_BIT | finger << 5 | REPLIES


def encode_reading(finger: int, value: int, subject: int = STRAIN) -> CanFrame:
    """A finger's reading as the frame on the wire."""
    return CanFrame(reading_id(finger), struct.pack("<BBh", REPLY_BIT | subject, 0, value))


def decode_reading(frame: CanFrame, subject: int = STRAIN) -> tuple[int, int]:
    """The finger and the property's value; of a gauge, counts.

    Raises:
        CodecError: no reading of that property.
    """
    data = frame.data
    to_replies = frame.id & (GROUP_BIT | 0x1F) == GROUP_BIT | REPLIES
    if frame.remote or not to_replies or len(data) not in (4, 6) or data[0] != REPLY_BIT | subject:
        raise CodecError(f"no reading: {frame}")
    return frame.id >> 5 & 0x1F, int.from_bytes(data[2:], "little", signed=True)
