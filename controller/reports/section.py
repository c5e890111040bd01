"""What a part of the page is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import groupby
from typing import Any, NamedTuple

from markupsafe import Markup, escape

from controller.scales import Scale, scale_of


class Kind(StrEnum):
    """Where a result comes from, and so what it can show."""

    FITTED = "fitted"
    """Put into the simulated bench from the paper's own figure: that it comes back shows that the program is right."""

    ASSUMED = "assumed"
    """Follows from a choice that is printed nowhere."""

    PREDICTED = "predicted"
    """Computed by the simulated bench from other facts: it may fail."""

    MEASURED = "measured"
    """On a real bench; it may fail."""


class Result(NamedTuple):
    """A sentence for the page's beginning.

    Attributes:
        kind: Where it comes from; None where it is compared with nothing.
        text: The sentence, with the size of the effect first.
        met: Whether it comes out as the paper's; None where that is not judged.
    """

    kind: Kind | None
    text: str
    met: bool | None = None

    @property
    def mark(self) -> str:
        """`met`, `missed` or `neither`: what was put in, or chosen, has no mark whatever it comes to."""
        if self.met is None or self.kind not in (Kind.PREDICTED, Kind.MEASURED):
            return "neither"
        return "met" if self.met else "missed"


class Printed(NamedTuple):
    """A setting as a paper prints it.

    Attributes:
        value: In the setting's own unit; a sentence where the paper has no number.
        source: Section of the paper.
    """

    value: object
    source: str


class Text(NamedTuple):
    """A paragraph, or the heading of what follows."""

    text: str
    heading: bool = False


class Notes(NamedTuple):
    """Sentences, one a line."""

    sentences: Sequence[str]


class Figure(NamedTuple):
    """A picture, as an SVG element, and what it shows."""

    svg: Markup
    caption: str

    @property
    def labelled(self) -> Markup:
        """The picture with its caption as its label for a screen reader."""
        return Markup(str(self.svg).replace("<svg", f'<svg aria-label="{escape(self.caption)}"', 1))


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        head: Its name, without the unit.
        of: What is printed: a key of each row, or an attribute; unit and scale are those of that name (`scale_of`).
        decimals: That a number is printed with; None prints four significant digits.
        look: `mine`, `theirs`, `wrap` or `verdict`; "" is plain.
        group: Heading over several columns.
    """

    head: str
    of: str
    decimals: int | None = None
    look: str = ""
    group: str = ""

    @property
    def scale(self) -> Scale:
        """What its name says of its values."""
        return scale_of(self.of)


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Rows under heads.

    Attributes:
        columns: Left to right.
        rows: A cell a column: text, or for a verdict True, False or None.
        caption: What it shows.
        left: How many columns stand at the left margin of theirs.
        foot: A last row, over all others.
        folded: Label of the switch that unfolds it; "" where it is open.
    """

    columns: Sequence[Column]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    left: int = 1
    foot: Sequence[Any] = ()
    folded: str = ""

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Headings over several columns and how many each spans; empty where there are none."""
        found = [(name, len(list(own))) for name, own in groupby(column.group for column in self.columns)]
        if not any(name for name, _ in found):
            return []
        return [(", ".join(filter(None, (name, self._unit_of(name)))), count) for name, count in found]

    @property
    def heads(self) -> list[str]:
        """The columns' heads, each with the unit of its cells where that does not stand over the group."""
        return [
            ", ".join(filter(None, (each.head, "" if self._unit_of(each.group) else each.scale.unit)))
            for each in self.columns
        ]

    def _unit_of(self, group: str) -> str:
        """The one unit of all columns under a heading, or ""."""
        units = {each.scale.unit for each in self.columns if each.group == group and each.look != "verdict"}
        return next(iter(units)) if group and len(units) == 1 else ""


Block = Text | Notes | Figure | ReportTable


@dataclass(frozen=True, slots=True)
class Section:
    """One part of the page.

    Attributes:
        title: Its heading.
        body: Its content, from top to bottom.
        citation: The paper that it stands beside.
        summary: Sentences for the page's beginning.
        not_the_papers: What is ours and not the paper's, one sentence each.
        printed: Settings that the paper prints, by their path in the profile.
        terminal: Its table in a terminal, some 14 lines.
    """

    title: str
    body: Sequence[Block]
    citation: str = ""
    summary: list[Result] = field(default_factory=list)
    not_the_papers: list[str] = field(default_factory=list)
    printed: Mapping[str, Printed] = field(default_factory=dict)
    terminal: ReportTable | None = None
