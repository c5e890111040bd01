"""Loopback clients of an emulated device: accepted, read, answered and dropped; nothing here waits."""

import socket
from collections.abc import Callable

READ_BYTES = 65536


class TcpClients:
    """Listening ports and their clients; one that breaks its connection, or never reads, is dropped alone.

    Args:
        most: Connections at a time; one more is closed at once.
        unread_bytes: What a client may leave unread beyond what the network takes; with more it is dropped.
        left: Called with a connection that is closed, and why: "" where the client left.

    Attributes:
        unsent: For each connection, what the network has not taken yet.
    """

    def __init__(self, most: int, unread_bytes: int, left: Callable[[socket.socket, str], object]) -> None:
        self.unsent: dict[socket.socket, bytearray] = {}
        self._listeners: list[socket.socket] = []
        self._most = most
        self._unread_bytes = unread_bytes
        self._left = left

    @property
    def sockets(self) -> list[socket.socket]:
        """What to select on."""
        return [*self._listeners, *self.unsent]

    def listen(self, host: str = "127.0.0.1", port: int = 0) -> socket.socket:
        """Listen on one more port; 0 is any.

        Raises:
            OSError: it is taken.
        """
        listener = socket.create_server((host, port))
        listener.setblocking(False)
        self._listeners.append(listener)
        return listener

    def accept(self, listener: socket.socket) -> socket.socket | None:
        """The client at a port that is ready; None where it has left already, or is one too many."""
        try:
            connection, _ = listener.accept()
        except OSError:
            return None
        if len(self.unsent) == self._most:
            connection.close()
            return None
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.unsent[connection] = bytearray()
        return connection

    def receive(self, connection: socket.socket) -> bytes:
        """What has come from a client that is ready; nothing where it has left, and is dropped."""
        try:
            data = connection.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self.drop(connection)
        return data

    def send(self, connection: socket.socket, data: bytes = b"") -> None:
        """Send what waits, then this, as far as the network takes it."""
        rest = self.unsent.get(connection)
        if rest is None:
            return
        rest += data
        try:
            while rest:
                del rest[: connection.send(rest)]
        except BlockingIOError:
            if len(rest) > self._unread_bytes:
                self.drop(connection, "it does not read its answers")
        except OSError:
            self.drop(connection)

    def drop(self, connection: socket.socket, reason: str = "") -> None:
        """Drop a client; may be called twice."""
        if self.unsent.pop(connection, None) is not None:
            connection.close()
            self._left(connection, reason)

    def close(self) -> None:
        """Drop all clients and stop listening; may be called twice."""
        for connection in list(self.unsent):
            self.drop(connection)
        for listener in self._listeners:
            listener.close()
        self._listeners.clear()
