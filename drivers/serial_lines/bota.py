"""Frames of Bota Systems' serial force sensors, which they send by themselves at 460,800 baud. No I/O.

Status, six forces and torques, the sensor's time, its temperature, CRC-16/X-25: as in the maker's examples. The golden
frames of the tests are those that its own library, bota-driver 1.1.16, read as the numbers beside them.
"""

import binascii
import math
import struct
from collections.abc import Iterable

from drivers.core.errors import CodecError
from drivers.core.links import LineBuffer

HEAD = b"\xaa"

BODY = struct.Struct("<H6fIf")
"""Status, N and N m of x, y and z, us, degrees Celsius."""

FRAME_BYTES = len(HEAD) + BODY.size + 2

TIME_COLUMN = 6
"""Of the numbers that a frame is decoded to: 0-2 force, 3-5 torque, 6 time, 7 temperature, 8 status."""

NUMBERS = 9

NO_VALUE = 0b1110
"""Bits of the status: beyond the range, invalid, raw. Bit 0, a late program in the sensor, leaves the values sound."""

MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Each byte with its bits in the opposite order."""


def crc(body: bytes) -> bytes:
    """CRC-16/X-25 (ISO/IEC 13239), least byte first: that of `crc_hqx` with all bits in the opposite order."""
    mirrored = binascii.crc_hqx(body.translate(MIRRORED), 0xFFFF) ^ 0xFFFF
    return mirrored.to_bytes(2, "big").translate(MIRRORED)


class BotaBuffer(LineBuffer):
    """Finds frames in a stream of bytes, split anywhere; `dropped` is how often bytes came that are no frame."""

    def __init__(self) -> None:
        super().__init__(FRAME_BYTES)
        self._apart = False

    def feed(self, data: bytes) -> list[bytes]:
        """The bodies of the frames completed by these bytes."""
        rest, bodies = self._rest + data, []
        while len(rest) >= FRAME_BYTES:
            body = rest[len(HEAD) : FRAME_BYTES - 2]
            sound = rest.startswith(HEAD) and crc(body) == rest[FRAME_BYTES - 2 : FRAME_BYTES]
            self.dropped += not sound and not self._apart
            self._apart = not sound
            if sound:
                bodies.append(body)
                rest = rest[FRAME_BYTES:]
            else:
                ahead = rest.find(HEAD, 1)
                rest = rest[ahead:] if ahead > 0 else b""
        self._rest = rest
        return bodies


class BotaFormat:
    """A frame as a line of numbers; see `LineFormat`."""

    model = "Bota Systems, serial"
    ending = "sound frame"

    def buffer(self) -> BotaBuffer:
        """What cuts bytes into bodies."""
        return BotaBuffer()

    def decode(self, body: bytes) -> list[float]:
        """The numbers of a body; forces and torques are NaN where the sensor says that they are none.

        Raises:
            CodecError: it has another length.
        """
        if len(body) != BODY.size:
            raise CodecError(f"{len(body)} bytes are no frame")
        status, *numbers = BODY.unpack(body)
        if status & NO_VALUE:
            numbers[:TIME_COLUMN] = [math.nan] * TIME_COLUMN
        return [*map(float, numbers), float(status)]

    def encode(self, fields: Iterable[str]) -> bytes:
        """A frame of these numbers; those that are left out are zero."""
        numbers = [*map(float, fields), *[0.0] * NUMBERS][:NUMBERS]
        numbers[TIME_COLUMN], status = int(numbers[TIME_COLUMN]), int(numbers[-1])
        body = BODY.pack(status, *numbers[:-1])
        return HEAD + body + crc(body)

    def shown(self, body: bytes) -> str:
        """A body, for a person."""
        return ",".join(f"{number:g}" for number in self.decode(body))
