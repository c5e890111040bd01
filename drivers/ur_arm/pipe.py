"""What goes through the pipe between the program and the arm's process.

Downwards go `Start` and `drivers.messages` commands; upwards go `Opened`, `ArmRow`, `Broken` and `drivers.messages`
statuses. All times in the pipe are the clock's monotonic seconds, which both processes share.
"""

from __future__ import annotations

import pickle
import select
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from drivers.ur_arm.settings import Pose

PACKET_BYTES = 1 << 16
"""Longest message: a hundred times the longest there is."""

Kind = Literal["port", "silent", "refused", "protocol"]


class Start(NamedTuple):
    """The first message to the arm's process.

    Attributes:
        name: Of the device.
        settings: Of the arm, as JSON.
        again: Whether it replaces a process that died.
        turns: File descriptor of an `eventfd` that counts the turns of the program's loop.
        clock: `Clock.path` of the program's.
    """

    name: str
    settings: str
    again: bool
    turns: int
    clock: str


class ArmRow(NamedTuple):
    """One cycle of the controller.

    Attributes:
        arrival_s: When it was read.
        device_s: The controller's time.
        pose: Of the tool: m and rotation vector.
        twist: Of the tool: m/s and rad/s.
        force: On the tool, base frame: N and N m.
        safety_bits: `safety_status_bits`.
        runtime: `runtime_state`.
    """

    arrival_s: float
    device_s: float
    pose: Pose
    twist: Pose
    force: Pose
    safety_bits: int
    runtime: int


@dataclass(frozen=True, slots=True)
class Opened:
    """The arm is connected, its program runs and its watchdog is set.

    Attributes:
        model: As the dashboard reports it.
        serial: Likewise.
        version: Of PolyScope.
        pose: Where the tool is.
        details: For the manifest.
    """

    model: str
    serial: str
    version: str
    pose: Pose
    details: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Broken:
    """The arm's process can do no more, and ends.

    Attributes:
        kind: Which error it is, should it come while opening.
        reason: What happened.
        advice: What to do about it.
    """

    kind: Kind
    reason: str
    advice: str


class BrokenError(Exception):
    """Carries a `Broken` out of the depth of the arm's process."""

    def __init__(self, kind: Kind, reason: str, advice: str) -> None:
        self.broken = Broken(kind, reason, advice)
        super().__init__(reason)


class Pipe:
    """One end, which neither waits to send nor to receive: a message is a packet, and goes whole or not at all.

    Args:
        end: Of a pair of connected `SOCK_SEQPACKET` sockets.
    """

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end

    def send(self, message: object) -> bool:
        """Whether the message was taken: False where the pipe is full.

        Raises:
            OSError: the other end is gone.
        """
        try:
            self._end.send(pickle.dumps(message))
        except BlockingIOError:
            return False
        return True

    def receive(self) -> object | None:
        """The next message, None where there is none yet.

        Raises:
            EOFError: the other end is gone, and all its messages have been received.
        """
        try:
            data = self._end.recv(PACKET_BYTES)
        except BlockingIOError:
            return None
        except ConnectionError:
            data = b""
        if not data:
            raise EOFError
        message: object = pickle.loads(
            data
        )  # by a process of our own, over a pair of sockets that is private to them
        return message

    def wait(self, seconds: float) -> bool:
        """Whether there is something to receive, at most after so many seconds."""
        return bool(select.select([self._end], [], [], seconds)[0])

    def drain(self, seconds: float) -> None:
        """Wait until more can be sent, at most so many seconds."""
        select.select([], [self._end], [], seconds)

    def close(self) -> None:
        """Close this end."""
        self._end.close()
