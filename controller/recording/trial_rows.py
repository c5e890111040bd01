"""trials.csv, one line a trial, appended as it ends, the same bytes for the same seed; and events.jsonl."""

import csv
import dataclasses
import io
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from behaviors.events import Event
from controller.recording.run_folder import RecordingError
from drivers.core.messages import Command

Cell = str | int | float | bool | None

DIGITS = 9
"""Significant digits of a number: finer than any sensor here, coarser than rounding errors."""

_INTEGER = re.compile(r"-?(0|[1-9]\d*)")
_NUMBER = re.compile(r"-?(0|[1-9]\d*)(\.\d+)?(e[+-]\d\d+)?")
"""Numbers as `format_cell` writes them: a label such as `007` or `1e5` is text."""


class TrialRows:
    """Appends rows with fixed columns: `trial`, `outcome`, the factors, the measures; implements `disk.DiskFile`.

    A row depends on its own trial alone; rows stand in the order in which trials ran.

    Args:
        path: The file; made with its header where absent, else its columns must be the same.

    Raises:
        RecordingError: it cannot be written.
        ValueError: the file has other columns.
    """

    def __init__(self, path: Path, factors: Sequence[str], measures: Sequence[str]) -> None:
        self.path = path
        self._lines = ""
        self.columns = ("trial", "outcome", *factors, *measures)
        header = _line(self.columns)
        data = path.read_bytes() if path.exists() and path.stat().st_size else b""
        if data:
            if data.partition(b"\n")[0].decode() + "\n" != header:
                raise ValueError(
                    f"{path}: its columns are not those of this profile; write to another folder"
                )
            if not data.endswith(b"\n"):  # cut off
                os.truncate(path, data.rfind(b"\n") + 1)
        else:
            self.add(header)
            self.commit()

    def line(self, row: Mapping[str, object]) -> str:
        """A row as it is appended.

        Raises:
            ValueError: the row has a column that the table has not.
        """
        unknown = sorted(set(row) - set(self.columns))
        if unknown:
            raise ValueError(f"{self.path}: no column {', '.join(unknown)}")
        return _line([format_cell(row.get(column)) for column in self.columns])

    def cells(self, line: str) -> dict[str, str]:
        """A whole line's cells, by column."""
        return dict(zip(self.columns, next(csv.reader([line])), strict=True))

    def add(self, line: str) -> None:
        """Take a whole line for the next commit: what the row summarises is then written before it."""
        self._lines += line

    def commit(self, sync: bool = True) -> None:
        """Write the lines and see them on the disk; may raise `RecordingError`."""
        if not self._lines:
            return
        lines, self._lines = self._lines, ""
        data = lines.encode()
        try:
            with self.path.open("ab", buffering=0) as file:
                while data:  # an unbuffered write may take a part only
                    data = data[file.write(data) :]
                os.fsync(file.fileno())
        except OSError as error:
            raise RecordingError(self.path, "appending to", error) from error

    def finish(self) -> None:
        """Nothing is open between two commits."""

    abandon = finish


def format_cell(value: object) -> str:
    """A cell's text: numbers to nine significant digits, nothing for None and NaN."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | str):
        return str(value)
    number = float(value)  # type: ignore[arg-type]  # a NumPy scalar, or an error that names it
    return "" if math.isnan(number) else f"{number + 0.0:.{DIGITS}g}"  # + 0.0: no minus before zero


def read_rows(path: Path) -> tuple[list[dict[str, Cell]], bool]:
    """All whole rows, and whether a last one was cut off.

    Cells become numbers, booleans, None (empty) or text.

    Raises:
        ValueError: a row has more or fewer cells than the header.
    """
    if not path.exists():
        return [], False
    text = path.read_bytes().decode("utf-8", errors="replace")
    whole, _, cut = text.rpartition("\n")
    lines = list(csv.reader(io.StringIO(whole)))
    rows: list[dict[str, Cell]] = []
    for number, cells in enumerate(lines[1:], start=2):
        if len(cells) != len(lines[0]):
            raise ValueError(f"{path}: line {number} has {len(cells)} cells, the header has {len(lines[0])}")
        rows.append(dict(zip(lines[0], map(_parsed, cells), strict=True)))
    return rows, bool(cut)


def _parsed(text: str) -> Cell:
    if text in ("", "true", "false"):
        return {"": None, "true": True, "false": False}[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _NUMBER.fullmatch(text) else text


def _line(cells: Sequence[str]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(cells)
    return buffer.getvalue()


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
    names = [field.name for field in dataclasses.fields(event) if field.name != "t_s"]
    return type(event).__name__, {name: _plain(getattr(event, name)) for name in names}


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
