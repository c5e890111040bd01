"""Columns, commands and events as text, as page, report and recording show them; new ones need nothing here."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields

from behaviors.events import Event
from controller.scales import figure, scale_of
from drivers.core.messages import Command


def spaced(name: str) -> str:
    """A class's name as separate words: `MoveTo` as `move to`."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", name).lower()


def as_text(message: Command | Event) -> str:
    """A command or an event: `stage: move to 3 mm, speed 5 mm/s`, `stage: sent “move to 3 mm, speed 5 mm/s”`."""
    source = getattr(message, "device", None) or getattr(message, "detector", None)
    return f"{source}: {_deed(message)}" if source else _deed(message)


def _deed(message: Command | Event) -> str:
    name = spaced(type(message).__name__)
    parts = list(_parts(message, bare=name.endswith((" to", " at"))))
    if parts and (parts[0].startswith("“") or name.endswith((" to", " at"))):
        name = f"{name} {parts.pop(0)}"
    return ", ".join([name, *parts])


def _parts(message: Command | Event, bare: bool) -> Iterator[str]:
    """What its fields hold; the first without its name where the verb wants that."""
    for field in fields(message):
        value = getattr(message, field.name)
        if field.name in ("t_s", "device", "detector", "command_id") or not field.repr or value is None:
            continue
        if isinstance(value, Command):
            yield f"“{_deed(value)}”"
        elif isinstance(value, bool):
            yield "off" if field.name == "on" and not value else f"{'' if value else 'no '}{field.name}"
        elif isinstance(value, frozenset):
            yield ", ".join(sorted(map(str, value))) or "nothing"
        elif isinstance(value, str):
            yield value if field.name in ("reason", "request", "stream") else f"{field.name} {value}"
        elif isinstance(value, tuple):
            yield f"{scale_of(field.name).label} ({', '.join(map(figure, value))})"
        else:
            scale = scale_of(field.name)
            yield f"{scale.cell(value)} {scale.unit}".strip() if bare else scale.said(value)
            bare = False
