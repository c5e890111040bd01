"""The person at the bench: asked on the console, or at the far end of a line."""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from drivers.core.clock import Clock
from drivers.core.errors import CodecError, PortError, wrong
from drivers.core.links import LineBuffer, SerialLink, SerialPort, open_serial
from drivers.core.messages import Answered, Ask, Command, DeviceInfo, Loaded, LoadWeight, Refused, StreamInfo
from drivers.core.protocols import Question
from drivers.core.wire import Inquiry, WireDriver
from drivers.operator.codec import BRIDGES, LINE_MAX, decode, encode, request_of, request_text

CONSOLE = "console"
"""The port of a person at the terminal that the program runs in."""

HOW_TO_ANSWER = "then press Enter (n and Enter: it cannot be done)"


class PersonSettings(SerialPort):
    """The person at the bench, and the most that they may be asked to hang on a bridge."""

    port: str = Field(default=CONSOLE, min_length=1)
    """"console", or the path of a serial port or pty with a client behind it."""

    hello_timeout_s: float = Field(default=2.0, gt=0.0, le=60.0)
    """How long the client on a line may take to answer the hello. Assumption: a program answers it, not a person."""

    limit_x_n: float = Field(default=10.0, gt=0.0, le=1000.0)
    """On Fx, N (Fernandez et al., 4.2: never beyond 10 N)."""

    limit_y_n: float = Field(default=10.0, gt=0.0, le=1000.0)
    """On Fy, N (likewise)."""

    limit_t_n: float = Field(default=1.5, gt=0.0, le=1000.0)
    """On Ft, N (4.2: never beyond 1.5 N)."""


class ConsolePerson:
    """The terminal that the program runs in: the answer comes from its keyboard, not over a line."""

    fault = None

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def send(self, data: bytes) -> float:
        """The program asks the question itself."""
        return self._clock.monotonic_s()

    def receive(self) -> list[tuple[float, bytes]]:
        """Nothing."""
        return []

    def close(self) -> None:
        """Nothing to close."""


def open_person(name: str, settings: PersonSettings, clock: Clock) -> SerialLink | ConsolePerson:
    """The way to the person.

    Raises:
        PortError: the console is no terminal, or the line is absent or busy.
    """
    if settings.port != CONSOLE:
        return open_serial(name, settings, clock)
    if sys.stdin is None or not sys.stdin.isatty():
        reason = "no person can answer: standard input is no terminal"
        raise PortError(name, "opening the console", reason, "run it in a terminal, by hand")
    return ConsolePerson(clock)


class Person(WireDriver[SerialLink | ConsolePerson]):
    """Puts requests to a person; implements `drivers.core.protocols.Asking`.

    It answers when the person does; the behavior decides how long that may take. A newer request replaces one that is
    not answered yet. On the console the program itself reads the keyboard (`question`, `answer`), for there is only
    one Enter key.

    The stream `<name>.load` (N; Fx, Fy, Ft) has a sample at each load that the person confirms.
    """

    _settings: PersonSettings
    _opens = staticmethod(open_person)

    def _prepare(self) -> None:
        self._info = StreamInfo(f"{self.name}.load", tuple(BRIDGES.values()), "N", tared=False)
        self._listening = False
        self._loads = 0
        self._number = 0
        self._forget()

    def _forget(self) -> None:
        self._lines = LineBuffer(LINE_MAX)
        self._malformed = 0
        self._asked: Ask | LoadWeight | None = None

    def _identify(self, link: SerialLink | ConsolePerson) -> DeviceInfo:
        on_console = isinstance(link, ConsolePerson)
        who = "the person at the console" if on_console else self._greeted(link)
        return DeviceInfo(self.name, model=who, streams={self._info.name: self._info})

    def _greeted(self, link: SerialLink | ConsolePerson) -> str:
        """Send a hello; returns the identity in its answer. Other input is dropped."""

        def parse(arrived: tuple[float, bytes]) -> str | None:
            return next((one["hello"] for one in self._messages(arrived[1]) if "hello" in one), None)

        advice = 'is their program running? for a person at this terminal write port = "console"'
        inquiry = Inquiry(
            self.name,
            "saying hello",
            link,
            self._clock,
            self._settings.hello_timeout_s,
            strange=lambda: "",
            stranger=advice,
            silent=advice,
        )
        return inquiry.ask(lambda: link.send(encode({"hello": "touchbench"})), parse)

    def close(self) -> None:
        """Withdraw the request, close the line. Never raises; may be called twice."""
        self._asked = None
        super().close()

    def _listens(self, streams: frozenset[str]) -> bool:
        self._listening = self._info.name in streams
        return True

    def _valid(self, command: Command) -> Command:
        match command:
            case Ask(request=request):
                if not request.strip():
                    raise wrong(self.name, command, "it has no text", "write what is to be done")
            case LoadWeight(bridge=bridge, force_n=force_n):
                if bridge not in BRIDGES:
                    advice = f"choose one of {', '.join(BRIDGES)}"
                    raise wrong(self.name, command, f"there is no bridge {bridge}", advice)
                limit_n = getattr(self._settings, f"limit_{bridge}_n")
                # Written so that NaN is out of range too.
                if not 0.0 <= force_n <= limit_n:
                    reason = f"{force_n:g} N on {BRIDGES[bridge]} is out of range"
                    raise wrong(self.name, command, reason, f"choose from 0 to {limit_n:g} N")
            case _:
                raise wrong(
                    self.name, command, "a person has no such command", "a person can Ask and LoadWeight"
                )
        return command

    def _carry_out(self, command: Command) -> None:
        assert self._link is not None
        assert isinstance(command, Ask | LoadWeight)
        self._number += 1
        self._asked = command
        sent_s = self._link.send(encode(request_of(self._number, command)))
        if sent_s is None:
            self._fail(self._link.fault or "the line is closed")
        else:
            self._sent(command, sent_s)

    @property
    def question(self) -> Question | None:
        """What the console has to ask, or None; see `drivers.core.protocols.Asking`."""
        if self._asked is None or not isinstance(self._link, ConsolePerson):
            return None
        return Question(self._number, f"{request_text(self._asked)}, {HOW_TO_ANSWER}")

    def answer(self, number: int, done: bool) -> None:
        """The person has answered on the console; see `drivers.core.protocols.Asking`."""
        self._settle(self._clock.now(), number, "" if done else "the person says no", done)

    def account(self) -> Mapping[str, object]:
        """Numbers of requests and of malformed lines."""
        return {"requests": self._number, "malformed_lines": self._malformed + self._lines.dropped}

    def _update(self, link: SerialLink | ConsolePerson) -> None:
        for arrival_s, data in link.receive():
            for message in self._messages(data):
                if "answer" in message:
                    t_s = self._clock.from_monotonic(arrival_s)
                    self._settle(t_s, message["answer"], message["reason"], message["done"])

    def _messages(self, data: bytes) -> list[dict[str, Any]]:
        """Messages that are whole now, in order; other lines are counted and dropped."""
        messages = []
        for line in self._lines.feed(data):
            try:
                messages.append(decode(line))
            except CodecError:
                self._malformed += 1
        return messages

    def _settle(self, t_s: float, number: int, reason: str, done: bool) -> None:
        if self._asked is None or number != self._number:
            return
        asked, self._asked = self._asked, None
        if not done:
            self._report(Refused(t_s, self.name, asked, reason or "no reason given"))
        elif isinstance(asked, LoadWeight):
            if self._listening:
                values = np.array([[asked.force_n if bridge == asked.bridge else 0.0 for bridge in BRIDGES]])
                times_s = np.array([t_s])
                self._blocks.append(
                    self._info.block(
                        self._loads, t_s, values, times_s=times_s, device_t0_s=t_s, arrival_s=t_s
                    )
                )
            self._loads += 1
            self._report(Loaded(t_s, self.name, asked.bridge, asked.force_n, command_id=asked.id))
        else:
            self._report(Answered(t_s, self.name, asked.request, command_id=asked.id))

    def _fail(self, reason: str) -> None:
        self._asked = None
        super()._fail(reason)


__all__ = ["Person", "PersonSettings"]
