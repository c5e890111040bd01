"""A TCP connection with an emulated device at its far end, and the connection's faults."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Protocol

from drivers.core.clock import Clock
from simulator.devices.faults import FaultSchedule, inject_begun
from simulator.devices.tcp_clients import TcpClients
from simulator.wiring.far_ends import EmulatedDevice

WAITING_BYTES = 1 << 19
"""Of what the network has not taken: beyond, the device has to drop what it cannot keep (assumption: a second of
sound)."""

UNREAD_BYTES = 1 << 20
"""Of the same: beyond, the host does not read the answers that it requested, and is disconnected (assumption)."""

SOCK_DIAG, BY_FAMILY, REQUEST = 4, 20, 1
"""Netlink's protocol that tells what a connection has not read, its message, its flag (linux/sock_diag.h)."""

ANY = 0xFFFFFFFF


class NetworkDevice(EmulatedDevice, Protocol):
    """A device made of software, at the far end of a connection.

    Attributes:
        lossy: It drops what it streams.
    """

    lossy: bool

    def hang_up(self, t_s: float) -> None:
        """The host is gone."""


class TcpLine:
    """A `FarEnd`: a device on a loopback port of its own, for one host at a time; a second one is disconnected.

    TCP delivers bytes whole or not at all: data that are lost or corrupt are data that do not come.

    Args:
        scheme: What the port's address begins with, as the driver's setting has it.
    """

    def __init__(self, device: NetworkDevice, scheme: str = "tcp") -> None:
        self._device = device
        self._faults = FaultSchedule()
        self._t_s = 0.0
        self._clients = TcpClients(1, UNREAD_BYTES, lambda host, reason: device.hang_up(self._t_s))
        self._listener = self._clients.listen()
        host, port = self._listener.getsockname()
        self.endpoint: Mapping[str, str] = {"port": f"{scheme}:{host}:{port}"}
        self._netlink = socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, SOCK_DIAG)

    def open(self, faults: FaultSchedule, clock: Clock) -> None:
        """See `FarEnd.open`; it listens from the start."""
        self._faults = faults

    def waited(self) -> Sequence[socket.socket]:
        """See `FarEnd.waited`."""
        return self._clients.sockets

    def due_s(self) -> float:
        """See `FarEnd.due_s`: it does with being stepped as often as all are."""
        return math.inf

    def exchange(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        """See `FarEnd.exchange`."""
        self._t_s = t_s
        if self._faults.begun(trial_s, "unplug"):
            self.unplug()
        inject_begun(self._faults, self._device, trial_s, t_s)
        out = b""
        for host in [host for host in self._clients.unsent if host in ready]:
            if data := self._clients.receive(host):
                out = self._device.receive(data, t_s)
        if self._listener in ready:
            self._clients.accept(self._listener)
        silent = self._faults.active(trial_s, "silent")
        lost = self._faults.active(trial_s, "lose") or self._faults.active(trial_s, "corrupt")
        self._device.lossy = lost or any(len(rest) > WAITING_BYTES for rest in self._clients.unsent.values())
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
