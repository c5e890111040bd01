"""A report in the lines of a terminal: the table beside the paper's, the verdict with its size, what the guard did."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from controller.recording.reader import Run
from controller.reports.counts import Row
from controller.reports.run_account import early_end
from controller.reports.section import Result, Section, laid_out

MARKS = {"met": "✓", "missed": "✗", "neither": "·"}

GAP = "  "
"""Between two columns."""


@dataclass(frozen=True, slots=True)
class SectionPart:
    """A section of the page and its runs.

    Attributes:
        name: Of experiment and bench, and which of several of different settings.
        runs: Of equal settings.
        results: The section's summary; without verdicts where trials are missing.
        settings: Detectors, behavior and limits beside the paper's.
        body: The section as HTML.
        ours: What is ours and not the paper's, one sentence each.
    """

    name: str
    runs: Sequence[Run]
    section: Section
    results: Sequence[Result]
    settings: Sequence[Row]
    body: str
    ours: Sequence[str]


def in_lines(part: SectionPart) -> Iterator[str]:
    """A part's name, its table where it has one, and its results, those that may be judged before the others."""
    yield f"{part.section.title}, {part.name}"
    if part.section.terminal:
        yield from _rows(part.section.terminal)
    for result in part.results:
        yield f"{MARKS[result.mark]} {result.text}"


def guard_lines(runs: Sequence[Run]) -> Iterator[str]:
    """What ended runs early, or one line that nothing did; and what was lost."""
    ends = [end for run in runs if (end := early_end(run)) is not None]
    for end in ends:
        yield f"{end.what}: {end.name}. {' '.join(end.stops) or end.reason}"
    if not ends:
        yield "The guard stopped nothing."
    lost = [(stream, n) for run in runs for stream, n in (run.manifest.get("loss") or {}).items() if n]
    if lost:
        yield f"Samples lost: {', '.join(f'{n} of {stream}' for stream, n in lost)}."


def _rows(rows: Sequence[Row]) -> Iterator[str]:
    table = laid_out(rows)
    lines = [table.heads, *([str(cell) for cell in row] for row in table.rows)]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    spans, place = [], 0
    for name, count in table.groups:
        spans.append(name.ljust(sum(widths[place : place + count]) + len(GAP) * (count - 1)))
        place += count
    if spans:
        yield GAP.join(spans).rstrip()
    for line in lines:
        looks = zip(line, widths, table.looks, strict=True)
        cells = [cell.ljust(width) if look == "left" else cell.rjust(width) for cell, width, look in looks]
        yield GAP.join(cells).rstrip()
