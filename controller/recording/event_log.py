"""events.jsonl: one line an event, with the state that handled it and what followed from it."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from behaviors.events import Event
from controller.recording.run_folder import RecordingError
from drivers.core.messages import Command


class EventLog:
    """Appends events; implements `disk.DiskFile`.

    Args:
        path: The file; made where absent.

    Raises:
        RecordingError: it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines = b""
        try:
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise RecordingError(path, "making", error) from error

    def add(
        self, trial: int, event: Event, state: str, next_state: str, commands: Sequence[Command] = ()
    ) -> None:
        """Take an event for the next commit."""
        name, details = describe_event(event)
        line = {
            "t_s": round(event.t_s, 9),
            "trial": trial,
            "event": name,
            "state": state,
            "next": next_state or state,
            "commands": [describe_command(command) for command in commands],
            **details,
        }
        self._lines += json.dumps(line, allow_nan=False).encode() + b"\n"

    def add_line(self, line: bytes) -> None:
        """Take an event's whole line as another log has it."""
        self._lines += line

    def commit(self, sync: bool) -> None:
        """Hand the lines to the kernel."""
        while self._lines:  # an unbuffered write may take a part only
            self._lines = self._lines[self._file.write(self._lines) :]

    def finish(self) -> None:
        """Close."""
        self._file.close()

    abandon = finish


def describe_event(event: Event) -> tuple[str, dict[str, object]]:
    """An event's name and, as JSON knows them, its other fields than the time."""
    details: dict[str, object] = {}
    for field in dataclasses.fields(event):
        if field.name != "t_s":
            details[field.name] = _plain(getattr(event, field.name))
    return type(event).__name__, details


def describe_command(command: Command) -> str:
    """A command as one reads it: `MoveAt(stage, 0.003785, 0.012)`."""
    values = (_plain(getattr(command, field.name)) for field in dataclasses.fields(command) if field.repr)
    texts = (f"{value:.6g}" if isinstance(value, float) else str(value) for value in values)
    return f"{type(command).__name__}({', '.join(texts)})"


def _plain(value: object) -> object:
    if isinstance(value, Command):
        return describe_command(value)
    if isinstance(value, float | np.floating):
        number = float(value)
        return number if math.isfinite(number) else None
    if isinstance(value, np.integer):
        return int(value)
    return value if isinstance(value, str | int | bool) or value is None else str(value)
