"""Where emulated devices meet the host: a serial line or a network, and the faults of either."""

import contextlib
import errno
import fcntl
import math
import os
import pty
import socket
import struct
import termios
import tty
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Protocol

from drivers.core.clock import Clock
from simulator.devices.faults import FaultSchedule, corrupted, inject_begun
from simulator.devices.tcp_clients import TcpClients
from simulator.devices.ur_controller.server import UrServer

READ_BYTES = 4096

_NONE = struct.pack("i", 0)

HOSTS = tuple(f"127.0.0.{number}" for number in range(2, 255))
"""Loopback addresses for networked devices: the first that is free. The ports of a controller are fixed."""


class EmulatedDevice(Protocol):
    """A device made of software, at the far end of a serial line."""

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take bytes from the host; returns what is answered at once."""

    def step(self, t_s: float) -> bytes:
        """What the device sends by `t_s` on its own."""

    def inject(self, kind: Any, t_s: float) -> None:
        """Break something of the device's own: "stall" or "refuse".

        Raises:
            ValueError: it cannot break in that way.
        """


class FarEnd:
    """One device's end of the wire.

    Attributes:
        endpoint: Where the host finds it: settings of its driver.
    """

    endpoint: Mapping[str, Any]

    def __init__(self) -> None:
        self._faults = FaultSchedule()

    def open(self, faults: FaultSchedule, clock: Clock) -> None:
        """Accept the host; times come from `clock`, what goes wrong from `faults`."""
        self._faults = faults

    def waited(self) -> Sequence[Any]:
        """What to select on."""
        raise NotImplementedError

    def due_s(self) -> float:
        """When it has something to do by itself that is worth waking up for."""
        return math.inf

    def exchange(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        """Carry bytes both ways, and let the faults happen that have begun.

        Args:
            ready: What of `waited` can be read.
            trial_s: Present time since the trial began, as faults count it.

        Returns:
            False where nobody is served: the emulator may take longer steps.
        """
        raise NotImplementedError

    def unread(self) -> bool:
        """Whether the host has bytes before it that it has not read."""
        return False

    def unplug(self) -> None:
        """Disconnect; may be called twice."""
        raise NotImplementedError


class Line(FarEnd):
    """A pty with an emulated device at its far end."""

    def __init__(self, device: EmulatedDevice) -> None:
        super().__init__()
        self._device = device
        self._far, near = pty.openpty()
        tty.setraw(near)
        os.set_blocking(self._far, False)
        self.endpoint = {"port": os.ttyname(near)}
        # One end stays open here, so that the line survives a host that closes and opens it again.
        self._near: int | None = near

    def waited(self) -> Sequence[int]:
        """See `FarEnd.waited`."""
        return [self._far] if self._near is not None else []

    def exchange(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        """See `FarEnd.exchange`."""
        self._fail(t_s, trial_s)
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

    def _fail(self, t_s: float, trial_s: float) -> None:
        if self._faults.begun(trial_s, "unplug"):
            self.unplug()
        inject_begun(self._faults, self._device, trial_s, t_s)

    def _write(self, out: bytes) -> None:
        try:
            os.write(self._far, out)
        except OSError as error:
            # Nothing reads: a real board's bytes are lost as well.
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise


class Network(FarEnd):
    """An emulated controller on a loopback address of its own.

    A stall is a protective stop; a refusal is local control, taken at the pendant.
    """

    def __init__(self, server: UrServer) -> None:
        super().__init__()
        self._server = server

    def open(self, faults: FaultSchedule, clock: Clock) -> None:
        """See `FarEnd.open`.

        Raises:
            OSError: no address is free.
        """
        super().open(faults, clock)
        self._server.clock = clock
        self._server.open(HOSTS)
        # what acts on an emulated arm is not to be scheduled before the loop
        self.endpoint = {"host": self._server.host, "realtime_priority": 0}

    def waited(self) -> Sequence[Any]:
        """See `FarEnd.waited`."""
        return self._server.sockets

    def due_s(self) -> float:
        """See `FarEnd.due_s`: the controller's next cycle, where somebody waits for it."""
        return self._server.next_s if self._server.served else math.inf

    def exchange(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        """See `FarEnd.exchange`."""
        self._fail(trial_s)
        self._server.deaf = silent = self._faults.active(trial_s, "silent")
        # by TCP bytes come whole or not at all, corrupt ones not
        self._server.streams = not (silent or self._faults.active(trial_s, "lose", "corrupt"))
        self._server.turn(now_s=t_s)
        return self._server.served

    def unplug(self) -> None:
        """See `FarEnd.unplug`: the host sees its connections end, and no more answers."""
        self._server.close()

    def _fail(self, trial_s: float) -> None:
        controller = self._server.controller
        if self._faults.begun(trial_s, "unplug"):
            self.unplug()
        if self._faults.begun(trial_s, "stall"):
            controller.protective_stop("injected")
        if self._faults.begun(trial_s, "refuse"):
            controller.remote = False
            controller.stop_program("local control")


WAITING_BYTES = 1 << 19
"""Of what the network has not taken: beyond, the device has to drop what it cannot keep (assumption: a second of
sound)."""

UNREAD_BYTES = 1 << 20
"""Of the same: beyond, the host does not read the answers that it requested, and is disconnected (assumption)."""

SOCK_DIAG, BY_FAMILY, REQUEST = 4, 20, 1
"""Netlink's protocol that tells what a connection has not read, its message, its flag (linux/sock_diag.h)."""

ANY = 0xFFFFFFFF


class UdpLine(FarEnd):
    """A device on a loopback port of its own, that answers whoever asked last, in datagrams.

    A datagram comes whole or not at all: data that are corrupt are data that do not come.

    Args:
        device: Its attribute `datagram` is how many bytes one has, its `endpoint` what else the driver is told.
    """

    def __init__(self, device: Any) -> None:
        super().__init__()
        self._device = device
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

    def exchange(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        """See `FarEnd.exchange`."""
        if self._faults.begun(trial_s, "unplug"):
            self.unplug()
        if not self.waited():
            return False
        inject_begun(self._faults, self._device, trial_s, t_s)
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


class TcpLine(FarEnd):
    """A `FarEnd`: a device on a loopback port of its own, for one host at a time; a second one is disconnected.

    Args:
        device: While its `lossy` is set it drops what it streams; it is told by `hang_up` that the host is gone.
    """

    def __init__(self, device: Any) -> None:
        super().__init__()
        self._device = device
        self._t_s = 0.0
        self._clients = TcpClients(1, UNREAD_BYTES, lambda host, reason: device.hang_up(self._t_s))
        self._listener = self._clients.listen()
        host, port = self._listener.getsockname()
        self.endpoint: Mapping[str, str] = {"port": f"tcp:{host}:{port}"}
        self._netlink = socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, SOCK_DIAG)

    def waited(self) -> Sequence[socket.socket]:
        """See `FarEnd.waited`."""
        return self._clients.sockets

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
