"""A person at the far end of a line: one JSON object a line, UTF-8, both ways.

    host → person   {"hello": "touchbench"}
                    {"ask": 3, "says": "hang 0.50 N on bridge Fx", "load": {"bridge": "x", "force_n": 0.5}}
    person → host   {"hello": "who it is"}
                    {"answer": 3, "done": true}
                    {"answer": 3, "done": false, "reason": "that weight is missing"}

`load` is for a program that answers; a person reads `says`. A newer question replaces an older one.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from drivers.core.errors import CodecError
from drivers.core.messages import Ask, LoadWeight
from drivers.operator.requests import request_text

LINE_MAX = 4096
"""Longest line in bytes; what is longer is noise (assumption: some lines of text)."""


@dataclass(frozen=True, slots=True)
class PersonHello:
    """Identity of the sender."""

    who: str


@dataclass(frozen=True, slots=True)
class PersonRequest:
    """A question to a person; `bridge` and `force_n` where it is for a weight."""

    number: int
    text: str
    bridge: str | None = None
    force_n: float = 0.0


@dataclass(frozen=True, slots=True)
class PersonAnswer:
    """The person's answer to a question."""

    number: int
    done: bool
    reason: str = ""


Message = PersonHello | PersonRequest | PersonAnswer


def request_of(number: int, command: Ask | LoadWeight) -> PersonRequest:
    """The question for a command."""
    if isinstance(command, LoadWeight):
        return PersonRequest(number, request_text(command), command.bridge, command.force_n)
    return PersonRequest(number, request_text(command))


def encode(message: Message) -> bytes:
    """A message as a line."""
    table: dict[str, object]
    match message:
        case PersonHello(who=who):
            table = {"hello": who}
        case PersonRequest(number=number, text=text, bridge=bridge, force_n=force_n):
            table = {"ask": number, "says": text}
            if bridge is not None:
                table["load"] = {"bridge": bridge, "force_n": force_n}
        case PersonAnswer(number=number, done=done, reason=reason):
            table = {"answer": number, "done": done, **({"reason": reason} if reason else {})}
    return json.dumps(table, ensure_ascii=False, allow_nan=False).encode() + b"\n"


def decode(line: bytes) -> Message:
    """A line as a message.

    Raises:
        CodecError: it is none.
    """
    try:
        match json.loads(line.decode()):
            case {"hello": str(who)}:
                return PersonHello(who)
            case {"ask": int(number), "says": str(text), "load": {"bridge": str(bridge), "force_n": force_n}}:
                return PersonRequest(number, text, bridge, float(force_n))
            case {"ask": int(number), "says": str(text)}:
                return PersonRequest(number, text)
            case {"answer": int(number), "done": bool(done), **others}:
                return PersonAnswer(number, done, str(others.get("reason", "")))
    except (ValueError, TypeError, OverflowError, RecursionError):
        pass
    raise CodecError(f"no message: {line[:60]!r}")


class LineDecoder:
    """Cuts a stream of bytes into messages; other lines are counted and dropped.

    Attributes:
        malformed: Lines that were no message.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """Messages that are whole now, in order."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LINE_MAX:
            self.malformed += 1
            self._rest = b""
        messages: list[Message] = []
        for line in lines:
            if not line.strip():
                continue
            try:
                messages.append(decode(line))
            except CodecError:
                self.malformed += 1
        return messages
