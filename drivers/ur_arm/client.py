"""The ur_rtde client's control interface, as commands use it. Lives in the arm's process, in one thread.

Only calls that come back within a few cycles are made: tool speeds, asynchronous moves, and the short blocking ones
(`zeroFtSensor`, `speedStop` of an arm that stands, `setWatchdog`). Every vector has been checked before.
"""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from drivers.arm.link import CALLS_S, ArmRow, LinkError
from drivers.arm.settings import Pose
from drivers.core.clock import Clock, rest
from drivers.core.errors import RefusedError, SilentError
from drivers.ur_arm.dashboard import Dashboard
from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import Tool

SPEED_S = 0.002
"""The `t` of `speedl`: after one cycle of the controller the script looks for a newer speed (control script)."""

SPEED_STOP_M_S2 = 3.0
"""Deceleration of `speedStop`; the tool stands already when it is called."""

LOOK_S = 0.05
"""Time between two looks at the controller while it recovers (assumption)."""

CONTROL_GONE = "the control link is gone"

RTDE_PORT = 30004
"""Where a controller serves RTDE (RTDE guide)."""


class RtdeSockets:
    """This process's connections to an RTDE port, known by their sockets.

    The client connects again by itself within milliseconds, and may crash at it. A busy machine can hide those
    milliseconds from a caller that asks the client; a new connection has a new socket for good.

    Args:
        others: Whose connections these are not.
    """

    def __init__(self, *others: RtdeSockets) -> None:
        theirs = {number for other in others for number, _ in other._sockets}
        self._sockets: list[tuple[int, int]] = [one for one in _rtde_sockets() if one[0] not in theirs]

    def stands(self) -> bool:
        """Whether all of them are the ones of the start. Cheap: a system call for each."""
        try:
            return all(os.fstat(number).st_ino == inode for number, inode in self._sockets)
        except OSError:
            return False


def _rtde_sockets() -> Iterator[tuple[int, int]]:
    """Each connection's file descriptor and inode."""
    for number in [int(entry.name) for entry in Path("/proc/self/fd").iterdir()]:
        try:
            status = os.fstat(number)
            if not stat.S_ISSOCK(status.st_mode):
                continue
            with socket.socket(fileno=os.dup(number)) as one:
                peer = one.getpeername()
        except OSError:  # it has gone meanwhile, or is not connected
            continue
        if one.family == socket.AF_INET and peer[1] == RTDE_PORT:
            yield number, status.st_ino


class RtdeClient:
    """The control interface of one arm; see `drivers.arm.link.Client`.

    Attributes:
        tcp_offset: The tool's point in the flange's frame, as the controller has it: m and rotation vector.

    Raises:
        LinkError: the client does not connect, or the controller does not run its script.
    """

    def __init__(
        self,
        settings: UrArmSettings,
        dashboard: Dashboard,
        clock: Clock,
        latest: Callable[[], ArmRow],
        receiving: RtdeSockets,
    ) -> None:
        from rtde_control import RTDEControlInterface

        self._settings = settings
        self._dashboard = dashboard
        self._clock = clock
        self._latest = latest
        self._speeds = False
        self._tools: tuple[Tool, Tool] | None = None  # the controller's own, and the profile's
        try:
            self._control = RTDEControlInterface(settings.host)
        except (RuntimeError, ValueError) as error:
            raise LinkError(RefusedError, f"the client reports: {error}", _advice(str(error))) from error
        self._link = RtdeSockets(receiving)
        self.tcp_offset = self._asked_tcp()
        self._watch()  # from here on commands are due

    def mount(self, tool: Tool, found: Tool) -> None:
        """Have the controller count with a tool; `leave` gives back what was found."""
        self._tools = found, tool
        self._set_tool(tool)
        self.tcp_offset = self._asked_tcp()

    def speed(self, twist: Pose, acceleration_m_s2: float) -> bool:
        """See `Client.speed`."""
        self._speeds = True
        return bool(self._live.speedL(list(twist), acceleration_m_s2, SPEED_S))

    def end_speed(self) -> bool:
        """See `Client.end_speed`."""
        self._speeds = False
        return bool(self._live.speedStop(SPEED_STOP_M_S2))

    def move(self, pose: Pose, speed_m_s: float, acceleration_m_s2: float) -> bool:
        """See `Client.move`."""
        # A second mover ends the controller's program: this one call is the last to be sure.
        assert not self._speeds, "a move while tool speeds are on"
        return bool(self._live.moveL(list(pose), speed_m_s, acceleration_m_s2, True))

    def end_move(self, deceleration_m_s2: float) -> bool:
        """See `Client.end_move`."""
        self._live.stopL(deceleration_m_s2, True)
        return True

    def busy(self) -> bool:
        """See `Client.busy`."""
        return bool(self._control.getAsyncOperationProgressEx().isAsyncOperationRunning())

    def feed_watchdog(self) -> bool:
        """See `Client.feed_watchdog`."""
        return bool(self._live.kickWatchdog())

    def tare(self) -> bool:
        """See `Client.tare`."""
        return bool(self._live.zeroFtSensor())

    def lead(self, on: bool) -> bool:
        """See `Client.lead`."""
        return bool(self._live.teachMode() if on else self._live.endTeachMode())

    def halt(self) -> None:
        """See `Client.halt`."""
        self._dashboard.ask("stop")

    def recover(self) -> str:
        """See `Client.recover`."""
        control = self._live
        self._clock.leave()  # it may take long
        self._speeds = False
        deadline_s = self._clock.monotonic_s() + self._settings.recover_s
        if reason := self._unlock(deadline_s):
            return reason
        if self._dashboard.ask("is in remote control") == "false":
            return "remote control is off at the pendant"
        # The registers outlive the program: a speed that is left in them would move the arm as soon as the
        # script runs again. Where no program runs, this clears them.
        control.kickWatchdog()
        control.reuploadScript()
        while not self._latest().running:
            if self._clock.monotonic_s() > deadline_s:
                return self._latest().fault or "the controller does not run the script"
            rest(LOOK_S)
        self._watch()
        if self._tools is not None:
            self._set_tool(self._tools[1])
        return ""

    def connected(self) -> bool:
        """Whether the control link stands; the one call that another thread may make too."""
        return self._link.stands() and bool(self._control.isConnected())

    def leave(self) -> None:
        """See `Client.leave`; the client's sockets end with the process."""
        if self._tools is not None and self.connected():
            self._set_tool(self._tools[0])
        self._control.stopScript()

    def _unlock(self, deadline_s: float) -> str:
        while (reason := self._latest().fault) not in ("", STOPPED):
            if reason != PROTECTIVE_STOP or self._clock.monotonic_s() > deadline_s:
                return reason
            self._dashboard.ask("close safety popup")
            self._dashboard.ask("unlock protective stop")
            rest(LOOK_S)
        return ""

    def _asked_tcp(self) -> Pose:
        x, y, z, rx, ry, rz = self._control.getTCPOffset()
        return x, y, z, rx, ry, rz

    def _set_tool(self, tool: Tool) -> None:
        self._control.setTcp(list(tool.tcp_offset))
        self._control.setPayload(tool.payload_kg, list(tool.payload_cog_m))

    def _watch(self) -> None:
        # The watchdog counts from here, and this thread looks at the clock again within the calls of a cycle.
        self._clock.hold(self._clock.monotonic_s() + CALLS_S)
        if not self._control.setWatchdog(self._settings.watchdog_hz):
            # The script did not answer and takes no order to end: left running, it would have the next opening
            # refused.
            self.halt()
            advice = "is it in remote control, and this machine not overloaded?"
            raise LinkError(RefusedError, "the controller takes no watchdog", advice)

    @property
    def _live(self) -> Any:
        """The control interface, whose link stands."""
        if not self.connected():
            raise LinkError(SilentError, CONTROL_GONE, "is the cable in, and the controller up?")
        return self._control


def _advice(error: str) -> str:
    if "already in use" in error:
        return "another program holds the arm; end it, or switch off the fieldbus adapters at the pendant"
    if "start control script" in error:
        return "is the arm in remote control, and its brakes released?"
    return "is the controller in remote control, and nothing else connected to it?"


PLAYING = 2
"""`runtime_state` of a running program (RTDE guide)."""

PROTECTIVE_STOP = "the arm is in a protective stop"

STOPPED = "the controller's program has stopped"

SAFETY = {
    7: "the emergency stop is pressed",
    6: "the robot's emergency stop is pressed",
    5: "the system's emergency stop is pressed",
    9: "the arm reports a fault",
    8: "the arm reports a safety violation",
    4: "the safeguard stop is on",
    2: PROTECTIVE_STOP,
}
"""Bits of `safety_status_bits` that forbid motion, gravest first (RTDE guide)."""


def fault_of(safety_bits: int, running: bool) -> str:
    """Why the arm will not move, or "": a safety function, else its program has stopped."""
    danger = next((reason for bit, reason in SAFETY.items() if safety_bits >> bit & 1), "")
    return danger or ("" if running else STOPPED)
