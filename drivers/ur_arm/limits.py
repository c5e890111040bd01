"""A UR controller's limits of its joints, from the configuration data of its primary interface."""

import socket
import struct
import time
from collections.abc import Iterator, Mapping

PORT = 30001
"""Of the primary interface (client interface manual); it sends its state ten times a second."""

PATIENCE_S = 3.0
"""How long its state may take (assumption: a busy machine's)."""

ROBOT_STATE, CONFIGURATION = 16, 6
"""Type of a package, and of a part of it (client interface manual)."""

_HEAD = struct.Struct(">IB")
"""Bytes, these included, and type: of a package and of each of its parts."""

_LIMITS = struct.Struct(">12d12d")
"""For each joint the least and greatest angle in rad; then for each its fastest speed in rad/s and acceleration."""


def parts(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Type and content of each whole package, or part of one, that stands at the beginning of `data`."""
    while len(data) >= _HEAD.size:
        size, kind = _HEAD.unpack_from(data)
        if not _HEAD.size <= size <= len(data):
            return
        yield kind, data[_HEAD.size : size]
        data = data[size:]


def limits_in(data: bytes) -> Mapping[str, object] | None:
    """What the first configuration data say, joint by joint from the base on; None where there are none yet."""
    for kind, content in parts(data):
        for part, values in parts(content) if kind == ROBOT_STATE else ():
            if part == CONFIGURATION and len(values) >= _LIMITS.size:
                numbers = _LIMITS.unpack_from(values)
                return {
                    "joint_limits_rad": [list(numbers[at : at + 2]) for at in range(0, 12, 2)],
                    "joint_speed_limits_rad_s": list(numbers[12:24:2]),
                }
    return None


def joint_limits(host: str) -> Mapping[str, object]:
    """The limits of the controller at an address, for the manifest; why not where it does not send them."""
    data, until_s = b"", time.monotonic() + PATIENCE_S
    try:
        with socket.create_connection((host, PORT), PATIENCE_S) as connection:
            while (found := limits_in(data)) is None and time.monotonic() < until_s:
                data += (received := connection.recv(4096))
                if not received:
                    break
    except OSError as error:
        return {"joint_limits_rad": f"not read at port {PORT}: {error.strerror or error}"}
    return found or {"joint_limits_rad": f"not read at port {PORT}: it does not send them"}
