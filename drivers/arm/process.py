"""The arm's process: `python -m drivers.arm.process FD`. It may hang, crash or be killed; the program may not.

Two threads, each with the half of the maker's link that it alone uses: this one sends commands, and the listener reads,
so that no sample is missed while a command is under way. Their messages are queued while the pipe is
full: a program that is slow to read must not keep the controller from its watchdog. The process ends without
destroying the link, for a client library's destructors may wait or abort.

Both threads tell the bench's clock when they look at it next (`Clock.hold`).
"""

import math
import os
import socket
import sys
import threading
from collections import deque
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version

from drivers.arm.guidance import CYCLE_S
from drivers.arm.link import CALLS_S, LOOK_S, ArmRow, LinkError, Opened, Seen
from drivers.arm.motion import MotionControl, MotionState
from drivers.arm.pipe import Pipe, Start
from drivers.core.clock import rest
from drivers.core.errors import ProtocolError, RefusedError, SilentError, lacking
from drivers.core.messages import Command, Home, Status, Stop

EARLY_S = 0.0006
"""How long before the next row is due the looks begin: the last look may have been late by `LOOK_S`."""

MARGIN_S = 0.00025
"""How late the next row may be looked for: an eighth of a UR controller's cycle, for its client keeps the latest row
alone."""

STUCK_S = 1.0
"""How long one command may take before the client counts as blocked: a hundred times the longest (measured)."""

BACKLOG = 2500
"""Messages that wait for a program which does not read: five seconds of rows, longer than any start of a trial. Of one
that is suspended for longer the oldest rows go; without its turns the arm stands."""

DRAIN_S = 0.1
"""How long the last message may wait for room in the pipe (assumption)."""

START_S = 10.0
"""Longest wait for the program's first message (assumption)."""

LEAVE_S = 2.0
"""How long the arm may take to stand when the host is gone (assumption)."""


class ArmProcess:
    """Both threads' common ground."""

    def __init__(self, pipe: Pipe, start: Start) -> None:
        self._pipe = pipe
        self._name, self._settings, self._again = start.name, start.settings, start.again
        self._turns, self._clock = start.turns, start.clock
        self._link = start.link(start.settings, start.clock)
        self._outbox: deque[Status | ArmRow | Opened | LinkError] = deque()
        self._sending = threading.Lock()
        self._heartbeat_s = self._clock.monotonic_s()
        self._patience_s = STUCK_S
        self._seen: Seen

    def run(self) -> None:
        """Connect, then carry out commands until the program is gone, or report why that cannot be."""
        try:
            self._run()
        except LinkError as error:
            self.end(error)
        except ImportError as error:
            advice = lacking(self._link.package, self._link.extra)[1]
            self.end(LinkError(RefusedError, f"the client is missing ({error})", advice))
        except Exception as error:
            # Whatever it is, it is reported to the program, which goes on.
            advice = "report this with the recording"
            self.end(LinkError(ProtocolError, f"{type(error).__name__}: {error}", advice))

    def _run(self) -> None:
        realtime = _ask_for_realtime(self._settings.realtime_priority)
        opened = self._link.open(self._again)
        package = self._link.package
        client = {"client": f"{package} {version(package)}"} if package else {}
        asked = {"realtime": realtime} if self._settings.realtime_priority else {}
        details = {**client, **asked, **opened.details}
        self._seen = Seen(opened.row, math.inf).then(opened.row)
        self._heartbeat_s = self._clock.monotonic_s()
        threading.Thread(target=self._listen, name="listener", daemon=True).start()
        self._send(replace(opened, details=details))
        self._obey()

    # --- control ---------------------------------------------------------------------------------------

    def _obey(self) -> None:
        motion = MotionControl(
            self._name, self._settings, self._link.client, self._clock.monotonic_s, self._send, self._seen
        )
        due_s = self._clock.monotonic_s()
        while True:
            due_s = max(due_s + CYCLE_S, self._clock.monotonic_s())
            self._heartbeat_s = self._clock.monotonic_s()
            try:
                # However late the cycle is, it takes the program's commands.
                self._take(motion)
                while self._await_command(due_s):
                    self._take(motion)
            except EOFError:
                self._leave(motion)
                return
            if self._clock.monotonic_s() - self._seen.row.arrival_s > 2.0 * self._settings.link_timeout_s:
                raise LinkError(SilentError, "no rows come through", "is the program still listening?")
            with suppress(BlockingIOError):  # not a turn since the last look
                os.eventfd_read(self._turns)
                motion.heartbeat()
            motion.step(self._seen)

    def _await_command(self, due_s: float) -> bool:
        """Wait until the cycle is due; whether a command has arrived before."""
        self._clock.hold(due_s + CALLS_S)
        while (wait_s := due_s - self._clock.monotonic_s()) > 0.0:
            if self._pipe.wait(max(wait_s, LOOK_S)):
                return True
        return False

    def _take(self, motion: MotionControl) -> None:
        """Carry out what the program has sent; a stop overtakes what it finds waiting."""
        waiting: deque[Command] = deque()
        while True:
            while (message := self._pipe.receive()) is not None:
                assert isinstance(message, Command)
                waiting.append(message)
            if not waiting:
                return
            command = waiting.popleft()
            if not isinstance(command, Stop) and any(isinstance(later, Stop) for later in waiting):
                motion.refuse_overtaken(command)
                continue
            # A recovery takes its time, within its own deadline.
            self._patience_s = STUCK_S + self._settings.recover_s * isinstance(command, Home)
            motion.order(command)
            self._patience_s, self._heartbeat_s = STUCK_S, self._clock.monotonic_s()

    def _leave(self, motion: MotionControl) -> None:
        """The program is gone: stop the arm, wait until it stands, end what runs on the controller."""
        motion.order(Stop(self._name))
        deadline_s = self._clock.monotonic_s() + LEAVE_S
        while (
            motion.state not in (MotionState.STANDING, MotionState.HALTED)
            and self._clock.monotonic_s() < deadline_s
        ):
            self._heartbeat_s = self._clock.monotonic_s()
            motion.step(self._seen)
            self._clock.hold(self._clock.monotonic_s() + CALLS_S)
            rest(CYCLE_S)
        self._link.client.leave()

    # --- listening -------------------------------------------------------------------------------------

    def _listen(self) -> None:
        """Read every row, pass it on, and end the process where there are none or the control thread hangs."""
        period_s = 1.0 / self._settings.rate_hz
        try:
            while True:
                row = self._link.read()
                if row is None:
                    self._check_progress()
                    rest(LOOK_S)
                    continue
                self._seen = self._seen.then(row)
                self._clock.hold(row.arrival_s + period_s + MARGIN_S)
                self._send(row)
                rest(max(0.0, period_s - EARLY_S))
        except LinkError as error:
            self.end(error)

    def _check_progress(self) -> None:
        self._link.check()
        now_s = self._clock.monotonic_s()
        silent_s = now_s - self._seen.row.arrival_s
        if silent_s > self._settings.link_timeout_s:
            raise LinkError(
                SilentError,
                f"the controller's time has stood still for {silent_s:.2f} s",
                "is the cable in, and the controller up?",
            )
        if now_s - self._heartbeat_s > self._patience_s:
            raise LinkError(
                SilentError, "the client is blocked in a command", "restart the controller's program"
            )

    def _send(self, message: Status | ArmRow | Opened | LinkError) -> None:
        """Send a message after the queued ones; where the pipe is full, it is queued until the next one."""
        with self._sending:
            self._outbox.append(message)
            if len(self._outbox) > BACKLOG:
                rows = (place for place, waits in enumerate(self._outbox) if isinstance(waits, ArmRow))
                del self._outbox[next(rows, 0)]
            # A program that is gone shows in the control thread, which has an arm to stop yet.
            with suppress(OSError):
                while self._outbox and self._pipe.send(self._outbox[0]):
                    self._outbox.popleft()

    def end(self, error: LinkError) -> None:
        """Report why, and exit, whether or not the report can be sent."""
        self._clock.leave()
        self._pipe.drain(DRAIN_S)
        self._send(error)
        os._exit(1)


def _ask_for_realtime(priority: int) -> bool:
    """First in, first out before all ordinary processes, with the client's threads; where it is allowed.

    On a single core a client that waits busily for its own receiving thread would never let it run.
    """
    if priority == 0 or len(os.sched_getaffinity(0)) < 2:
        return False
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        return True
    return False


def main() -> None:
    """Serve the program at the other end of the file descriptor that the command line names."""
    pipe = Pipe(socket.socket(fileno=int(sys.argv[1])))
    pipe.wait(START_S)
    start = pipe.receive()
    assert isinstance(start, Start)
    ArmProcess(pipe, start).run()
    os._exit(0)


if __name__ == "__main__":
    main()
