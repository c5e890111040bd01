"""Where emulated devices meet the host: a serial line or a network, and the faults of either."""

import contextlib
import errno
import fcntl
import os
import pty
import socket
import struct
import termios
import tty
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from simulator.devices.far_end import FarEnd
from simulator.devices.faults import corrupted
from simulator.devices.tcp_clients import TcpClients

READ_BYTES = 4096

_NONE = struct.pack("i", 0)


class DeviceEnd(FarEnd):
    """The end of a wire with a device behind it: an `EmulatedDevice`, or what has its methods."""

    def __init__(self, device: Any) -> None:
        self._device = device

    def inject(self, kind: str, t_s: float) -> None:
        """See `EmulatedDevice.inject`."""
        self._device.inject(kind, t_s)


class Line(DeviceEnd):
    """A pty with an emulated device at its far end."""

    def __init__(self, device: Any) -> None:
        super().__init__(device)
        self._far, near = pty.openpty()
        tty.setraw(near)
        os.set_blocking(self._far, False)
        self.endpoint = {"port": os.ttyname(near)}
        # One end stays open here, so that the line survives a host that closes and opens it again.
        self._near: int | None = near

    def waited(self) -> Sequence[int]:
        """See `FarEnd.waited`."""
        return [self._far] if self._near is not None else []

    def _carry(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        if self._near is None:
            return False
        out = b""
        if self._far in ready:
            with contextlib.suppress(OSError):
                out = self._device.receive(os.read(self._far, READ_BYTES), t_s)
        out += self._device.step(t_s)
        out = corrupted(self._faults, out, trial_s)
        if out:
            self._write(out)
        return bool(out) or self._far in ready

    def unread(self) -> bool:
        """See `FarEnd.unread`."""
        return self._near is not None and fcntl.ioctl(self._near, termios.FIONREAD, _NONE) != _NONE

    def unplug(self) -> None:
        """See `FarEnd.unplug`: the host sees its port vanish."""
        if self._near is not None:
            os.close(self._near)
            os.close(self._far)
            self._near = None

    def _write(self, out: bytes) -> None:
        try:
            os.write(self._far, out)
        except OSError as error:
            # Nothing reads: a real board's bytes are lost as well.
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise


WAITING_BYTES = 1 << 19
"""Of what the network has not taken: beyond, the device has to drop what it cannot keep (assumption: a second of
sound)."""

UNREAD_BYTES = 1 << 20
"""Of the same: beyond, the host does not read the answers that it requested, and is disconnected (assumption)."""

SOCK_DIAG, BY_FAMILY, REQUEST = 4, 20, 1
"""Netlink's protocol that tells what a connection has not read, its message, its flag (linux/sock_diag.h)."""

ANY = 0xFFFFFFFF


class UdpLine(DeviceEnd):
    """A device on a loopback port of its own, that answers whoever asked last, in datagrams.

    A datagram comes whole or not at all: data that are corrupt are data that do not come.

    Args:
        device: Its attribute `datagram` is how many bytes one has, its `endpoint` what else the driver is told.
    """

    def __init__(self, device: Any) -> None:
        super().__init__(device)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._host: Any = None
        self.endpoint: Mapping[str, Any] = {
            "host": f"127.0.0.1:{self._socket.getsockname()[1]}",
            **device.endpoint,
        }

    def waited(self) -> Sequence[socket.socket]:
        """See `FarEnd.waited`."""
        return [] if self._socket.fileno() < 0 else [self._socket]

    def _carry(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        if not self.waited():
            return False
        out = b""
        if self._socket in ready:
            with contextlib.suppress(OSError):
                data, self._host = self._socket.recvfrom(READ_BYTES)
                out = self._device.receive(data, t_s)
        out += self._device.step(t_s)
        if self._faults.active(trial_s, "silent", "lose", "corrupt"):
            out = b""
        size = self._device.datagram
        for start in range(0, len(out), size):
            with contextlib.suppress(OSError):  # nothing listens there any more, or its buffer is full
                self._socket.sendto(out[start : start + size], self._host)
        return bool(out) or self._socket in ready

    def unplug(self) -> None:
        """See `FarEnd.unplug`: what the host sends is refused."""
        self._socket.close()


class TcpLine(DeviceEnd):
    """A device on a loopback port of its own, for one host at a time; a second one is disconnected.

    Args:
        device: While its `lossy` is set it drops what it streams; it is told by `hang_up` that the host is gone.
    """

    def __init__(self, device: Any) -> None:
        super().__init__(device)
        self._clients = TcpClients(1, UNREAD_BYTES, lambda host, reason: device.hang_up(self._t_s))
        self._listener = self._clients.listen()
        host, port = self._listener.getsockname()
        self.endpoint: Mapping[str, str] = {"port": f"tcp:{host}:{port}"}
        self._netlink = socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, SOCK_DIAG)

    def waited(self) -> Sequence[socket.socket]:
        """See `FarEnd.waited`."""
        return self._clients.sockets

    def _carry(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        out = b""
        for host in [host for host in self._clients.unsent if host in ready]:
            if data := self._clients.receive(host):
                out = self._device.receive(data, t_s)
        if self._listener in ready:
            self._clients.accept(self._listener)
        silent = self._faults.active(trial_s, "silent")
        self._device.lossy = self._faults.active(trial_s, "lose", "corrupt") or any(
            len(rest) > WAITING_BYTES for rest in self._clients.unsent.values()
        )
        out += self._device.step(t_s)
        for host in [] if silent else list(self._clients.unsent):
            self._clients.send(host, out)
        return bool(self._clients.unsent)

    def unread(self) -> bool:
        """See `FarEnd.unread`; False where the kernel gives no answer."""
        with contextlib.suppress(OSError):  # the host has just gone: its next turn sees to that
            return any(_unread(self._netlink, host) for host in self._clients.unsent)
        return False

    def unplug(self) -> None:
        """See `FarEnd.unplug`: the host sees its connection end, and no more answers."""
        self._clients.close()
        self._netlink.close()


def _unread(netlink: socket.socket, connection: socket.socket) -> bool:
    """Whether a connection's other end, on the same machine, has not read all yet; False where the kernel gives no
    answer."""
    (here, here_port), (there, there_port) = connection.getsockname(), connection.getpeername()
    which = struct.pack("!HH4s12x4s12x", there_port, here_port, *map(socket.inet_aton, (there, here)))
    body = struct.pack("=BBBxI", socket.AF_INET, socket.IPPROTO_TCP, 0, ANY) + which
    body += struct.pack("=III", 0, ANY, ANY)
    netlink.send(struct.pack("=IHHII", 16 + len(body), BY_FAMILY, REQUEST, 0, 0) + body)
    answer = netlink.recv(4096)
    kind = struct.unpack_from("=4xH", answer)[0]
    return bool(kind == BY_FAMILY and struct.unpack_from("=I", answer, 16 + 56)[0])
