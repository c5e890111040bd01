"""What a part of the page is made of, and the templates that every page is made with."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from controller.recording.reader import Run
from controller.reports import counts
from controller.reports.counts import Row, Trials, percent, three, title, under, wilson, with_spread
from controller.scales import NOTHING, scale_of


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


def kind_of(runs: Sequence[Run], simulated: Kind = Kind.PREDICTED) -> Kind:
    """Measured on a real bench; on a simulated one predicted, or what is said."""
    return simulated if runs[0].simulated else Kind.MEASURED


class Result(NamedTuple):
    """A sentence for the page's beginning.

    Attributes:
        kind: Where it comes from; None where it is compared with nothing.
        text: The sentence, with the size of the effect first.
        met: Whether it comes out as the paper's, or meets a goal; None where that is not judged.
        goal: Whether it is good where it is met, and bad where not: to differ from the paper is neither.
        better: Of what is not as the paper's, whether it is better or worse; None where it is neither.
    """

    kind: Kind | None
    text: str
    met: bool | None = None
    goal: bool = False
    better: bool | None = None

    @property
    def mark(self) -> str:
        """`met` or `missed` of a goal, else `same`, `better`, `worse` or `apart`; `neither` where nothing is judged:
        what was put in, or chosen, has no mark whatever it comes to."""
        if self.met is None or self.kind not in (Kind.PREDICTED, Kind.MEASURED):
            return "neither"
        if self.goal:
            return "met" if self.met else "missed"
        return "same" if self.met else {True: "better", False: "worse", None: "apart"}[self.better]


def judged(
    kind: Kind, text: str, met: bool | None, n: int, goal: bool = False, better: bool | None = None
) -> Result:
    """A sentence, without its full stop, with the verdict that `n` trials carry, or that they carry none."""
    text += "." if met is not None else f": not decided with n = {n}."
    return Result(kind, text, met, goal, better if met is False and not goal else None)


class Printed(NamedTuple):
    """A setting as a paper prints it.

    Attributes:
        value: In the setting's own unit; a sentence where the paper has no number.
    """

    value: object
    source: str


class Headline(NamedTuple):
    """The one number that a part of the page opens with.

    Attributes:
        what: It is: `time from touch to detection`.
        ours: With its unit.
        of: What it is made of: `mean of 35`.
        paper: The paper's; "" for none.
        source: Whose that is, and where it stands.
        interval: The 95 % interval of ours; "" for none.
        verdict: How the two compare, in half a sentence; later the whole sentence.
        rows: Filter of the table of trials that leaves those it is made of; "" for all.
        column: Of trials.csv that it is made of.
        state: How it went, of `first_screen.WENT`; before the verdict is made "" where the trials say it.
        side: Ours is `better` than the paper's, `worse`, `as` it, or `apart`; "" where so many trials do not tell.
        spread: The least and the largest of single trials; "" for none.
    """

    what: str
    ours: str
    of: str
    paper: str = ""
    source: str = ""
    interval: str = ""
    verdict: str = ""
    rows: str = ""
    column: str = ""
    state: str = ""
    side: str = ""
    spread: str = ""


UNTOLD = "too few to tell apart"
"""What is said of two numbers that so few trials do not tell apart."""


def rated(
    what: str,
    hits: int,
    of: int,
    paper: float | None = None,
    source: str = "",
    rows: str = "",
    column: str = "",
    above: bool | None = None,
    more: bool = True,
) -> Headline:
    """A share of some trials with its 95 % interval (Wilson), beside the paper's or a rival's; `of` is not 0.

    Args:
        above: Whether it is the larger one; None where so many trials do not tell.
        more: Whether more is better.
    """
    low, high = wilson(hits, of)
    ours, interval = percent(hits / of), f"{three(100.0 * low)} to {three(100.0 * high)} %"
    if paper is None:
        return Headline(what, ours, f"{hits} of {of}", "", source, interval, f"{what}: {ours}", rows, column)
    theirs, whose = percent(paper), source.partition(" (")[0]
    whose = f"{whose} {theirs}" if whose.endswith("'s") else f"{whose} with {theirs}"
    side = "as" if hits == paper * of else "" if above is None else "better" if above == more else "worse"
    beside = f"{what}: {ours}, " + {"as": f"beside {whose}", "": f"beside {whose} ({UNTOLD})"}.get(
        side, f"{side} than {whose}"
    )
    return Headline(what, ours, f"{hits} of {of}", theirs, source, interval, beside, rows, column, "", side)


class Comparing(NamedTuple):
    """What a page on two runs says of both: lines, the means of what was measured, and every pair of trials."""

    lines: Sequence[str]
    means: Sequence[Row]
    pairs: Sequence[Row]


class Figure(NamedTuple):
    """A picture, as an SVG element, and what it shows."""

    svg: str
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Section:
    """One part of the page.

    Attributes:
        content: What its template shows. The usual template shows all of it, from top to bottom: text is a paragraph,
            a `Figure` a figure, a list of rows a table.
        template: Of templates/, without its ending. Its macro `ours` says what is ours and not the paper's.
        paper: That it stands beside: one of `papers.CITATION`, or its citation; "" for none.
        printed: Settings that the paper prints, by their path in the profile, beside those of papers/settings.csv.
        terminal: Its table in a terminal, some 14 lines.
        headline: What it opens with, where papers/headlines.csv does not say it.
        shows_trials: Whether the first figure is of trials; else the section's own first figure stands there.
    """

    title: str
    content: Mapping[str, Any]
    template: str = "any"
    paper: str = ""
    summary: Sequence[Result] = ()
    printed: Mapping[str, Printed] = field(default_factory=dict)
    terminal: Sequence[Row] = ()
    headline: Headline | None = None
    shows_trials: bool = True


class Table(NamedTuple):
    """Rows as they are laid out.

    Attributes:
        groups: Headings over several columns and how many each spans; empty where there are none.
        looks: Of the columns: `left`, `wrap` (long text), `mine`, `theirs`, or "".
        rows: A cell a column.
        filters: Of each row what leaves its trials in the table of trials, by its key `ROWS`; "" for none.
    """

    groups: Sequence[tuple[str, int]]
    heads: Sequence[str]
    looks: Sequence[str]
    rows: Sequence[Sequence[Any]]
    filters: Sequence[str] = ()


ROWS = "@rows"
"""Key of a row whose cell is no column, but leads to its trials: see `rows_where`."""


def rows_where(row: Row, *names: str) -> str:
    """What leaves the trials in the table of trials that are as this one: `location=f speed_m_s=0.00254`."""
    return " ".join(f"{name}={row[name]}" for name in names if row.get(name) is not None)


def measured(groups: Iterable[Trials], factors: Iterable[str], columns: Iterable[str]) -> list[Row]:
    """A line for each group of trials: its factors, how many they are, and mean ± standard deviation of the columns
    that hold a number in any group, of how many where some trials have none."""
    groups, factors = list(groups), list(factors)
    known = [name for name in columns if any(own.values(name) for own in groups)]
    lines: list[Row] = []
    for own in groups:
        first = own[0] if own else {}
        line: dict[str, Any] = {ROWS: rows_where(first, *factors)}
        for name in factors:
            cell = first.get(name)
            line |= under(name, title(cell) if isinstance(cell, str) else cell)
        line["n"] = len(own)
        for name in known:
            text = with_spread(own.mean(name), scale_of(name).factor)
            line |= under(name, text.removesuffix(f" ({len(own)})"))
        lines.append(line)
    return lines


def laid_out(rows: Sequence[Row]) -> Table:
    """Rows as a table: a key of a row heads a column, or is the heading over the columns of the mapping under it."""
    lines = [dict(_cells(row)) for row in rows]
    columns = list(dict.fromkeys(column for line in lines for column in line))
    cells = [[line.get(column, NOTHING) for column in columns] for line in lines]
    groups = [(name, len(list(own))) for name, own in groupby(group for group, _ in columns)]
    heads = [head for _, head in columns]
    looks = [_look(head, [row[place] for row in cells], place == 0) for place, head in enumerate(heads)]
    filters = [str(row.get(ROWS, "")) for row in rows]
    return Table(groups if any(name for name, _ in groups) else [], heads, looks, cells, filters)


def _cells(row: Row) -> Iterator[tuple[tuple[str, str], Any]]:
    for key, value in row.items():
        if key == ROWS:
            continue
        for head, cell in value.items() if isinstance(value, Mapping) else [(None, value)]:
            yield (("", key) if head is None else (key, head)), cell


def _look(head: str, cells: Sequence[Any], first: bool) -> str:
    """Numbers stand at the right, text at the left; a column's head says whose it is."""
    texts = [str(cell) for cell in cells]
    if max(map(len, texts), default=0) > 45:
        return "wrap"
    if first or any(re.match(r"[^\W\d]", text) for text in texts):
        return "left"
    return {"here": "mine", "ours": "mine"}.get(head, "theirs" if "paper" in head else "")


@cache
def environment() -> Environment:
    """The templates, which may say what `counts` prints; what is put into a page is text, and bears a typesetter's
    apostrophes."""
    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_typographic,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters |= {"breakable": _breakable, "percent": percent}
    templates.globals |= vars(counts) | {"laid_out": laid_out, "labelled": _labelled}
    return templates


def told(
    runs: Sequence[Run], heading: str, template: str, content: Mapping[str, Any], **more: Any
) -> Section:
    """A section whose sentences its template says, each with its verdict: `{% call result(kind, met, n) %}` around it
    in the macro `results`.

    A sentence is given as `Result` is; with the `n` trials that carry its verdict also as `judged` is, without its full
    stop.
    """
    found: list[Result] = []

    def result(
        kind: Kind | None = None,
        met: bool | None = None,
        n: int | None = None,
        *,
        goal: bool = False,
        better: bool | None = None,
        caller: Callable[[], Markup],
    ) -> str:
        text = " ".join(caller().unescape().split()).replace("\u2019", "'")  # plain, for a terminal too
        if n is None or kind is None:
            found.append(Result(kind, text, met, goal, better))
        else:
            found.append(judged(kind, text, met, n, goal, better))
        return ""

    content = {"kind": kind_of(runs), "trials": sum(len(run.trials) for run in runs), **content}
    _module(template, content, runs[0]).results(result)
    return Section(heading, content, template, summary=found, **more)


def rendered(section: Section, run: Run) -> tuple[Markup, list[Markup]]:
    """A section's body by its template, and what is ours and not the paper's, one sentence each.

    The template is given the section's content, and on what bench the run is.
    """
    module = _module(section.template, section.content, run)
    ours = module.ours().split("<li>") if hasattr(module, "ours") else []
    return Markup(module), [each for text in ours if (each := text.strip())]


def _module(name: str, content: Mapping[str, Any], run: Run) -> Any:
    bench = {"simulated": run.simulated, "bench": run.manifest.get("bench")}
    return environment().get_template(f"{name}.html.j2").make_module({**content, "content": content, **bench})


def _labelled(svg: str, caption: Markup) -> Markup:
    """A picture with its caption as its label for a screen reader."""
    return Markup(str(svg).replace("<svg", f'<svg aria-label="{escape(caption.striptags())}"', 1))


def _breakable(name: str) -> Markup:
    """A column's name, such as a setting's path, that may go on in the next line after each of its parts."""
    return Markup(str(escape(_typographic(name))).replace(".", ".<wbr>").replace("_", "_<wbr>"))


def _typographic(value: object) -> object:
    if type(value) is not str:  # Markup is left alone
        return value
    # a number and its sign stay in one line
    return value.replace("'", "\u2019").replace(" %", "\u00a0%").replace(" °", "\u00a0°")
