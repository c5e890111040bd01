"""trials.csv: one line a trial, appended as it ends, the same bytes for the same seed."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from controller.recording.run_folder import RecordingError

Cell = str | int | float | bool | None

DIGITS = 9
"""Significant digits of a number: finer than any sensor here, coarser than rounding errors."""

_INTEGER = re.compile(r"-?\d+")
_NUMBER = re.compile(r"-?\d+(\.\d*)?([eE][+-]?\d+)?")


class Ledger:
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
        if path.exists() and path.stat().st_size:
            if path.read_text("utf-8").split("\n", 1)[0] + "\n" != header:
                raise ValueError(
                    f"{path}: its columns are not those of this profile; write to another folder"
                )
            data = path.read_bytes()
            if not data.endswith(b"\n"):  # cut off
                os.truncate(path, data.rfind(b"\n") + 1)
        else:
            self.add(header)
            self.commit()

    def line(self, row: Mapping[str, object]) -> str:
        """A row as it is appended.

        Raises:
            ValueError: the row has a column that the ledger has not.
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
        try:
            with self.path.open("ab", buffering=0) as file:
                file.write(lines.encode())
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


def read_ledger(path: Path) -> tuple[list[dict[str, Cell]], bool]:
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
