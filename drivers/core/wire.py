"""The base of all drivers: statuses and blocks for the loop, one failure report, a link that opens and closes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from drivers.core.clock import Clock
from drivers.core.errors import DeviceError, PortError, ProtocolError, SilentError, check_streams, wrong
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Excite,
    Failed,
    Listen,
    Lost,
    Refused,
    SampleBlock,
    Sent,
    Status,
    Stop,
    Tare,
)

NOT_OPEN = "it is not open"

TURN_S = 0.001
"""Pause between two looks at a link while opening and closing (assumption: a fraction of any answer)."""

OPENING_S = 2.0
"""How long a device that is being opened is given for an answer, at least (assumption: a busy machine delays neither
side by more; nothing moves yet)."""

T = TypeVar("T")


def check_sensor(
    device: str,
    command: Command,
    streams: Iterable[str],
    who: str = "it",
    takes: tuple[type[Command], ...] = (Listen, Tare),
) -> Command:
    """The command, which names the sensor's own streams and is one that it takes.

    Raises:
        CommandError: another command, or another stream.
    """
    if not isinstance(command, takes):
        *others, last = [kind.__name__ for kind in takes]
        can = f"{', '.join(others)} and {last}" if others else last
        raise wrong(device, command, "it has no such command", f"{who} can {can}")
    if isinstance(command, Listen | Tare):
        asked = command.streams if isinstance(command, Listen) else (command.stream,)
        check_streams(device, command, asked, streams)
    return command


class Link(Protocol):
    """The way to a device. A thread of its own may fill its queue; nothing here waits but `close`."""

    @property
    def fault(self) -> str | None:
        """Why it is gone; None while it stands."""

    def receive(self) -> Sequence[Any]:
        """What has arrived since the last call, in order."""

    def close(self) -> None:
        """Close it, end the thread. Never raises; may be called twice."""


LinkT = TypeVar("LinkT", bound=Link)


class Driver:
    """A device on the bench, mock, emulated or real: its name, its clock, and the blocks and statuses that the loop has
    not taken yet.

    Nothing here waits but `open` and `close`. A driver may own one reader thread, which fills a queue and
    does nothing else. The loop calls `read` and `poll` at every turn.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self._clock = clock
        self._failure: str | None = NOT_OPEN  # why it takes no commands
        self._blocks: list[SampleBlock] = []
        self._statuses: list[Status] = []

    def open(self) -> DeviceInfo:
        """Connect, identify, set the device's own limits, move nothing.

        Raises:
            PortError, SilentError, ProtocolError, RefusedError: one line each, with what to do.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Stop what moves, close the port. Never raises; may be called twice."""
        raise NotImplementedError

    def read(self) -> Sequence[SampleBlock]:
        """Blocks that have arrived since the last call, in order for each stream."""
        self._turn()
        blocks, self._blocks = self._blocks, []
        return blocks

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""
        self._turn()
        statuses, self._statuses = self._statuses, []
        return statuses

    def account(self) -> Mapping[str, object]:
        """How the link did so far (frames, losses, drift), for the manifest; empty where there is nothing to report."""
        return {}

    def apply(self, command: Command) -> Command:
        """Queue a command, within a millisecond; its outcome comes from `poll`, under the command's id.

        Returns it as it will be sent: too great a speed is clamped.

        A device that has failed is told nothing any more, but what ends a motion or takes energy away: a `Stop`, and
        `Excite` off, as long as its line stands.

        Raises:
            CommandError: not for this device, not finite or out of range. Nothing was sent.
        """
        if isinstance(command, Listen) and self._listens(command.streams):
            return command
        command = self._valid(command)
        if self._failure is None or (self._stands and _calms(command)):
            self._carry_out(command)
        else:
            self._refuse(command, self._failure)
        return command

    # for subclasses

    def _turn(self) -> None:
        """Process what has arrived, send what is due."""

    def _listens(self, streams: frozenset[str]) -> bool:
        """Take a subscription, open or not; False where it is a command to the device, like any other."""
        return False

    def _valid(self, command: Command) -> Command:
        """The command as it will be sent; raises `CommandError`."""
        raise NotImplementedError

    def _carry_out(self, command: Command) -> None:
        """Begin with a valid command; the device is open. One that has failed gets a `Stop` and `Excite` off alone."""
        raise NotImplementedError

    @property
    def _stands(self) -> bool:
        """Whether a device that has failed can still be told something."""
        return False

    def _forget_session(self) -> None:
        """What an earlier session has left is nobody's: `open` begins without it."""
        self._blocks, self._statuses = [], []

    # reporting

    def _report(self, status: Status) -> None:
        self._statuses.append(status)

    def _sent(self, command: Command, monotonic_s: float | None = None) -> None:
        """A command has left the host, now or at a monotonic time."""
        t_s = self._clock.now() if monotonic_s is None else self._clock.from_monotonic(monotonic_s)
        self._report(Sent(t_s, self.name, command))

    def _lost(self, t_s: float, stream: str, samples: int) -> None:
        self._report(Lost(t_s, self.name, stream, samples))

    def _refuse(self, command: Command, reason: str) -> None:
        self._report(Refused(self._clock.now(), self.name, command, reason))

    def _fail(self, reason: str) -> None:
        """The device can no longer be trusted; only the first failure is reported."""
        if self._failure is None:
            self._failure = reason
            self._report(Failed(self._clock.now(), self.name, reason))


def _calms(command: Command) -> bool:
    """Whether a command only ends a motion, or takes energy away."""
    return isinstance(command, Stop) or (isinstance(command, Excite) and not command.on)


class WireDriver(Driver, Generic[LinkT]):
    """A driver over a link; a device's own adds `_identify`, `_valid`, `_carry_out` and `_update`.

    Args:
        settings: Of the device, and where it is: `XSettings` beside `X`.
        connect: Opens the link, with the same three; raises `PortError`. None is the device's own way, `_opens`.
    """

    _opens: staticmethod[[str, Any, Clock], Any]

    def __init__(
        self,
        name: str,
        settings: Any,
        clock: Clock,
        connect: Callable[[str, Any, Clock], LinkT] | None = None,
    ) -> None:
        super().__init__(name, clock)
        self._settings = settings
        self._connect = connect or self._opens
        self._link: LinkT | None = None
        self._prepare()

    def open(self) -> DeviceInfo:
        """Connect, identify, set the device's own limits, move nothing.

        Raises:
            PortError: the port is absent, busy or was taken away.
            SilentError: nothing answers.
            ProtocolError: what answers is another device.
            RefusedError: it does not take a setting.
        """
        self.close()
        self._forget_session()
        self._forget()
        link = self._link = self._connect(self.name, self._settings, self._clock)
        try:
            info = self._identify(link)
        except BaseException:
            self.close()
            raise
        self._failure = None
        return info

    def close(self) -> None:
        """Stop what moves, close the port. Never raises; may be called twice."""
        link, self._link = self._link, None
        opened, failure, self._failure = self._failure != NOT_OPEN, self._failure, NOT_OPEN
        if link is not None:
            try:
                if opened:
                    self._leave(link, failure)
            finally:
                link.close()

    # for subclasses

    def _prepare(self) -> None:
        """Make what lasts from one `open` to the next."""

    def _forget(self) -> None:
        """Nothing is known of the device: it is being opened."""

    def _identify(self, link: LinkT) -> DeviceInfo:
        """Identify the device, set it up; raises a `DeviceError`."""
        raise NotImplementedError

    def _leave(self, link: LinkT, failure: str | None) -> None:
        """Send the last messages to a device that was open, its stop first; `failure` is why it has failed, or None."""

    def _update(self, link: LinkT) -> str | None:
        """Process what has arrived, send what is due; what is wrong with the device, or None."""
        raise NotImplementedError

    @property
    def _stands(self) -> bool:
        return self._link is not None and self._link.fault is None

    def _turn(self) -> None:
        link = self._link
        if link is not None and self._failure is None:
            fault = self._update(link)
            if link.fault or fault:
                self._fail(link.fault or fault or "")


@dataclass(frozen=True, slots=True)
class Inquiry:
    """Queries to a device while it is being opened, one at a time.

    Attributes:
        timeout_s: When a query is repeated.
        strange: Describes what arrived that was no answer; "" where nothing did.
        stranger: Advice where something did.
        silent: Advice where nothing did.
    """

    device: str
    doing: str
    link: Link
    clock: Clock
    timeout_s: float
    strange: Callable[[], str]
    stranger: str
    silent: str

    def ask(
        self, send: Callable[[], object], parse: Callable[[Any], T | None], patience_s: float = OPENING_S
    ) -> T:
        """Repeat a query until `parse` finds an answer in what is received, for `patience_s` and `OPENING_S` at least.

        Raises:
            PortError: the link is gone.
            SilentError: nothing came.
            ProtocolError: what came is no answer.
        """
        attempts = math.ceil(max(patience_s, OPENING_S) / self.timeout_s)
        for _ in range(attempts):
            send()
            until_s = self.clock.monotonic_s() + self.timeout_s
            while self.clock.monotonic_s() < until_s and self.link.fault is None:
                for received in self.link.receive():
                    answer = parse(received)
                    if answer is not None:
                        return answer
                self.clock.rest(TURN_S)
        raise self._error(attempts * self.timeout_s)

    def _error(self, waited_s: float) -> DeviceError:
        if self.link.fault is not None:
            return PortError(self.device, self.doing, self.link.fault, "is it plugged in and powered?")
        strange = self.strange()
        if strange:
            return ProtocolError(self.device, self.doing, strange, self.stranger)
        return SilentError(self.device, self.doing, f"no answer in {waited_s:g} s", self.silent)
