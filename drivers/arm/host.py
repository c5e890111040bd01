"""The program's side of the arm's process: starts it, reads it, kills it. No thread: the loop reads the pipe."""

import math
import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from drivers.arm.link import ArmLink
from drivers.arm.pipe import Pipe, Start
from drivers.arm.settings import ArmSettings
from drivers.core.clock import Clock
from drivers.core.messages import Command

ROOT = Path(__file__).resolve().parents[2]

LEAVE_S = 4.0
"""How long the process may take to stop the arm and end: what it allows itself, and as much again."""

EXIT_S = 0.2
"""How long a process that has closed its end may take to exit (assumption: a core dump of a busy machine)."""

KILLED_S = 1.0
"""Longest wait for a killed process (assumption)."""

GAVE_UP = 1
"""Exit code of a process that is beyond repair (`process.ArmProcess.end`)."""


class ArmHost:
    """One process for one arm.

    Args:
        again: Whether it replaces one that died.

    Attributes:
        received_s: The clock's monotonic time of the last message; of the start before the first.
    """

    def __init__(
        self, name: str, settings: ArmSettings, link: type[ArmLink], clock: Clock, again: bool
    ) -> None:
        self._clock = clock
        self.received_s = self._clock.monotonic_s()
        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        self._pipe = Pipe(ours)
        # Beside the pipe: a process that is busy recovering reads no pipe, and a full one would hold the loop up.
        self._turns = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        path = [*map(str, {folder_of(link), folder_of(type(settings))}), os.environ.get("PYTHONPATH", "")]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "drivers.arm.process", str(theirs.fileno())],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path))},
            pass_fds=[theirs.fileno(), self._turns],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        theirs.close()
        self._ended_s = math.inf
        self._pipe.send(Start(name, settings, link, again, self._turns, clock))

    def send(self, command: Command) -> None:
        """Hand a command over; a process that is gone shows in `exit_reason`."""
        with suppress(OSError):
            self._pipe.send(command)

    def heartbeat(self) -> None:
        """The program's loop has turned: it still supervises the arm. Never waits."""
        os.eventfd_write(self._turns, 1)

    def receive(self) -> list[object]:
        """Messages since the last call, in order; see `drivers.arm.pipe`."""
        messages = []
        try:
            while (message := self._pipe.receive()) is not None:
                messages.append(message)
        except EOFError:
            self._ended_s = min(self._ended_s, self._clock.monotonic_s())
        if messages:
            self.received_s = self._clock.monotonic_s()
        return messages

    def exit_reason(self) -> str:
        """How the process ended, or "" while it lives or has left things to be received."""
        if self._ended_s == math.inf:
            return ""
        code = self._process.poll()
        if code is None:
            # It has closed its end; the exit itself follows, as a rule in microseconds.
            exiting = self._clock.monotonic_s() - self._ended_s < EXIT_S
            return "" if exiting else "the arm's process closed its pipe"
        if code < 0:
            return f"the arm's process died ({signal.Signals(-code).name})"
        if code == GAVE_UP:
            # It has sent its reason, unless its pipe was full.
            return "the arm's process gave up, for the program did not read what it sent: is this machine overloaded?"
        return f"the arm's process ended with {code}"

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(KILLED_S)
        self._pipe.close()
        os.close(self._turns)

    def close(self) -> None:
        """Let the process stop the arm and end; kill it where it does not. Never raises."""
        self._clock.leave()  # stopping takes time
        with suppress(OSError):
            self._pipe.hang_up()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(LEAVE_S)
        self.kill()


def folder_of(kind: type) -> Path:
    """Where the process finds the module of a class: beside a profile it is on no import path of its own."""
    module = sys.modules[kind.__module__.partition(".")[0]]
    return Path(next(iter(getattr(module, "__path__", [module.__file__])))).resolve().parent
