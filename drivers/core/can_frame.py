"""What travels on a CAN bus, as every codec here sees it."""

from dataclasses import dataclass

MAX_DATA_BYTES = 8
"""Bytes in a classic CAN frame (ISO 11898-1)."""

MAX_ID = 0x7FF
"""Standard identifiers have 11 bits (ISO 11898-1)."""


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A frame with a standard identifier.

    Attributes:
        id: 11 bits.
        data: 0 to 8 bytes; none in a remote frame.
        remote: True where it asks for the frame of this identifier.
    """

    id: int
    data: bytes = b""
    remote: bool = False
