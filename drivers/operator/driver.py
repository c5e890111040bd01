"""The person at the bench: asked on the console, or at the far end of a line."""

from __future__ import annotations

import sys
from collections.abc import Mapping

from pydantic import Field

from drivers.core.clock import Clock
from drivers.core.errors import PortError
from drivers.core.links import SerialLink, SerialPort, open_serial
from drivers.core.messages import (
    Answered,
    Applied,
    Ask,
    Command,
    DeviceInfo,
    Listen,
    Loaded,
    LoadWeight,
    Refused,
)
from drivers.core.protocols import Question
from drivers.core.wire import Inquiry, WireDriver
from drivers.operator.codec import LineDecoder, PersonAnswer, PersonHello, encode, request_of
from drivers.operator.requests import LoadLimits, Loads, load_stream, request_text, valid

CONSOLE = "console"
"""The port of a person at the terminal that the program runs in."""

HOW_TO_ANSWER = "then press Enter (n and Enter: it cannot be done)"


class PersonSettings(SerialPort, LoadLimits):
    """The person at the bench."""

    port: str = Field(default=CONSOLE, min_length=1)
    """"console", or the path of a serial port or pty with a client behind it."""

    hello_timeout_s: float = Field(default=2.0, gt=0.0, le=60.0)
    """How long the client on a line may take to answer the hello. Assumption: a program answers it, not a person."""


class ConsolePerson:
    """The terminal that the program runs in: the answer comes from its keyboard, not over a line.

    Args:
        clock: Gives monotonic time.
    """

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
    """Puts requests to a person; implements `drivers.core.protocols.Device` and `Asking`.

    It answers when the person does; the behavior decides how long that may take. A newer request replaces one that is
    not answered yet. On the console the program itself reads the keyboard (`question`, `answer`), for there is only
    one Enter key.
    """

    _settings: PersonSettings
    _opens = staticmethod(open_person)

    def _prepare(self) -> None:
        self._loads = Loads(self.name)
        self._number = 0
        self._forget()

    def _forget(self) -> None:
        self._decoder = LineDecoder()
        self._asked: Ask | LoadWeight | None = None

    def _identify(self, link: SerialLink | ConsolePerson) -> DeviceInfo:
        on_console = isinstance(link, ConsolePerson)
        info = load_stream(self.name)
        who = "the person at the console" if on_console else self._greeted(link)
        return DeviceInfo(self.name, model=who, streams={info.name: info})

    def _greeted(self, link: SerialLink | ConsolePerson) -> str:
        """Send a hello; returns the identity in its answer. Other input is dropped."""

        def parse(arrived: tuple[float, bytes]) -> str | None:
            messages = self._decoder.feed(arrived[1])
            return next((message.who for message in messages if isinstance(message, PersonHello)), None)

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
        return inquiry.ask(lambda: link.send(encode(PersonHello("touchbench"))), parse, attempts=1)

    def close(self) -> None:
        """Withdraw the request, close the line. Never raises; may be called twice."""
        self._asked = None
        super().close()

    def apply(self, command: Command) -> Applied:
        """Put a request to the person.

        Raises:
            CommandError: not for a person, or a load that the sensor does not bear.
        """
        if isinstance(command, Listen):
            self._loads.listen(command.streams)
            return Applied(command, self._clock.now())
        return super().apply(command)

    def _valid(self, command: Command) -> Command:
        return valid(self.name, self._settings, command)

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
        self._settle(self._clock.now(), PersonAnswer(number, done, "" if done else "the person says no"))

    def account(self) -> Mapping[str, object]:
        """Numbers of requests and of malformed lines."""
        return {"requests": self._number, "malformed_lines": self._decoder.malformed}

    def _update(self, link: SerialLink | ConsolePerson) -> None:
        for arrival_s, data in link.receive():
            for message in self._decoder.feed(data):
                if isinstance(message, PersonAnswer):
                    self._settle(self._clock.from_monotonic(arrival_s), message)

    def _settle(self, t_s: float, answer: PersonAnswer) -> None:
        if self._asked is None or answer.number != self._number:
            return
        asked, self._asked = self._asked, None
        if not answer.done:
            self._report(Refused(t_s, self.name, asked, answer.reason or "no reason given"))
        elif isinstance(asked, LoadWeight):
            self._loads.hang(t_s, asked.bridge, asked.force_n)
            self._blocks += self._loads.take()
            self._report(Loaded(t_s, self.name, asked.bridge, asked.force_n, command_id=asked.id))
        else:
            self._report(Answered(t_s, self.name, asked.request, command_id=asked.id))

    def _fail(self, reason: str) -> None:
        self._asked = None
        super()._fail(reason)


__all__ = ["Person", "PersonSettings"]
