"""trials.csv, one line a trial, appended as it ends, the same bytes for the same seed; and events.jsonl."""

import csv
import dataclasses
import io
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path

from behaviors.events import Event
from controller.recording.run_folder import plain, writing
from drivers.core.messages import Command

Cell = str | int | float | bool | None

DIGITS = 9
"""Significant digits of a number: finer than any sensor here, coarser than rounding errors."""

_INTEGER = re.compile(r"-?(0|[1-9]\d*)")
_NUMBER = re.compile(r"-?(0|[1-9]\d*)(\.\d+)?(e[+-]\d\d+)?")
"""Numbers as `format_cell` writes them: a label such as `007` or `1e5` is text."""


class Lines:
    """A file to which whole lines are appended; implements `disk.DiskFile`.

    Args:
        path: The file; made where absent.
        durable: Whether each commit sees its lines on the disk.

    Raises:
        RecordingError: it cannot be made.
    """

    def __init__(self, path: Path, *, durable: bool = False) -> None:
        self.path = path
        self._durable = durable
        self._lines = ""
        with writing(path, "making"):
            path.open("ab").close()

    def add(self, line: str) -> None:
        """Take a whole line for the next commit."""
        self._lines += line

    def commit(self, sync: bool = True) -> None:
        """Hand the lines to the kernel, and where they are to be durable to the disk; may raise `OSError`."""
        lines, self._lines = self._lines, ""
        if not lines:
            return
        data = lines.encode()
        with self.path.open("ab", buffering=0) as file:
            while data:  # an unbuffered write may take a part only
                data = data[file.write(data) :]
            if self._durable:
                os.fsync(file.fileno())

    def finish(self) -> None:
        """Nothing is open between two commits."""

    abandon = finish


class TrialRows(Lines):
    """Rows with fixed columns: `trial`, `outcome`, the factors, the measures.

    A row depends on its own trial alone; rows stand in the order in which trials ran.

    Args:
        path: The file; made with its header where absent, else its columns must be the same.

    Raises:
        RecordingError: it cannot be written.
        ValueError: the file has other columns.
    """

    def __init__(self, path: Path, factors: Sequence[str], measures: Sequence[str]) -> None:
        super().__init__(path, durable=True)
        self.columns = ("trial", "outcome", *factors, *measures)
        header = _line(self.columns)
        data = path.read_bytes() if path.stat().st_size else b""
        if not data:
            self.add(header)
            with writing(path, "making"):
                self.commit()
        elif data.partition(b"\n")[0].decode() + "\n" != header:
            raise ValueError(f"{path}: its columns are not those of this profile; write to another folder")
        elif not data.endswith(b"\n"):  # cut off
            os.truncate(path, data.rfind(b"\n") + 1)

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


def event_line(
    trial: int, event: Event, state: str, next_state: str, commands: Sequence[Command] = ()
) -> str:
    """An event as a line of events.jsonl, with all its fields as JSON knows them."""
    others = [field.name for field in dataclasses.fields(event) if field.name != "t_s"]
    line = {
        "t_s": round(event.t_s, 9),
        "trial": trial,
        "event": type(event).__name__,
        "state": state,
        "next": next_state or state,
        "commands": [describe_command(command) for command in commands],
        **{name: _told(getattr(event, name)) for name in others},
    }
    return json.dumps(line, allow_nan=False) + "\n"


def describe_command(command: Command) -> str:
    """A command as one reads it: `MoveAt(stage, 0.003785, 0.012)`."""
    values = (_told(getattr(command, field.name)) for field in dataclasses.fields(command) if field.repr)
    texts = (f"{value:.6g}" if isinstance(value, float) else str(value) for value in values)
    return f"{type(command).__name__}({', '.join(texts)})"


def _told(value: object) -> object:
    if isinstance(value, Command):
        return describe_command(value)
    return plain(value) if isinstance(value, str | Real | None) else str(value)
