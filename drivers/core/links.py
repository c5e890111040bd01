"""For serial drivers: a port, here or on the network, and one thread that time-stamps arriving bytes."""

from __future__ import annotations

import errno
import os
import re
import socket
import threading
import warnings
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TypeVar

import serial
from pydantic import Field

from drivers.core.clock import Clock
from drivers.core.errors import PortError
from drivers.core.settings import Settings

T = TypeVar("T")

JOIN_TIMEOUT_S = 1.0
"""Longest wait for the reader thread at close; it is woken, so this is not expected to pass (assumption)."""

LOOK_S = 0.1
"""How long a read of a network port lasts, which cannot be woken (assumption: closing may take so long)."""

CHUNK = 65_536
"""Bytes taken from a socket at once."""

_LINE_END = re.compile(rb"[\r\n]+")

_ADVICE = {
    errno.ENOENT: ("does not exist", "is it plugged in? see: ls /dev/serial/by-id"),
    errno.ENODEV: ("has no device behind it", "is it plugged in? see: ls /dev/serial/by-id"),
    errno.ENXIO: ("has no device behind it", "is it plugged in? see: ls /dev/serial/by-id"),
    errno.EIO: ("has no device behind it", "is it plugged in and powered? is its emulator running?"),
    errno.EACCES: (
        "may not be opened by this user",
        "join its group, as a rule: sudo usermod -aG dialout $USER",
    ),
    errno.EAGAIN: ("is held by another program", "find it with: fuser -v {port}"),
    errno.EBUSY: ("is held by another program", "find it with: fuser -v {port}"),
    errno.EISDIR: ("is no serial port", "see: ls /dev/serial/by-id"),
    errno.ENOTTY: ("is no serial port", "see: ls /dev/serial/by-id"),
}


def drained(queue: deque[T]) -> list[T]:
    """What a thread has put into a queue since the last call, in order."""
    taken = []
    with suppress(IndexError):
        while True:
            taken.append(queue.popleft())
    return taken


class SerialPort(Settings):
    """Where a serial device is; settings of drivers on one are derived from these."""

    port: str = Field(min_length=1)
    """Path of the port, `/dev/serial/by-id/...` or a pty; or a serial server's, `socket://HOST:PORT` (bare bytes) or
    `rfc2217://HOST:PORT` (which sets the line speed too)."""
    baud: int = Field(default=115_200, ge=1_200, le=12_000_000)
    """Line speed in bits per second; 8 data bits, no parity, 1 stop bit, no flow control."""
    dtr: bool = True
    """Whether the lines DTR and RTS are on once the port is open; many boards reset when they change."""

    @property
    def serial_port(self) -> bool:
        """See `Settings.serial_port`."""
        return True


def open_serial(device: str, where: SerialPort, clock: Clock) -> SerialLink:
    """Open a serial port, or a pty, for this program alone.

    Raises:
        PortError: absent, busy, forbidden or no serial port: one line with what to do.
    """
    port = where.port
    try:
        opened = serial.serial_for_url(port, where.baud, do_not_open=True)
        if not where.dtr:
            opened.dtr = opened.rts = False
        if "://" in port:
            opened.timeout = LOOK_S
        else:
            opened.exclusive = True
        with warnings.catch_warnings():  # of pyserial's own thread for RFC 2217
            warnings.simplefilter("ignore", DeprecationWarning)
            opened.open()
    except (OSError, ValueError) as error:
        # pyserial keeps the number of a failed open, but not that of a failed tcgetattr.
        local = "://" not in port
        configured = local and isinstance(error, serial.SerialException) and error.errno is None
        number = errno.ENOTTY if configured else getattr(error, "errno", None)
        remedy = "is that host up, and its server?" if "://" in port else "see: ls /dev/serial/by-id"
        reason, advice = _ADVICE.get(number or 0, (f"cannot be opened ({error})", remedy))
        raise PortError(device, "opening its port", f"{port} {reason}", advice.format(port=port)) from error
    # An FTDI adapter holds bytes back for 16 ms by default (its data sheet); ptys refuse, the network has none.
    with suppress(AttributeError, OSError, ValueError, NotImplementedError):
        opened.set_low_latency_mode(True)
    # A short line does not wait until the one before it is acknowledged.
    if (connected := getattr(opened, "_socket", None)) is not None:
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return SerialLink(device, opened, clock)


class LineBuffer:
    """Cuts a stream of bytes, split anywhere, into lines; what grows beyond `longest` bytes is dropped.

    Attributes:
        dropped: Lines that were too long.
    """

    def __init__(self, longest: int) -> None:
        self.dropped = 0
        self._longest = longest
        self._rest = b""
        self._overlong = False

    def feed(self, data: bytes) -> list[bytes]:
        """Lines completed by these bytes, without their ends; empty lines are left out."""
        *lines, rest = _LINE_END.split(self._rest + data)
        if lines and self._overlong:
            lines = lines[1:]
            self._overlong = False
        if len(rest) > self._longest and not self._overlong:
            self._overlong = True
            self.dropped += 1
        self._rest = b"" if self._overlong else rest
        return [line for line in lines if line]


class SerialLink:
    """An open port with its reader thread.

    The thread fills a queue with what arrives, and when; it does nothing else and raises nothing. `send` and
    `receive` never wait; they belong to one thread, the loop's.

    Attributes:
        fault: Why the link is gone, or None while it stands.
    """

    def __init__(self, device: str, port: serial.Serial, clock: Clock) -> None:
        self.fault: str | None = None
        self._port = port
        self._clock = clock
        self._arrived: deque[tuple[float, bytes]] = deque()
        self._closing = False
        url = str(port.port)
        self._socket = url.startswith("socket://")
        self._write: Callable[[bytes], int | None] = port.write
        if "://" not in url or self._socket:
            self._write = partial(os.write, port.fileno())
        self._reader = threading.Thread(target=self._fill, name=f"{device}-reader", daemon=True)
        self._reader.start()

    def send(self, data: bytes) -> float | None:
        """Hand bytes to the kernel, without waiting.

        Returns:
            The monotonic time in seconds at which the last byte was taken, or None where the link is gone
            (see `fault`).
        """
        if self.fault is not None or self._closing:
            return None
        # pyserial's own write either waits, or spins on a full buffer, or calls it a time-out when this thread
        # lost the processor after the last byte was taken.
        try:
            while data:
                data = data[self._write(data) :]
        except BlockingIOError:
            self.fault = self.fault or "the port takes no more bytes"
        except OSError as error:
            self.fault = self.fault or f"the port was taken away ({error})"
        return None if data else self._clock.monotonic_s()

    def receive(self) -> list[tuple[float, bytes]]:
        """What has arrived since the last call: (monotonic arrival in seconds, bytes), in order."""
        return drained(self._arrived)

    def close(self) -> None:
        """Close the port and wait for the thread. Never raises; may be called twice."""
        self._closing = True
        with suppress(OSError, AttributeError):  # on the network there is none
            self._port.cancel_read()
        self._reader.join(JOIN_TIMEOUT_S)
        connected = getattr(self._port, "_socket", None)
        with suppress(OSError):
            self._port.close()
        if connected is not None:  # pyserial leaves one open that the far end has reset
            connected.close()

    def _fill(self) -> None:
        try:
            while not self._closing:
                data = self._port.read(1)
                arrival_s = self._clock.monotonic_s()
                if data:
                    self._arrived.append((arrival_s, data + self._rest()))
        except (OSError, TypeError) as error:  # TypeError: the port was closed under a read that hung
            if not self._closing:
                self.fault = self.fault or f"the port was taken away ({error})"

    def _rest(self) -> bytes:
        """What has arrived besides; pyserial would take it from a socket byte by byte."""
        if not self._socket:
            return self._port.read(self._port.in_waiting)
        with suppress(BlockingIOError):
            return os.read(self._port.fileno(), CHUNK)
        return b""
