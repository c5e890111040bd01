"""The controller on five TCP ports of a loopback address, in step with the wall clock.

The server belongs in a process of its own: the client holds its interpreter's lock while it connects.
"""

import math
import select
import socket
import sys
import traceback
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from typing import Any

from drivers.core.clock import Clock, WallClock
from simulator.devices.far_end import FarEnd
from simulator.devices.faults import FaultSchedule
from simulator.devices.tcp_clients import TcpClients
from simulator.devices.ur_controller.controller import UrController
from simulator.devices.ur_controller.primary import PrimarySession, greeting
from simulator.devices.ur_controller.rtde import PackageError
from simulator.devices.ur_controller.script import STEP_S
from simulator.devices.ur_controller.session import GREETING, DashboardSession, RtdeSession, ScriptSession

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999
PRIMARY_PORT, SECONDARY_PORT = 30001, 30002
"""Ports of a controller (script manual, client interface manual)."""

BACKLOG_STEPS = 250
"""Cycles that a delayed server makes up for; beyond half a second it gives up (assumption)."""

BURST_STEPS = 10
"""Cycles made up in one go before sockets are served again (assumption)."""

UNREAD_BYTES = 1 << 22
"""What a client may leave unread beyond what the network takes: seconds of every variable at 500 Hz (assumption)."""

HOSTS = tuple(f"127.0.0.{number}" for number in range(2, 255))
"""Loopback addresses of an emulated bench: the first that is free. The ports of a controller are fixed."""

CLIENTS = 64
"""Connections at a time (assumption; `select` bears a thousand)."""


Session = RtdeSession | ScriptSession | DashboardSession


class UrServer(FarEnd):
    """A controller that listens; a far end of its own, on a loopback address.

    Attributes:
        deaf: True makes it accept RTDE connections and answer none.
        streams: False makes it send no data packages.
        silent_until_s: Host time until which nothing goes out on RTDE.
        next_s: Host time of the controller's next cycle.
        clock: For the controller's cycles; to be set before it listens.
    """

    def __init__(self, controller: UrController) -> None:
        self.controller = controller
        self.deaf = False
        self.streams = True
        self.silent_until_s = 0.0
        self.host = controller.settings.host
        self.next_s = 0.0
        self.clock: Clock = WallClock()
        self._taken: set[str] = set()
        self._listeners: dict[socket.socket, Callable[[], Session]] = {}
        self._sessions: dict[socket.socket, Session] = {}
        self._clients = TcpClients(CLIENTS, UNREAD_BYTES, self._left)

    def open(self, faults: FaultSchedule, clock: Clock) -> None:
        """See `FarEnd.open`.

        Raises:
            OSError: no address is free.
        """
        super().open(faults, clock)
        self.clock = clock
        self.listen(HOSTS)
        # what acts on an emulated arm is not to be scheduled before the loop
        self.endpoint = {"host": self.host, "realtime_priority": 0}

    def waited(self) -> Sequence[socket.socket]:
        """See `FarEnd.waited`."""
        return self._clients.sockets

    def due_s(self) -> float:
        """See `FarEnd.due_s`: the controller's next cycle, where somebody waits for it."""
        return self.next_s if self._sessions else math.inf

    def _carry(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        self.deaf = silent = self._faults.active(trial_s, "silent")
        # by TCP bytes come whole or not at all, corrupt ones not
        self.streams = not (silent or self._faults.active(trial_s, "lose", "corrupt"))
        self.turn(now_s=t_s)
        return bool(self._sessions)

    def inject(self, kind: str, t_s: float) -> None:
        """See `FarEnd.inject`: a "stall" is a protective stop, "refuse" local control, taken at the pendant."""
        if kind == "stall":
            self.controller.protective_stop("injected")
        elif kind == "refuse":
            self.controller.remote = False
            self.controller.stop_program("local control")
        else:
            raise ValueError(f"an arm has no fault {kind!r} of its own; it has stall, refuse")

    def listen(self, hosts: Sequence[str] = ()) -> None:
        """Listen.

        Args:
            hosts: Addresses to choose from: the first with all ports free. None: that of the settings.

        Raises:
            OSError: a port of every address is taken.
        """
        *others, last = hosts or (self.host,)
        for host in others:
            with suppress(OSError):
                self._listen_at(host)
                return
        self._listen_at(last)

    def _listen_at(self, host: str) -> None:
        kinds: dict[int, Callable[[], Session]] = {
            RTDE_PORT: lambda: RtdeSession(self.controller, self._taken),
            PRIMARY_PORT: lambda: PrimarySession(self.controller),
            SECONDARY_PORT: lambda: PrimarySession(self.controller),
            SCRIPT_PORT: lambda: ScriptSession(self.controller),
            DASHBOARD_PORT: lambda: DashboardSession(self.controller),
        }
        try:
            for port, kind in kinds.items():
                self._listeners[self._clients.listen(host, port)] = kind
        except OSError:
            self.unplug()
            raise
        self.host = host
        self.next_s = self.clock.monotonic_s() + STEP_S

    def unplug(self) -> None:
        """See `FarEnd.unplug`: clients see their connections end, and no more answers."""
        self._clients.close()
        self._listeners.clear()

    def restart(self) -> None:
        """Switch the controller off and on: every connection is gone, and time is zero."""
        for connection in list(self._sessions):
            self._clients.drop(connection)
        self.controller = UrController(self.controller.settings, self.controller.surroundings)
        self.deaf, self.streams, self.silent_until_s = False, True, 0.0

    def turn(self, wait_s: float = 0.0, now_s: float | None = None) -> None:
        """Wait for something on the sockets, handle all of it, then make the cycles that are due.

        A loop that has other devices to serve calls it at least once in two milliseconds.

        Args:
            now_s: Host time up to which cycles are due; None is the present.
        """
        # select alone waits in microseconds: epoll and poll round to 1 ms.
        ready, writable, _ = select.select(
            self.waited(),
            [connection for connection, rest in self._clients.unsent.items() if rest],
            [],
            wait_s,
        )
        for one in ready:
            self._accept(one) if one in self._listeners else self._receive(one)
        for one in writable:
            self._clients.send(one)
        self._catch_up(self.clock.monotonic_s() if now_s is None else now_s)

    def drop(self, which: str) -> int:
        """Close the RTDE connections of the client's "control" or "receive" interface; how many."""
        matching = [
            connection
            for connection, session in self._sessions.items()
            if isinstance(session, RtdeSession) and session.writes == (which == "control")
        ]
        for connection in matching:
            self._clients.drop(connection)
        return len(matching)

    def _catch_up(self, now_s: float) -> None:
        late_steps = math.floor((now_s - self.next_s) / STEP_S) + 1
        if late_steps > BACKLOG_STEPS:
            self.next_s += (late_steps - BACKLOG_STEPS) * STEP_S
        for _ in range(min(late_steps, BURST_STEPS)):
            # The arm moves in a world whose time does not begin with the controller's.
            self.controller.epoch_s = self.next_s - self.controller.t_s - STEP_S
            self.next_s += STEP_S
            self.controller.step()
            self._stream()

    def _stream(self) -> None:
        hushed = not self.streams or self.clock.monotonic_s() < self.silent_until_s
        for connection, session in list(self._sessions.items()):
            if isinstance(session, RtdeSession | PrimarySession):
                package = session.step()
                if package and not hushed:
                    self._clients.send(connection, package)

    def _accept(self, listener: socket.socket) -> None:
        connection = self._clients.accept(listener)
        if connection is None:
            return
        session = self._sessions[connection] = self._listeners[listener]()
        if isinstance(session, DashboardSession):
            self._clients.send(connection, GREETING)
        elif isinstance(session, PrimarySession):
            self._clients.send(connection, greeting(self.controller))

    def _receive(self, connection: socket.socket) -> None:
        session = self._sessions.get(connection)
        data = b"" if session is None else self._clients.receive(connection)
        if session is None or not data or (self.deaf and isinstance(session, RtdeSession)):
            return
        try:
            self._clients.send(connection, session.feed(data))
        except PackageError as error:
            self._clients.drop(connection, str(error))
        except Exception as error:  # a defect, and this client's alone: the others are served
            traceback.print_exc(file=sys.stderr)
            self._clients.drop(connection, f"{type(error).__name__}: {error}")

    def _left(self, connection: socket.socket, reason: str) -> None:
        if reason:
            self.controller.log.append(f"a client was dropped: {reason}")
        if (session := self._sessions.pop(connection, None)) is not None:
            session.close()
