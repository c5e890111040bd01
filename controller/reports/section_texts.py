"""A section's prose and tables, from the TOML file of its name."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from controller.reports.approaches import Mean
from controller.reports.section import Column, Notes, ReportTable, Text
from controller.reports.text import number, spread


class SectionTexts:
    """Sentences and tables of a section, with the facts of a run put in.

    A table's columns are lines of `head; key; decimals; look; group`, of which the last three may be missing; the
    unit is the key's.

    Args:
        name: Of the file, beside this one.
    """

    def __init__(self, name: str) -> None:
        self._file: Mapping[str, Any] = tomllib.loads(
            Path(__file__).with_name(f"{name}.toml").read_text("utf-8")
        )

    def sentence(self, name: str, **facts: object) -> str:
        """A sentence."""
        return str(self._file[name]).format(**facts)

    def each(self, name: str) -> list[str]:
        """Several sentences."""
        return list(self._file[name])

    def named(self, name: str) -> Mapping[str, str]:
        """Sentences by their names."""
        return dict(self._file[name])

    def text(self, name: str, **facts: object) -> Text:
        """A paragraph."""
        return Text(self.sentence(name, **facts))

    def notes(self, name: str, rest: Sequence[str] = ()) -> Notes:
        """Sentences, and others after them."""
        return Notes([*self._file[name], *rest])

    def table(
        self, name: str, rows: Iterable[Any], more: Sequence[Column] = (), **facts: object
    ) -> ReportTable:
        """A table.

        Args:
            name: Its name in the file.
            rows: By key, or by attribute.
            more: Columns that the run brings, before the last ones.
            facts: For caption and heads.
        """
        given = self._file[name]
        columns = [_column(line, facts) for line in given["columns"].strip().splitlines()]
        place = given.get("more_after", len(columns))
        columns[place:place] = more
        body = [[cell(row, column) for column in columns] for row in rows]
        caption = given.get("caption", "").format(**facts)
        return ReportTable(
            columns, body, caption, given.get("left", 1), folded=given.get("folded", "").format(**facts)
        )


def _column(line: str, facts: Mapping[str, object]) -> Column:
    head, of, *rest = (part.strip() for part in line.format(**facts).split(";"))
    decimals, look, group = [*rest, *[""] * (3 - len(rest))]
    return Column(head, of, int(decimals) if decimals else None, look, group)


def cell(row: Any, column: Column) -> Any:
    """A row's cell in a column, as it is printed; a verdict is returned as it is."""
    value = row.get(column.of) if isinstance(row, Mapping) else getattr(row, column.of)
    if column.look == "verdict":
        return value
    factor = column.scale.factor
    if isinstance(value, Mean):
        return spread(value, 2 if column.decimals is None else column.decimals, factor)
    if column.decimals is not None and not isinstance(value, str):
        return number(value, column.decimals, factor)
    return column.scale.cell(value)
