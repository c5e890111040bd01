"""What a part of the page is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Section:
    """One part of the page.

    Attributes:
        title: Its heading.
        template: File under templates/.
        context: What the template is given.
        citation: The paper that it stands beside.
        summary: Sentences for the page's beginning, each with whether it is good news (None: neither).
        not_the_papers: What is ours and not the paper's, one sentence each.
    """

    title: str
    template: str
    context: Mapping[str, Any]
    citation: str = ""
    summary: list[tuple[bool | None, str]] = field(default_factory=list)
    not_the_papers: list[str] = field(default_factory=list)
