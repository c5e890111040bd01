"""Packets of the DSACON32-M: `AA AA AA`, id, length, payload, CRC. No I/O.

Source: docs/reference/sensors.md, and the command set as the maker's public library implements it. Numbers are
little-endian; a packet without a payload has no CRC.
"""

import binascii
from dataclasses import dataclass, field
from typing import Final, NamedTuple

PREAMBLE: Final = b"\xaa\xaa\xaa"

HEADER_BYTES: Final = 6
"""Preamble, id, length."""

CRC_BYTES: Final = 2

CRC_INIT: Final = 0xFFFF

MAX_PAYLOAD_BYTES: Final = 2053
"""Longest payload that is read. Assumption: a frame of 1,024 texels."""

_TABLE: Final = [binascii.crc_hqx(bytes([byte]), 0) for byte in range(256)]
"""Of the polynomial 0x1021, most significant bit first."""


def checksum(data: bytes) -> bytes:
    """The controller's own CRC: a table made for one direction, used in the other. No stock routine matches."""
    crc = CRC_INIT
    for byte in data:
        crc = _TABLE[(crc ^ byte) & 0xFF] ^ crc >> 8
    return crc.to_bytes(CRC_BYTES, "little")


class MatrixPacket(NamedTuple):
    """One packet."""

    id: int
    payload: bytes = b""


def encode_packet(packet: MatrixPacket) -> bytes:
    """The bytes on the wire.

    Raises:
        ValueError: the payload is longer than any that is read.
    """
    if len(packet.payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"a payload of {len(packet.payload)} bytes is longer than {MAX_PAYLOAD_BYTES}")
    body = bytes([packet.id]) + len(packet.payload).to_bytes(2, "little") + packet.payload
    return PREAMBLE + body + (checksum(body) if packet.payload else b"")


@dataclass(slots=True)
class PacketDecoder:
    """Cuts a stream of bytes into packets, in whatever pieces they come.

    Bytes that are no packet are skipped one by one, so that a packet that begins within a broken one is found.
    Memory is bounded by `MAX_PAYLOAD_BYTES`.

    Attributes:
        bad_crc: Packets so far whose CRC was wrong.
        passed_over: Bytes so far that belong to no packet: noise at power-up, and what faults leave behind.
        noise: The latest of these bytes, for error messages.
    """

    good: int = 0
    bad_crc: int = 0
    passed_over: int = 0
    noise: bytes = b""
    _rest: bytearray = field(default_factory=bytearray)

    def feed(self, data: bytes) -> list[MatrixPacket]:
        """The packets that these bytes complete."""
        rest = self._rest
        rest += data
        packets = []
        while self._align():
            length = int.from_bytes(rest[4:6], "little")
            end = HEADER_BYTES + length + (CRC_BYTES if length else 0)
            if length > MAX_PAYLOAD_BYTES:
                self._pass_over(1)
            elif len(rest) < end:
                break
            elif length and checksum(bytes(rest[3 : end - CRC_BYTES])) != rest[end - CRC_BYTES : end]:
                self.bad_crc += 1
                self._pass_over(1)
            else:
                packets.append(MatrixPacket(rest[3], bytes(rest[HEADER_BYTES : HEADER_BYTES + length])))
                self.good += 1
                del rest[:end]
        return packets

    def flush(self) -> list[MatrixPacket]:
        """The line has fallen silent: what has begun will not be completed; packets that were hidden in it."""
        packets = []
        while self._rest:
            self._pass_over(1)
            packets += self.feed(b"")
        return packets

    def _align(self) -> bool:
        """Let the rest begin with a preamble and hold a header; False where that needs more bytes."""
        rest = self._rest
        start = rest.find(PREAMBLE)
        if start < 0:
            # The last two bytes may be the beginning of a preamble.
            kept = next((n for n in (2, 1) if rest.endswith(PREAMBLE[:n])), 0)
            self._pass_over(len(rest) - kept)
            return False
        # Of a longer row of AA the last three are the preamble: no packet has the id AA.
        while rest[start + 3 : start + 4] == PREAMBLE[:1]:
            start += 1
        self._pass_over(start)
        return len(rest) >= HEADER_BYTES

    def _pass_over(self, count: int) -> None:
        if count:
            self.passed_over += count
            self.noise = (self.noise + bytes(self._rest[:count]))[-32:]
            del self._rest[:count]
