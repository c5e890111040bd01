"""A resolved profile as TOML for people: every setting, and where its value came from."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from config.source import KeyPath

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_COMMENT_COLUMN = 42
"""Where comments begin, in characters: right of most settings."""


def to_toml(table: Mapping[str, Any], origin: Callable[[KeyPath], str]) -> str:
    """A profile file equivalent to the table.

    Args:
        table: Nested tables, as `Profile.resolved` gives them.
        origin: Gives the source of the value at a path; it becomes the value's comment.
    """
    return "\n".join(_lines(table, (), origin)).strip() + "\n"


def _lines(table: Mapping[str, Any], path: KeyPath, origin: Callable[[KeyPath], str]) -> Iterator[str]:
    below = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    here = {key: value for key, value in table.items() if key not in below}
    if path and here:
        yield ""
        yield f"[{'.'.join(_key(part) for part in path)}]"
    for key, value in here.items():
        *lines, last = f"{_key(key)} = {_rows(value)}".split("\n")
        yield from lines
        yield f"{last:<{_COMMENT_COLUMN}}  # {origin((*path, key))}"
    for key, value in below.items():
        yield from _lines(value, (*path, key), origin)


def _rows(value: Any) -> str:
    """A value; a list of tables has a line for each."""
    if isinstance(value, list) and value and all(isinstance(row, Mapping) for row in value):
        return "\n".join(["[", *(f"    {_value(row)}," for row in value), "]"])
    return _value(value)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(leaf)}" for key, leaf in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    # A JSON text is a TOML text but for DEL; numbers and truth values are the same in both.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _value(key)
