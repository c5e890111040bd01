"""The link to a UR controller through ur_rtde and the dashboard: rows, and what is checked before anything moves."""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import ClassVar

from drivers.arm.link import LOOK_S, ArmRow, LinkError, Opened
from drivers.core.clock import Clock, rest
from drivers.core.errors import PortError, RefusedError, SilentError
from drivers.ur_arm.client import CONTROL_GONE, PLAYING, STOPPED, RtdeClient, RtdeSockets, fault_of
from drivers.ur_arm.dashboard import Dashboard
from drivers.ur_arm.limits import joint_limits
from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import PENDANT, Tool, disagreement, stated

VARIABLES = [
    "timestamp",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "safety_status_bits",
    "runtime_state",
    "target_speed_fraction",
    "payload",
    "payload_cog",
]
"""What the controller sends in each row; a short list is cheap for the client to parse."""

ROWS = 10
"""Rows that tell the rate: the client may skip some (assumption)."""

SETTLED_S = 1.0
"""How long the controller may take to become as expected while connecting: a program of a host that died ends by
its watchdog, which is slower than anything else."""

UP = "is the cable in, and the controller up?"


class UrLink:
    """Implements `drivers.arm.link.ArmLink`: the receive interface here, the control interface as `client`."""

    package: ClassVar[str] = "ur_rtde"
    extra: ClassVar[str] = "ur"
    client: RtdeClient

    def __init__(self, settings: UrArmSettings, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._row = ArmRow(0.0, 0.0, (0.0,) * 6, (0.0,) * 6, (0.0,) * 6, STOPPED, running=False)

    def open(self, again: bool) -> Opened:
        """See `ArmLink.open`."""
        dashboard = Dashboard(self._settings.host)
        polyscope = _checked_version(dashboard)
        limits = joint_limits(self._settings.host)  # before its program needs anybody
        self._connect()
        self._check_readiness(dashboard, again)
        model, serial = dashboard.ask("get robot model"), dashboard.ask("get serial number")
        if self._settings.model not in ("", model):
            raise LinkError(
                RefusedError,
                f"it is a {model}, the profile's model is {self._settings.model}",
                "is it the right arm? correct port or model",
            )
        self.client = RtdeClient(self._settings, dashboard, self._clock, lambda: self._row, self._sockets)
        self._await_row(lambda: self._row.running)
        details = {
            **self._checked_tool(),
            "watchdog_hz": self._settings.watchdog_hz,
            "remote_control": dashboard.ask("is in remote control"),
            "robot_mode": dashboard.ask("robotmode").rpartition(" ")[2],
            "safety_status": dashboard.ask("safetystatus").rpartition(" ")[2],
            "speed_slider": self._receive.getTargetSpeedFraction(),
            **limits,
        }
        return Opened(model, serial, polyscope, self._row, details)

    def read(self) -> ArmRow | None:
        """See `ArmLink.read`; a row that is torn by the next is none."""
        receive = self._receive
        device_s = receive.getTimestamp()
        if device_s == self._row.device_s:
            return None
        arrival_s = self._clock.monotonic_s()
        running = receive.getRuntimeState() == PLAYING
        row = ArmRow(
            arrival_s,
            device_s,
            tuple(receive.getActualTCPPose()),
            tuple(receive.getActualTCPSpeed()),
            tuple(receive.getActualTCPForce()),
            fault_of(receive.getSafetyStatusBits(), running),
            running,
        )
        if receive.getTimestamp() != device_s:
            return None
        self._row = row
        return row

    def check(self) -> None:
        """See `ArmLink.check`."""
        receiving = self._sockets.stands() and self._receive.isConnected()
        if not (receiving and self.client.connected()):
            raise LinkError(SilentError, CONTROL_GONE if receiving else "the receive link is gone", UP)

    def _connect(self) -> None:
        from rtde_receive import RTDEReceiveInterface

        host = self._settings.host
        try:
            self._receive = RTDEReceiveInterface(host, self._settings.rate_hz, VARIABLES)
        except RuntimeError as error:
            raise LinkError(
                PortError, f"the client reports: {error}", "is the controller on, and is the address right?"
            ) from error
        if not self._receive.isConnected() or self._receive.getTimestamp() == 0.0:
            raise LinkError(
                SilentError,
                f"no data come from {host}",
                "is the controller up, and RTDE switched on at the pendant?",
            )
        self._sockets = RtdeSockets()
        self._check_rate()

    def _check_rate(self) -> None:
        """At a wrong rate every row would count as one after a loss."""
        times_s: list[float] = []
        rate_hz = self._settings.rate_hz
        period_s, deadline_s = math.inf, self._clock.monotonic_s() + SETTLED_S
        # A busy machine misses rows: it is given longer to see two that follow each other.
        while len(times_s) < ROWS or (period_s * rate_hz > 1.5 and self._clock.monotonic_s() < deadline_s):
            if not self._await_row(lambda: True):
                break
            times_s.append(self._row.device_s)
            self._clock.hold(self._row.arrival_s + 1.0 / rate_hz)
            period_s = min((later - one for one, later in pairwise(times_s)), default=1.0 / rate_hz)
        self._clock.leave()
        if times_s and abs(period_s * rate_hz - 1.0) > 0.5:
            raise LinkError(
                RefusedError,
                f"its rows come {1.0 / period_s:.4g} times a second, not {rate_hz:g}",
                f"set rate_hz = {1.0 / period_s:.4g}",
            )

    def _check_readiness(self, dashboard: Dashboard, again: bool) -> None:
        if dashboard.ask("is in remote control") == "false":
            raise LinkError(RefusedError, "remote control is off", "switch it on at the pendant")
        if (reason := self._row.fault) not in ("", STOPPED):
            raise LinkError(RefusedError, reason, "look at the arm, and release it at the pendant")
        if again and self._row.running:
            dashboard.ask("stop")
        if not self._await_row(lambda: not self._row.running):
            if not self._row.running:
                raise LinkError(
                    SilentError,
                    f"no row came in {SETTLED_S:g} s",
                    "is the controller up, and this machine not overloaded?",
                )
            raise LinkError(
                RefusedError, "another program runs on the controller", "stop it at the pendant, or its host"
            )

    def _checked_tool(self) -> Mapping[str, object]:
        settings, found = self._settings, self._tool()
        changed = settings.tool == "set" and disagreement(settings, found) != ""
        if changed:
            self.client.mount(stated(settings, found), found)
            self._await_row(lambda: disagreement(settings, self._tool()) == "")
        tool = self._tool()
        if reason := disagreement(settings, tool):
            self.client.leave()
            raise LinkError(RefusedError, reason, PENDANT)
        return {**tool.details(settings), **({"tool_found": found._asdict()} if changed else {})}

    def _tool(self) -> Tool:
        x, y, z = self._receive.getPayloadCog()
        return Tool(self.client.tcp_offset, self._receive.getPayload(), (x, y, z))

    def _await_row(self, wanted: Callable[[], bool]) -> bool:
        """Read rows until one is as wanted; False where none came in time."""
        deadline_s = self._clock.monotonic_s() + SETTLED_S
        while not (self.read() and wanted()):
            if self._clock.monotonic_s() > deadline_s:
                return False
            rest(LOOK_S)
        return True


def _checked_version(dashboard: Dashboard) -> str:
    found = dashboard.version()
    major, minor = (int(part) for part in (found or "0.0").split(".")[:2])
    if major != 5 or minor < 6:
        raise LinkError(
            RefusedError,
            f"PolyScope {found or 'of unknown version'} is not supported",
            "it takes 5.6 or a later 5.x",
        )
    return found
