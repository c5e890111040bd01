"""Any make of arm: its client library runs in a process that can be killed and replaced."""

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import ClassVar

from drivers.arm.axis import Axis
from drivers.arm.commands import valid
from drivers.arm.host import ArmHost
from drivers.arm.link import ArmLink, ArmRow, LinkError, Opened
from drivers.arm.settings import ArmSettings
from drivers.arm.stream import Streams
from drivers.core.clock import Clock
from drivers.core.errors import RefusedError, SilentError, lacking
from drivers.core.messages import Command, DeviceInfo, Stalled, Standstill, Status, Stop
from drivers.core.wire import NOT_OPEN, TURN_S, Driver

SILENCE_S = 0.3
"""How long an opened process may be silent, beyond its own time-out: rows come every 2 ms (assumption)."""

RETRY_S = 0.5
"""Pause before the next attempt to connect (assumption)."""


class ArmDriver(Driver):
    """An arm on an approach axis.

    A client library can block for ever, and can crash: it lives in a process of its own, which moves the arm,
    keeps it inside its bounds, and is killed and replaced when it hangs. The link is judged by the progress of the
    controller's time. Should that process die, the controller's watchdog stops the arm; should this program die, or
    neither `read` nor `poll` an arm that moves for `loop_timeout_s`, the process stops it.

    A lost link is `Stalled`, and is tried again for `reconnect_s`; then the arm has `Failed`. An arm that stopped by
    itself is `Stalled` too: every motion is `Refused` until `Home` has it obey again and go to `start_pose`.

    Streams, at `rate_hz` with the controller's time as device time: `<name>.position` (m along the axis),
    `<name>.pose` (m and rotation vector), `<name>.force` (N and N m on the tool, base frame). A row that the client
    skipped is a jump in the sequence, and `Lost`.

    Attributes:
        link: To its make of controller; a make sets it.
    """

    link: ClassVar[type[ArmLink]]

    @classmethod
    def check_installed(cls, name: str) -> None:
        """See that the client is there, before anything else is started that takes time.

        Args:
            name: Of the device.

        Raises:
            RefusedError: it is not installed.
        """
        package = cls.link.package
        try:
            if package:
                version(package)
        except PackageNotFoundError:
            raise RefusedError(name, "opening", *lacking(package, cls.link.extra)) from None

    def __init__(self, name: str, settings: ArmSettings, clock: Clock) -> None:
        super().__init__(name, clock)
        self._settings = settings
        self._streams = Streams(name, settings, clock)
        self._host: ArmHost | None = None
        self._ready = False
        self._stop: Stop | None = None  # not yet answered by a Standstill
        self._lost_s = 0.0
        self._retry_s = 0.0
        self._reason = ""
        self._turned_s = 0.0
        self._links_lost = 0

    def open(self) -> DeviceInfo:
        """Connect, identify, hold the controller's tool against the profile's, set its watchdog, move nothing.

        Raises:
            PortError: nothing listens there.
            SilentError: the controller accepts the connection and sends nothing.
            ProtocolError: what answers is no controller.
            RefusedError: remote control is off, another program or client holds the arm, it is in a protective
                stop, it counts with another tool than the profile states, or the client is not installed.
        """
        self.close()
        self._forget_session()
        self._streams.begin()
        host = self._started(again=False)
        try:
            opened = self._opened(host)
        except BaseException:
            host.kill()
            raise
        self._host, self._ready, self._failure = host, True, None
        return self._info(opened)

    def close(self) -> None:
        """Stop what moves, end the process. Never raises; may be called twice."""
        if self._host is not None:
            self._host.close()
        self._host, self._ready, self._failure, self._stop = None, False, NOT_OPEN, None
        self._streams.listen(frozenset(), self._clock.monotonic_s())

    def _listens(self, streams: frozenset[str]) -> bool:
        self._streams.listen(streams, self._clock.monotonic_s())
        return True

    def _valid(self, command: Command) -> Command:
        return valid(self.name, self._settings, self._streams.info, command)

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, Stop):
            self._stop = command
        elif not self._ready:
            self._refuse(command, f"{self._reason}; connecting again")
            return
        self._send(command)

    def account(self) -> Mapping[str, object]:
        """Rows that came since it was made, rows that did not, and how often the link was lost."""
        return {"rows": self._streams.rows, "rows_lost": self._streams.missed, "links_lost": self._links_lost}

    # --- opening ---------------------------------------------------------------------------------------

    def _started(self, again: bool) -> ArmHost:
        return ArmHost(self.name, self._settings, self.link, self._clock, again)

    def _opened(self, host: ArmHost) -> Opened:
        deadline_s = self._clock.monotonic_s() + self._settings.open_timeout_s
        while self._clock.monotonic_s() < deadline_s:
            for message in host.receive():
                if isinstance(message, Opened):
                    return message
                if isinstance(message, LinkError):
                    raise message.kind(self.name, "opening", message.reason, message.advice)
            if exit_reason := host.exit_reason():
                raise SilentError(
                    self.name, "opening", exit_reason, "is anything else wrong with this installation?"
                )
            self._clock.rest(TURN_S)
        raise SilentError(
            self.name,
            "opening",
            f"{self._settings.host} accepts the connection and then sends nothing for "
            f"{self._settings.open_timeout_s:g} s",
            "is the controller up, and is it one?",
        )

    def _info(self, opened: Opened) -> DeviceInfo:
        settings = self._settings
        return DeviceInfo(
            self.name,
            model=opened.model,
            serial=opened.serial,
            version=opened.version,
            streams=self._streams.info,
            mover=True,
            clock=f"{self.name} controller",
            details={
                **opened.details,
                "host": settings.host,
                "position_m": Axis(settings).position_m(opened.row.pose),
                "travel_m": (settings.travel_min_m, settings.travel_max_m),
                "max_speed_m_s": settings.max_speed_m_s,
            },
        )

    # --- every turn ------------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Process what has arrived; supervise the process."""
        now_s = self._clock.monotonic_s()
        host = self._host
        if host is not None:
            host.heartbeat()
            rows: list[ArmRow] = []
            for message in host.receive():
                if isinstance(message, ArmRow):
                    rows.append(message)
                else:
                    self._receive(message)
            self._statuses += self._streams.take(rows)
            self._blocks += self._streams.blocks()
        if self._failure is None:
            self._supervise(now_s)
        self._turned_s = now_s

    def _receive(self, message: object) -> None:
        match message:
            case Opened():
                self._ready = True
                if self._stop is not None:
                    self._send(self._stop)
            case LinkError():
                self._lose(message.reason)
            case Status():
                if isinstance(message, Standstill):
                    self._stop = None
                self._report(replace(message, t_s=self._clock.from_monotonic(message.t_s)))

    def _supervise(self, now_s: float) -> None:
        """Replace a process that is gone or hangs, as long as there is time for it."""
        host = self._host
        if not self._ready and self._clock.monotonic_s() - self._lost_s >= self._settings.reconnect_s:
            self._give_up()
        elif host is None:
            if now_s >= self._retry_s:
                self._host = self._started(again=True)
        elif exit_reason := host.exit_reason():
            self._lose(exit_reason)
        elif self._ready:
            # After a slow turn, messages may still be on their way to the queue.
            punctual = now_s - self._turned_s < 0.5 * SILENCE_S
            if punctual and now_s - host.received_s > SILENCE_S + self._settings.link_timeout_s:
                self._lose("the arm's process hangs")

    def _lose(self, reason: str) -> None:
        """The link is gone: end what is left of the process, and connect again."""
        now_s = self._clock.monotonic_s()
        self._drop()
        self._reason = reason
        if self._ready:
            self._ready, self._lost_s, self._retry_s = False, now_s, now_s
            self._links_lost += 1
            self._report(Stalled(self._clock.now(), self.name, f"{reason}; connecting again"))
        else:
            self._retry_s = now_s + RETRY_S

    def _drop(self) -> None:
        if self._host is not None:
            self._host.kill()
            self._host = None

    def _give_up(self) -> None:
        self._drop()
        self._stop = None
        self._fail(f"{self._reason}; is {self._settings.host} up, and the cable in?")

    def _send(self, command: Command) -> None:
        if self._host is not None and self._ready:
            self._host.send(command)
