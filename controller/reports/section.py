"""What a part of the page is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple


class Kind(StrEnum):
    """Where a result comes from, and so what it can say."""

    FITTED = "fitted"
    """Put into the simulated bench from the paper's own figure: that it comes back says that the program is right."""

    ASSUMED = "assumed"
    """Follows from what nobody printed and somebody had to choose."""

    PREDICTED = "predicted"
    """Computed by the simulated bench from other facts: it may fail."""

    MEASURED = "measured"
    """On a real bench; it may fail."""


class Result(NamedTuple):
    """A sentence for the page's beginning.

    Attributes:
        kind: Where it comes from; None for what is told and compared with nothing.
        said: The sentence, with the size of the effect first.
        met: Whether it comes out as the paper's; None where that is not judged.
    """

    kind: Kind | None
    said: str
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


@dataclass(frozen=True, slots=True)
class Section:
    """One part of the page.

    Attributes:
        title: Its heading.
        template: File under templates/.
        context: What the template is given.
        citation: The paper that it stands beside.
        summary: Sentences for the page's beginning.
        not_the_papers: What is ours and not the paper's, one sentence each.
        printed: Settings that the paper prints, by their path in the profile.
    """

    title: str
    template: str
    context: Mapping[str, Any]
    citation: str = ""
    summary: list[Result] = field(default_factory=list)
    not_the_papers: list[str] = field(default_factory=list)
    printed: Mapping[str, Printed] = field(default_factory=dict)
