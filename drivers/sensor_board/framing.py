"""Frames on the sensor board's line: `COBS(body | crc16) 0x00`, whatever the body holds.

The CRC is CRC-16/IBM-3740 (polynomial 0x1021, init 0xFFFF, not reflected) over the body, little-endian.
Source: docs/reference/sensors.md.
"""

import binascii
from dataclasses import dataclass, field
from typing import Final

from cobs import cobs

MAX_ENCODED_BYTES: Final = 8192
"""Longest frame without its delimiter. Assumption: room for 1,000 samples of two channels."""


def frame(body: bytes) -> bytes:
    """The whole frame around a body, delimiter included.

    Raises:
        ValueError: it would be longer than any frame that is read.
    """
    encoded: bytes = cobs.encode(body + _crc(body))
    if len(encoded) > MAX_ENCODED_BYTES:
        raise ValueError(f"a frame of {len(encoded)} bytes is longer than {MAX_ENCODED_BYTES}")
    return encoded + b"\0"


def _crc(body: bytes) -> bytes:
    return binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")


@dataclass(slots=True)
class BoardFrameDecoder:
    """Cuts a stream of bytes into bodies, in whatever pieces they come.

    Bytes before the first delimiter are the rest of a frame that began before the port was opened, and are
    dropped. A frame that is never closed is given up at `MAX_ENCODED_BYTES`: memory is bounded.

    Loss shows in the samples' counter, not in these counts.

    Attributes:
        bad_crc: Frames so far whose CRC was wrong.
        bad_cobs: Frames so far that were no COBS.
        overlong: Frames so far that were given up.
    """

    good: int = 0
    bad_crc: int = 0
    bad_cobs: int = 0
    overlong: int = 0
    _partial: bytearray = field(default_factory=bytearray)
    _skipping: bool = True

    def feed(self, data: bytes) -> list[bytes]:
        """Bodies, without their CRC, of the frames that these bytes complete."""
        bodies = []
        *closing, rest = data.split(b"\0")
        for piece in closing:
            self._append(piece)
            if self._partial and (body := self._open(bytes(self._partial))) is not None:
                bodies.append(body)
            self._partial.clear()
            self._skipping = False
        self._append(rest)
        return bodies

    def _append(self, piece: bytes) -> None:
        if self._skipping:
            return
        if len(self._partial) + len(piece) > MAX_ENCODED_BYTES:
            self.overlong += 1
            self._skipping = True
            self._partial.clear()
        else:
            self._partial += piece

    def _open(self, encoded: bytes) -> bytes | None:
        try:
            decoded: bytes = cobs.decode(encoded)
        except cobs.DecodeError:
            self.bad_cobs += 1
            return None
        body = decoded[:-2]
        if _crc(body) != decoded[-2:]:
            self.bad_crc += 1
            return None
        self.good += 1
        return body
