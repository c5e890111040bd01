"""The program's side of the arm's process: starts it, hears it, kills it."""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

from drivers.clock import Clock
from drivers.messages import Command
from drivers.ur_arm.settings import UrArmSettings

ROOT = Path(__file__).resolve().parents[2]

LEAVE_S = 4.0
"""How long the process may take to stop the arm and end: what it allows itself, and as much again."""

EXIT_S = 0.2
"""How long a process that has closed its end may take to exit (assumption: a core dump of a busy machine)."""

READER_S = 1.0
"""Longest wait for a killed process, and for the reader thread that ends with it (assumption)."""


GAVE_UP = 1
"""Exit code of a process that is beyond repair (`child.ArmProcess.end`)."""


class ArmHost:
    """One process for one arm.

    Args:
        name: Of the device.
        settings: Of the arm.
        clock: Says when something was heard.
        again: Whether it replaces one that died.

    Attributes:
        heard_s: The clock's monotonic time at which something was last heard; of the start before that.
    """

    def __init__(self, name: str, settings: UrArmSettings, clock: Clock, again: bool) -> None:
        self._clock = clock
        self.heard_s = self._clock.monotonic_s()
        self._queue: deque[object] = deque()
        # The socket is kept beside the connection: shutting it down is what the child takes for our end.
        self._socket, theirs = socket.socketpair()
        self._connection = Connection(os.dup(self._socket.fileno()))
        # Beside the pipe: a process that is busy recovering reads no pipe, and a full one would hold the loop up.
        self._turns = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "drivers.ur_arm.child", str(theirs.fileno())],
            cwd=ROOT,
            pass_fds=[theirs.fileno(), self._turns],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        theirs.close()
        self._ended_s = math.inf
        self._connection.send((name, settings.model_dump_json(), again, self._turns))
        self._reader = threading.Thread(target=self._fill, name=f"{name}-reader", daemon=True)
        self._reader.start()

    def send(self, command: Command) -> None:
        """Hand a command over; a process that is gone shows in `fate`."""
        with suppress(OSError):
            self._connection.send(command)

    def turned(self) -> None:
        """The program's loop has turned: it leads the arm yet. Never waits."""
        os.eventfd_write(self._turns, 1)

    def receive(self) -> list[object]:
        """What has come since the last call, in order; see `drivers.ur_arm.pipe`."""
        messages = []
        with suppress(IndexError):
            while True:
                messages.append(self._queue.popleft())
        return messages

    def fate(self) -> str:
        """How the process ended, or "" while it lives or has left things to be received."""
        if self._ended_s == math.inf or self._queue:
            return ""
        code = self._process.poll()
        if code is None:
            # It has closed its end; the exit itself follows, as a rule in microseconds.
            return (
                ""
                if self._clock.monotonic_s() - self._ended_s < EXIT_S
                else "the arm's process let go of its pipe"
            )
        if code < 0:
            return f"the arm's process died ({signal.Signals(-code).name})"
        if code == GAVE_UP:
            # It says why, but for one case: its pipe was full.
            return "the arm's process gave up, for nobody read what it sent: is this machine overloaded?"
        return f"the arm's process ended with {code}"

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(READER_S)
        self._reader.join(READER_S)
        self._connection.close()
        self._socket.close()
        os.close(self._turns)

    def close(self) -> None:
        """Let the process stop the arm and end; kill it where it does not. Never raises."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(LEAVE_S)
        self.kill()

    def _fill(self) -> None:
        try:
            while True:
                message = self._connection.recv()
                self.heard_s = self._clock.monotonic_s()
                self._queue.append(message)
        except (EOFError, OSError):
            self._ended_s = self._clock.monotonic_s()
