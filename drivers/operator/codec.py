"""A person at the far end of a line: one JSON object a line, UTF-8, both ways.

    host → person   {"hello": "touchbench"}
                    {"ask": 3, "says": "hang 0.50 N on bridge Fx", "load": {"bridge": "x", "force_n": 0.5}}
    person → host   {"hello": "who it is"}
                    {"answer": 3, "done": true}
                    {"answer": 3, "done": false, "reason": "that weight is missing"}

`load` is for a program that answers; a person reads `says`. A newer question replaces an older one.
"""

import json
import math
from collections.abc import Mapping
from typing import Any

from drivers.core.errors import CodecError
from drivers.core.messages import Ask, LoadWeight

LINE_MAX = 4096
"""Longest line in bytes; what is longer is noise (assumption: some lines of text)."""

BRIDGES: Mapping[str, str] = {"x": "Fx", "y": "Fy", "t": "Ft"}
"""The bridges of the fingertip, and the force that each reads."""


def request_text(command: Ask | LoadWeight) -> str:
    """The request as a person reads it."""
    if isinstance(command, Ask):
        return command.request
    if command.force_n == 0.0:
        return "take every weight off"
    # Steps of a hundredth of a newton are the finest that a set of weights has.
    decimals = max(2, -math.floor(math.log10(command.force_n) + 1e-9) + 1)
    return f"hang {command.force_n:.{decimals}f} N on bridge {BRIDGES[command.bridge]}"


def request_of(number: int, command: Ask | LoadWeight) -> dict[str, object]:
    """The question for a command."""
    message: dict[str, object] = {"ask": number, "says": request_text(command)}
    if isinstance(command, LoadWeight):
        message["load"] = {"bridge": command.bridge, "force_n": command.force_n}
    return message


def encode(message: Mapping[str, object]) -> bytes:
    """A message as a line."""
    return json.dumps(message, ensure_ascii=False, allow_nan=False).encode() + b"\n"


def decode(line: bytes) -> dict[str, Any]:
    """A line as a message: a hello, a question or an answer, with the keys and types of this page.

    Raises:
        CodecError: it is none.
    """
    try:
        match json.loads(line.decode()):
            case {"hello": str(who)}:
                return {"hello": who}
            case {"ask": int(number), "says": str(text), "load": {"bridge": str(bridge), "force_n": force_n}}:
                return {"ask": number, "says": text, "load": {"bridge": bridge, "force_n": float(force_n)}}
            case {"ask": int(number), "says": str(text)}:
                return {"ask": number, "says": text}
            case {"answer": int(number), "done": bool(done), **others}:
                return {"answer": number, "done": done, "reason": str(others.get("reason", ""))}
    except (ValueError, TypeError, OverflowError, RecursionError):
        pass
    raise CodecError(f"no message: {line[:60]!r}")
