"""The arm's process: `python -m drivers.ur_arm.child FD`. It may hang, crash or be killed; the program may not.

Two threads, each with the ur_rtde object that it alone uses: this one the control interface, and the listener the
receive interface, so that no sample is missed while a command is under way. Their messages are queued while the pipe is
full: a program that is slow to read must not keep the controller from its watchdog. The process ends without
destroying those objects, for their destructors wait, and some abort.

On an emulated bench both threads take part in its time (`drivers.bench_clock`).
"""

from __future__ import annotations

import os
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version

from drivers.bench_clock import LOOK_S as BENCH_LOOK_S
from drivers.bench_clock import BenchClock, ClockPage
from drivers.clock import Clock, WallClock, rest
from drivers.messages import Command, Home, Status, Stop
from drivers.ur_arm.client import CALLS_S, CONTROL_GONE, RtdeClient, RtdeSockets
from drivers.ur_arm.controller import PLAYING, Seen, still, trouble
from drivers.ur_arm.dashboard import Dashboard
from drivers.ur_arm.guidance import CYCLE_S
from drivers.ur_arm.motion import Conductor, MotionState
from drivers.ur_arm.pipe import ArmRow, Broken, BrokenError, Opened, Pipe, Start
from drivers.ur_arm.settings import UrArmSettings

VARIABLES = [
    "timestamp",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "safety_status_bits",
    "runtime_state",
]
"""What the controller sends in each of its cycles; a short list is cheap for the client to parse."""

RATE_HZ = 500.0
"""An e-Series controller's cycle (RTDE guide)."""

LOOK_S = 0.0004
"""Time between two looks for a new row that is due: a fifth of the controller's cycle."""

PAUSE_S = 0.0014
"""Pause after a row: the next one is not due before 2 ms, but the last look may have been late by `LOOK_S`."""

NEXT_ROW_S = 0.00225
"""How far an emulated bench's time may go after a row, before the next one was seen: a cycle, and an eighth of one. So
none is lost, for the client keeps the latest alone."""

STUCK_S = 1.0
"""How long one command may take before the client counts as blocked: a hundred times the longest (measured)."""

SETTLED_S = 1.0
"""How long the controller may take to become as expected while connecting: a program of a host that died ends by
its watchdog, which is slower than anything else."""

BACKLOG = 2500
"""Messages that wait for a program which does not read: five seconds of rows, longer than any start of a trial."""

DRAIN_S = 0.1
"""How long the last message may wait for room in the pipe (assumption)."""

START_S = 10.0
"""Longest wait for the program's first message (assumption)."""

LEAVE_S = 2.0
"""How long the arm may take to stand when the host is gone (assumption)."""


class ArmProcess:
    """Both threads' common ground.

    Args:
        pipe: To the program.
        turns: Counts the turns of the program's loop: an `eventfd` that does not block.
        name: Of the device.
        settings: Of the arm.
        clock: Whose monotonic times go through the pipe.
    """

    def __init__(self, pipe: Pipe, turns: int, name: str, settings: UrArmSettings, clock: Clock) -> None:
        self._pipe = pipe
        self._clock = clock
        self._turns = turns
        self._name = name
        self._settings = settings
        self._outbox: deque[Status | ArmRow | Opened | Broken] = deque()
        self._sending = threading.Lock()
        self._heartbeat_s = self._clock.monotonic_s()
        self._patience_s = STUCK_S
        self._row = ArmRow(0.0, 0.0, (0.0,) * 6, (0.0,) * 6, (0.0,) * 6, 0, 0)
        self._still_since_s = self._clock.monotonic_s()

    def run(self, again: bool) -> None:
        """Connect, then obey until the program is gone.

        Args:
            again: Whether this replaces a process that died: a program that still runs is then our own.

        Raises:
            BrokenError: something is beyond repair.
        """
        settings = self._settings
        # An emulated bench waits for this process: nothing is to be scheduled before the loop there.
        realtime = not self._clock.path and _ask_for_realtime(settings.realtime_priority)
        dashboard = Dashboard(settings.host)
        polyscope = _checked_version(dashboard)
        self._connect_receive()
        self._check_readiness(dashboard, again)
        opened = Opened(
            model=dashboard.ask("get robot model"),
            serial=dashboard.ask("get serial number"),
            version=polyscope,
            pose=self._row.pose,
            details={"client": f"ur_rtde {version('ur_rtde')}", "realtime": realtime},
        )
        client = RtdeClient(settings, dashboard, self._clock, lambda: self._row, self._link)
        self._await_row(lambda row: row.runtime == PLAYING)
        self._heartbeat_s = self._clock.monotonic_s()
        threading.Thread(target=self._listen, args=(client,), name="listener", daemon=True).start()
        self._send(opened)
        self._obey(client)

    # --- control ---------------------------------------------------------------------------------------

    def _obey(self, client: RtdeClient) -> None:
        conductor = Conductor(
            self._name, self._settings, client, self._clock.monotonic_s, self._send, self._seen()
        )
        due_s = self._clock.monotonic_s()
        while True:
            due_s = max(due_s + CYCLE_S, self._clock.monotonic_s())
            self._heartbeat_s = self._clock.monotonic_s()
            try:
                # However late the cycle is, it takes the program's commands.
                self._take(conductor)
                while self._await_command(due_s):
                    self._take(conductor)
            except EOFError:
                self._leave(client, conductor)
                return
            if self._clock.monotonic_s() - self._row.arrival_s > 2.0 * self._settings.link_timeout_s:
                raise BrokenError("silent", "no rows come through", "is the program still listening?")
            with suppress(BlockingIOError):  # not a turn since the last look
                os.eventfd_read(self._turns)
                conductor.lead()
            conductor.step(self._seen())

    def _await_command(self, due_s: float) -> bool:
        """Wait until the cycle is due; whether a command has arrived before."""
        self._clock.hold(due_s + CALLS_S)
        while (wait_s := due_s - self._clock.monotonic_s()) > 0.0:
            if self._pipe.wait(max(wait_s, BENCH_LOOK_S)):
                return True
        return False

    def _take(self, conductor: Conductor) -> None:
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
                conductor.pass_over(command)
                continue
            # A recovery takes its time, within its own deadline.
            self._patience_s = STUCK_S + self._settings.recover_s * isinstance(command, Home)
            conductor.order(command)
            self._patience_s, self._heartbeat_s = STUCK_S, self._clock.monotonic_s()

    def _leave(self, client: RtdeClient, conductor: Conductor) -> None:
        """The program is gone: stop the arm, wait until it stands, end the controller's program."""
        conductor.order(Stop(self._name))
        deadline_s = self._clock.monotonic_s() + LEAVE_S
        while (
            conductor.state not in (MotionState.STANDING, MotionState.HALTED)
            and self._clock.monotonic_s() < deadline_s
        ):
            self._heartbeat_s = self._clock.monotonic_s()
            conductor.step(self._seen())
            self._clock.hold(self._clock.monotonic_s() + CALLS_S)
            rest(CYCLE_S)
        client.leave()

    def _seen(self) -> Seen:
        return Seen(self._row, self._still_since_s)

    # --- opening ---------------------------------------------------------------------------------------

    def _connect_receive(self) -> None:
        from rtde_receive import RTDEReceiveInterface

        host = self._settings.host
        try:
            self._receive = RTDEReceiveInterface(host, RATE_HZ, VARIABLES)
        except RuntimeError as error:
            raise BrokenError(
                "port", f"the client reports: {error}", "is the controller on, and is the address right?"
            ) from error
        if not self._receive.isConnected() or self._receive.getTimestamp() == 0.0:
            raise BrokenError(
                "silent",
                f"no data come from {host}",
                "is the controller up, and RTDE switched on at the pendant?",
            )
        self._link = RtdeSockets()
        self._await_row(lambda row: True)

    def _check_readiness(self, dashboard: Dashboard, again: bool) -> None:
        if dashboard.ask("is in remote control") == "false":
            raise BrokenError("refused", "remote control is off", "switch it on at the pendant")
        reason = trouble(self._row._replace(runtime=PLAYING))
        if reason:
            raise BrokenError("refused", reason, "look at the arm, and release it at the pendant")
        if again and self._row.runtime == PLAYING:
            dashboard.ask("stop")
        if not self._await_row(lambda row: row.runtime != PLAYING):
            raise BrokenError(
                "refused", "another program runs on the controller", "stop it at the pendant, or its host"
            )

    def _await_row(self, wanted: Callable[[ArmRow], bool]) -> bool:
        """Read rows until one is as wanted; False where none came in time."""
        deadline_s = self._clock.monotonic_s() + SETTLED_S
        while not (self._read_row() and wanted(self._row)):
            if self._clock.monotonic_s() > deadline_s:
                return False
            rest(LOOK_S)
        return True

    # --- listening -------------------------------------------------------------------------------------

    def _listen(self, client: RtdeClient) -> None:
        """Read every row, pass it on, and end the process where there are none or the control thread hangs."""
        try:
            while True:
                if self._read_row():
                    self._clock.hold(self._row.arrival_s + NEXT_ROW_S)
                    self._send(self._row)
                    if len(self._outbox) > BACKLOG:
                        raise BrokenError(
                            "silent", "the program does not read what it sends", "is this machine overloaded?"
                        )
                    rest(PAUSE_S)
                else:
                    self._check_progress(client)
                    rest(LOOK_S)
        except BrokenError as error:
            self.end(error.broken)

    def _read_row(self) -> bool:
        """Read a new row, if there is one that is not torn by the next."""
        receive = self._receive
        device_s = receive.getTimestamp()
        if device_s == self._row.device_s:
            return False
        row = ArmRow(
            self._clock.monotonic_s(),
            device_s,
            tuple(receive.getActualTCPPose()),
            tuple(receive.getActualTCPSpeed()),
            tuple(receive.getActualTCPForce()),
            receive.getSafetyStatusBits(),
            receive.getRuntimeState(),
        )
        if receive.getTimestamp() != device_s:
            return False
        if not still(row.twist):
            self._still_since_s = float("inf")
        elif self._still_since_s == float("inf"):
            self._still_since_s = row.arrival_s
        self._row = row
        return True

    def _check_progress(self, client: RtdeClient) -> None:
        receiving = self._link.stands() and self._receive.isConnected()
        if not (receiving and client.connected()):
            reason = CONTROL_GONE if receiving else "the receive link is gone"
            raise BrokenError("silent", reason, "is the cable in, and the controller up?")
        silent_s = self._clock.monotonic_s() - self._row.arrival_s
        if silent_s > self._settings.link_timeout_s:
            raise BrokenError(
                "silent",
                f"the controller's time has stood still for {silent_s:.2f} s",
                "is the cable in, and the controller up?",
            )
        if self._clock.monotonic_s() - self._heartbeat_s > self._patience_s:
            raise BrokenError(
                "silent", "the client is blocked in a command", "restart the controller's program"
            )

    def _send(self, message: Status | ArmRow | Opened | Broken) -> None:
        """Send a message after the queued ones; where the pipe is full, it is queued until the next one."""
        with self._sending:
            self._outbox.append(message)
            # A program that is gone shows in the control thread, which has an arm to stop yet.
            with suppress(OSError):
                while self._outbox and self._pipe.send(self._outbox[0]):
                    self._outbox.popleft()

    def end(self, broken: Broken) -> None:
        """Report why, and exit, whether or not the report can be sent."""
        self._clock.leave()
        self._pipe.drain(DRAIN_S)
        self._send(broken)
        os._exit(1)


def _checked_version(dashboard: Dashboard) -> str:
    found = dashboard.version()
    major, minor = (int(part) for part in (found or "0.0").split(".")[:2])
    if major != 5 or minor < 6:
        raise BrokenError(
            "refused",
            f"PolyScope {found or 'of unknown version'} is not supported",
            "it takes 5.6 or a later 5.x",
        )
    return found


def _ask_for_realtime(priority: int) -> bool:
    """First in, first out before all ordinary processes, with the client's threads; where it is allowed.

    On a single core the client would wait for its own receiving thread, busily, and never let it run.
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
    clock = BenchClock(ClockPage(start.clock)) if start.clock else WallClock()
    settings = UrArmSettings.model_validate_json(start.settings)
    process = ArmProcess(pipe, start.turns, start.name, settings, clock)
    try:
        process.run(start.again)
    except BrokenError as error:
        process.end(error.broken)
    except ImportError as error:
        process.end(Broken("refused", f"the client is missing ({error})", "pip install ur_rtde"))
    except Exception as error:
        # Whatever it is, it is reported to the program, which goes on.
        process.end(Broken("protocol", f"{type(error).__name__}: {error}", "report this with the recording"))
    os._exit(0)


if __name__ == "__main__":
    main()
