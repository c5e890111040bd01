"""RTDE, the controller's real-time data exchange: packages of bytes ⇄ values. No I/O.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) guide", protocol version 2. A package is a
big-endian u16 of its whole size, a u8 of its kind, and a body.
"""

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from simulator.physics.rigid import Array

PROTOCOL_VERSION = 2
"""The only supported version; version 1 has no recipe ids (guide)."""

NOT_FOUND = "NOT_FOUND"
IN_USE = "IN_USE"
"""What the setup replies hold in a type's place (guide)."""

RECIPES = 255
"""Recipes of inputs that one client may have: their id is a u8, and 0 is none (guide)."""

_HEADER = struct.Struct(">HB")

LARGEST_BODY = 0xFFFF - _HEADER.size
"""Bytes: a package's size is a u16 (guide)."""

_FREQUENCY = struct.Struct(">d")

_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
}

Value = int | float | Sequence[int] | Sequence[float] | Array


def size(types: Sequence[str]) -> int:
    """Bytes of these types together."""
    return sum(struct.calcsize(">" + _FORMATS[kind]) for kind in types)


def packer(kind: str) -> Callable[[Any], bytes]:
    """What makes the bytes of a value of this type."""
    pack = struct.Struct(">" + _FORMATS[kind]).pack
    if len(_FORMATS[kind]) == 1:
        return pack
    return lambda value: pack(*(value.tolist() if isinstance(value, np.ndarray) else value))


class PackageKind(IntEnum):
    """Kinds of package (guide)."""

    PROTOCOL = 86
    CONTROLLER = 118
    TEXT = 77
    DATA = 85
    OUTPUTS = 79
    INPUTS = 73
    START = 83
    PAUSE = 80


class PackageError(ValueError):
    """Bytes that are no RTDE package."""


class Recipe:
    """An agreed list of inputs, received as one data package.

    Args:
        number: The recipe's id, from 1 on.
    """

    def __init__(self, number: int, names: Sequence[str], types: Sequence[str]) -> None:
        self.number = number
        self.names = tuple(names)
        self._layouts = [struct.Struct(">" + _FORMATS[kind]) for kind in types]
        self._size = 1 + sum(layout.size for layout in self._layouts)

    def decode(self, body: bytes) -> dict[str, Value]:
        """The values of a data package's body, recipe id included.

        Raises:
            PackageError: of another length than the recipe's.
        """
        if len(body) != self._size:
            raise PackageError(f"recipe {self.number} has {self._size} bytes, not {len(body)}")
        values: dict[str, Value] = {}
        offset = 1
        for name, layout in zip(self.names, self._layouts, strict=True):
            fields = layout.unpack_from(body, offset)
            values[name] = fields[0] if len(fields) == 1 else fields
            offset += layout.size
        return values


def encode(kind: PackageKind, body: bytes = b"") -> bytes:
    """A package.

    Raises:
        PackageError: larger than a package can be.
    """
    if len(body) > LARGEST_BODY:
        raise PackageError(f"{len(body)} bytes do not fit a package")
    return _HEADER.pack(_HEADER.size + len(body), kind) + body


def take(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Take the complete packages off the front of `buffer`: kind and body of each.

    Raises:
        PackageError: a size that leaves no room for the header.
    """
    while len(buffer) >= _HEADER.size:
        size, kind = _HEADER.unpack_from(buffer)
        if size < _HEADER.size:
            raise PackageError(f"a package of {size} bytes")
        if len(buffer) < size:
            return
        body = bytes(buffer[_HEADER.size : size])
        del buffer[:size]
        yield kind, body


def names(body: bytes) -> list[str]:
    """The variables that a setup request lists; the client ends its list with a comma."""
    return [name for name in body.decode("ascii", "replace").split(",") if name]


def outputs_request(body: bytes) -> tuple[float, list[str]]:
    """The rate in hertz and the variables that a setup of outputs requests.

    Raises:
        PackageError: too short, or no rate.
    """
    if len(body) < _FREQUENCY.size:
        raise PackageError("a setup of outputs without a rate")
    (rate_hz,) = _FREQUENCY.unpack_from(body)
    if not math.isfinite(rate_hz):
        raise PackageError(f"a setup of outputs at {rate_hz} Hz")
    return rate_hz, names(body[_FREQUENCY.size :])


def setup_reply(kind: PackageKind, number: int, types: Sequence[str]) -> bytes:
    """The answer to a setup: the recipe's id and a type for each variable."""
    return encode(kind, bytes([number]) + ",".join(types).encode())


def version_reply(version: Sequence[int]) -> bytes:
    """The answer to a question for the controller's version: major, minor, bugfix, build."""
    return encode(PackageKind.CONTROLLER, struct.pack(">4I", *version))


def accepted(kind: PackageKind, yes: bool = True) -> bytes:
    """The answer to a protocol, start or pause request."""
    return encode(kind, bytes([yes]))
