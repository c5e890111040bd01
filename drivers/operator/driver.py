"""The person at the bench: asked on the console, or at the far end of a line."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from pydantic import Field

from drivers.clock import Clock
from drivers.errors import PortError, SilentError
from drivers.links import SerialLink, open_serial
from drivers.messages import (
    Answered,
    Applied,
    Ask,
    Command,
    DeviceInfo,
    Failed,
    Listen,
    Loaded,
    LoadWeight,
    Refused,
    SampleBlock,
    Sent,
    Status,
)
from drivers.operator.codec import Answer, Hello, LineDecoder, encode, request_of
from drivers.operator.requests import LoadLimits, Loads, in_words, load_stream, valid
from drivers.protocols import Question

CONSOLE = "console"
"""The port of a person who sits at the terminal that the program runs in."""

HELLO_TURN_S = 0.005
"""Pause between two looks at the line while nobody has said hello yet."""

HOW_TO_ANSWER = "then press Enter (n and Enter: it cannot be done)"


class PersonSettings(LoadLimits):
    """The person at the bench."""

    port: str = CONSOLE
    """"console", or the path of a serial port or pty with somebody behind it."""

    baud: int = Field(default=115_200, ge=1_200, le=12_000_000)
    """Line speed in bits per second; nothing to a pty."""

    hello_timeout_s: float = Field(default=2.0, gt=0.0, le=60.0)
    """How long whoever is behind a line may take to say hello. Assumption: a program does, not a person."""


class Person:
    """Puts requests to a person; implements `drivers.protocols.Device` and `Asking`.

    It answers when the person does: how long that may take is for the behavior to say. A request that is not
    answered yet is replaced by the next. On the console the program's own keyboard hears the answer (`question`,
    `answer`), for there is but one Enter key.

    Args:
        name: Name in the profile.
        settings: Of the person.
        clock: Gives bench time.
    """

    def __init__(self, name: str, settings: PersonSettings, clock: Clock) -> None:
        self.name = name
        self._settings = settings
        self._clock = clock
        self._link: SerialLink | None = None
        self._decoder = LineDecoder()
        self._loads = Loads(name)
        self._open = self._failed = False
        self._number = 0
        self._asked: Ask | LoadWeight | None = None
        self._statuses: list[Status] = []

    def open(self) -> DeviceInfo:
        """See that somebody is there.

        Raises:
            PortError: the console is no terminal, or the line is absent or busy.
            SilentError: nobody says hello on the line.
        """
        self.close()
        if self._settings.port == CONSOLE:
            if sys.stdin is None or not sys.stdin.isatty():
                reason, advice = (
                    "nobody can answer: standard input is no terminal",
                    "run it in a terminal, by hand",
                )
                raise PortError(self.name, "opening the console", reason, advice)
            who = "the person at the console"
        else:
            self._link = open_serial(self.name, self._settings.port, self._settings.baud, self._clock)
            try:
                who = self._greet(self._link)
            except BaseException:
                self.close()
                raise
        self._open, self._failed = True, False
        info = load_stream(self.name)
        return DeviceInfo(self.name, model=who, streams={info.name: info})

    def close(self) -> None:
        """Ask for nothing any more, let go of the line. Never raises; may be called twice."""
        self._open = False
        self._asked = None
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def apply(self, command: Command) -> Applied:
        """Put a request to the person.

        Raises:
            CommandError: not for a person, or a load that the sensor does not bear.
            PortError: it is not open.
        """
        now_s = self._clock.now()
        if isinstance(command, Listen):
            self._loads.listen(command.streams)
            return Applied(command, now_s)
        asked = valid(self.name, self._settings, command)
        if not self._open:
            raise PortError(
                self.name, f"applying {type(command).__name__}", "it is not open", "open it first"
            )
        self._number += 1
        self._asked = asked
        if self._link is not None:
            sent_s = self._link.send(encode(request_of(self._number, asked)))
            if sent_s is None:
                self._fail(self._link.fault or "the line is closed")
                return Applied(command, now_s)
            now_s = self._clock.from_monotonic(sent_s)
        self._statuses.append(Sent(now_s, self.name, command))
        return Applied(command, now_s)

    @property
    def question(self) -> Question | None:
        """What the console has to ask, or None; see `drivers.protocols.Asking`."""
        if self._asked is None or self._link is not None:
            return None
        return Question(self._number, f"{in_words(self._asked)}, {HOW_TO_ANSWER}")

    def answer(self, number: int, done: bool) -> None:
        """The person has answered on the console; see `drivers.protocols.Asking`."""
        self._settle(self._clock.now(), Answer(number, done, "" if done else "the person says no"))

    def read(self) -> Sequence[SampleBlock]:
        """What hangs on the sensor, where it has changed since the last call."""
        self._turn()
        return self._loads.take()

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""
        self._turn()
        taken, self._statuses = self._statuses, []
        return taken

    def account(self) -> Mapping[str, object]:
        """How many requests were made, and lines that made no sense."""
        return {"requests": self._number, "malformed_lines": self._decoder.malformed}

    def _greet(self, link: SerialLink) -> str:
        """Say hello; returns who says it back. What else was on the line is forgotten."""
        self._decoder = LineDecoder()
        link.send(encode(Hello("touchbench")))
        until_s = self._clock.monotonic_s() + self._settings.hello_timeout_s
        while link.fault is None and self._clock.monotonic_s() < until_s:
            for _, data in link.receive():
                for message in self._decoder.feed(data):
                    if isinstance(message, Hello):
                        return message.who
            self._clock.rest(HELLO_TURN_S)
        if link.fault is not None:
            raise PortError(self.name, "saying hello", link.fault, "is it plugged in?")
        reason = f"nobody says hello in {self._settings.hello_timeout_s:g} s"
        advice = 'is their program running? for a person at this terminal write port = "console"'
        raise SilentError(self.name, "saying hello", reason, advice)

    def _turn(self) -> None:
        if self._link is None or self._failed:
            return
        for arrival_s, data in self._link.receive():
            for message in self._decoder.feed(data):
                if isinstance(message, Answer):
                    self._settle(self._clock.from_monotonic(arrival_s), message)
        if self._link.fault is not None:
            self._fail(self._link.fault)

    def _settle(self, t_s: float, answer: Answer) -> None:
        if self._asked is None or answer.number != self._number:
            return
        asked, self._asked = self._asked, None
        if not answer.done:
            self._statuses.append(Refused(t_s, self.name, asked, answer.reason or "no reason given"))
        elif isinstance(asked, LoadWeight):
            self._loads.hang(t_s, asked.bridge, asked.force_n)
            self._statuses.append(Loaded(t_s, self.name, asked.bridge, asked.force_n, command_id=asked.id))
        else:
            self._statuses.append(Answered(t_s, self.name, asked.request, command_id=asked.id))

    def _fail(self, reason: str) -> None:
        if not self._failed:
            self._failed = True
            self._asked = None
            self._statuses.append(Failed(self._clock.now(), self.name, reason))


__all__ = ["Person", "PersonSettings"]
