"""What goes through the pipe between the program and the arm's process.

Downwards go `Start` and `drivers.core.messages` commands; upwards go `Opened`, `ArmRow`, `LinkError` and
`drivers.core.messages` statuses. All times in the pipe are the clock's monotonic seconds, which both processes share.
"""

import pickle
import select
import socket
from typing import NamedTuple

from drivers.arm.link import ArmLink
from drivers.arm.settings import ArmSettings
from drivers.core.clock import Clock

PACKET_BYTES = 1 << 16
"""Longest message: a hundred times the longest there is."""


class Start(NamedTuple):
    """The first message to the arm's process.

    Attributes:
        again: Whether it replaces a process that died.
        turns: File descriptor of an `eventfd` that counts the turns of the program's loop and does not block.
    """

    name: str
    settings: ArmSettings
    link: type[ArmLink]
    again: bool
    turns: int
    clock: Clock


class Pipe:
    """One end, which neither waits to send nor to receive: a message is a packet, and goes whole or not at all.

    Args:
        end: Of a pair of connected `SOCK_SEQPACKET` sockets.
    """

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end

    def send(self, message: object) -> bool:
        """Whether the message was taken: False where the pipe is full; raises `OSError` where the other end is gone."""
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
        # By a process of our own, over a pair of sockets that is private to them.
        message: object = pickle.loads(data)
        return message

    def wait(self, seconds: float) -> bool:
        """Whether there is something to receive, at most after so many seconds."""
        return bool(select.select([self._end], [], [], seconds)[0])

    def drain(self, seconds: float) -> None:
        """Wait until more can be sent, at most so many seconds."""
        select.select([], [self._end], [], seconds)

    def hang_up(self) -> None:
        """Send nothing more: the other end finds that out after all messages; `OSError` where it is gone."""
        self._end.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        """Close this end."""
        self._end.close()
