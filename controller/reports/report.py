"""One self-contained page about one or several runs, its figures, and its lines for a terminal, from recordings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

from markupsafe import Markup

from controller.own_modules import KindError, own_folders
from controller.recording.reader import Run
from controller.recording.run_folder import RecordingError
from controller.registry import ExperimentKind, experiment_of
from controller.reports import generic
from controller.reports.counts import Row, missing
from controller.reports.figures import Figures
from controller.reports.first_screen import (
    again,
    agreement_of,
    beside_each_other,
    did,
    goals_of,
    headline_of,
    went,
)
from controller.reports.hero import Drawn, hero_of
from controller.reports.papers import AUTHORS, CITATION, settings_in
from controller.reports.run_account import early_end, experiment_in, facts_of, setting_of
from controller.reports.section import (
    Comparing,
    Headline,
    Kind,
    Result,
    Section,
    environment,
    laid_out,
    rendered,
)
from controller.reports.settings import by_settings, differences, settings_table
from controller.reports.trial_signals import payload, trial_table
from controller.scales import NOTHING, scale_of

PAGE = 1_800_000
"""What a page may take, bytes: signals fill what the rest leaves, so that it opens at once and goes by mail."""

MOST_ALIKE = 4
"""Most numbers that the sentence of several parts names."""

LEAST_ROOM = 400_000
"""What signals take at least, however large the rest is, bytes."""

_SIGNALS = "\0signals\0"
"""Stands in the page where the signals go; no text has such letters."""

_OURS = {
    "ur_arm": "The arm is a Universal Robots one (the papers': Stäubli RX-90, Kinova Gen3).",
    "can_gripper": "The gripper is an SSG-48 (the papers': BarrettHand, Robotiq 2F-85).",
    "zaber_stage": "The stage is a Zaber one; the paper does not name its own.",
    "sensor_board": "A sensor board digitises what the papers read with converters of their own.",
}
"""Driver → what stands in for the papers' device."""


def build_report(runs: Sequence[Run], out: Path | None = None, also: Sequence[str] = ()) -> Path:
    """Write the report as `build_report_with_summary` does, and give the page alone."""
    return build_report_with_summary(runs, out, also=also)[0]


def build_report_with_summary(
    runs: Sequence[Run],
    out: Path | None = None,
    title: str = "",
    paper: Sequence[Mapping[str, str]] = (),
    also: Sequence[str] = (),
) -> tuple[Path, list[str]]:
    """Write `report.html` and `figures/`; returns the page and its summary in lines for a terminal.

    Args:
        runs: Of one experiment or several; trials of one experiment on one kind of bench are pooled where
            their settings are equal, and stand apart where they differ.
        out: Folder to write to; by default that of the run, or of several `report_A_B` beside the last.
        title: Of the page; by default what its parts make of it.
        paper: Tables and figures of a paper: `item`, what it `shows`, the `part` (a profile) that repeats it, why that
            `differs`.
        also: Formats of figures beside SVG.

    Raises:
        RecordingError: it cannot be written.
    """
    if not runs:
        raise ValueError("a report needs at least one run")
    runs = list({run.folder.path: run for run in runs}.values())
    folder = out or _beside(runs)
    path = folder / "report.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        page, parts = _page(runs, folder / "figures", title, paper, also)
        temporary = path.with_suffix(".html.tmp")
        temporary.write_text(page, "utf-8")
        temporary.replace(path)
    except OSError as error:
        raise RecordingError(path, "writing", error, option="") from error
    lines = [line for part in parts for line in terminal_lines(part)]
    return path, [*lines, *guard_lines(runs), _verdict(runs, parts)[0]]


def comparison_page(first: Run, second: Run, comparing: Comparing) -> tuple[str, str]:
    """A page on two runs, which are never pooled on it, and its sentence of verdict."""
    runs = [first, second] if first.folder.path != second.folder.path else [first]
    title = " beside ".join(_told_apart(runs))
    page, parts = _page(runs, None, title, (), (), comparing)
    return page, _verdict(runs, parts, comparing=True)[0]


def _beside(runs: Sequence[Run]) -> Path:
    """Where the page goes: into one run's folder; of several into none, for each has a page of its own."""
    last = runs[-1].folder.path
    if len(runs) == 1:
        return last
    names = [run.folder.path.name for run in runs]
    more = f"_and_{len(runs) - 2}_more" if len(runs) > 2 else ""
    return last.parent / f"report_{names[0]}_{names[-1]}{more}"


def _page(
    runs: Sequence[Run],
    figures_path: Path | None,
    title: str,
    paper: Sequence[Mapping[str, str]],
    also: Sequence[str],
    comparing: Comparing | None = None,
) -> tuple[str, Sequence[SectionPart]]:
    parts: list[SectionPart] = []
    apart: list[Sequence[Row]] = []
    kinds: dict[tuple[str, str], list[Run]] = {}
    groups: Mapping[str, Sequence[Run]]
    for run in runs:
        kinds.setdefault((experiment_in(run), str(run.manifest.get("bench", ""))), []).append(run)
    for (experiment, bench), members in kinds.items():
        if comparing:
            groups = {name: [run] for name, run in zip(_told_apart(members), members, strict=True)}
        else:
            groups = _named(bench, by_settings(members, not _experiment(members[-1]).pooled))
            apart += [differences(groups)] if len(groups) > 1 else []
        for number, (name, group) in enumerate(groups.items(), start=1):
            folder = figures_path
            if folder and len(kinds) * len(groups) > 1:
                folder = folder / f"{experiment}_{bench}" / (str(number) if len(groups) > 1 else "")
            marked = "partly simulated" if group[0].measured_by else "simulated" * group[0].simulated
            figures = Figures(folder, simulated=marked, prefix=f"s{len(parts)}", also=also, page=runs)
            whole = [run for run in members if run.folder.path in {part.folder.path for part in group}]
            parts.append(_part(experiment, name, group, missing(whole), figures))
    papers = list(dict.fromkeys(part.section.paper for part in parts if part.section.paper))
    tables = [table for run in runs for table in run.resolved.get("devices", {}).values()]
    ours = [_OURS[driver] for table in tables if (driver := str(table.get("driver"))) in _OURS]
    ours += [text for part in parts for text in part.ours]
    real = list(dict.fromkeys(name for run in runs for name in run.measured_by))
    heading = title or (setting_of(runs[0], "title") if len(runs) == 1 else "")
    facts: dict[str, Any] = {
        "heading": heading or " and ".join(dict.fromkeys(part.section.title for part in parts)),
        "contents": _contents(paper, parts),
        "citations": [CITATION.get(each, each) for each in papers],
        "authors": [AUTHORS[each] for each in papers if each in AUTHORS],
        "simulated": any(run.simulated for run in runs),
        "all_simulated": all(run.simulated for run in runs) and not real,
        "real": ", ".join(real),
        "kinds": any(each.kind not in (None, Kind.MEASURED) for part in parts for each in part.results),
        "ours": list(dict.fromkeys(ours)),
        "parts": parts,
        "apart": apart,
        "comparing": comparing,
        "ends": [end for run in runs if (end := early_end(run)) is not None],
        "runs": [(run.folder.path.name, run.notes, facts_of(run)) for run in runs],
        "verdict": _verdict(runs, parts, comparing is not None),
        "again": list(dict.fromkeys(again(run) for run in runs)),
        "summary": _experiment(runs[-1]).summary if len(kinds) == 1 else "",
        "started": str(runs[0].manifest.get("started_utc", "?"))[:19].replace("T", " "),
        "trials": trial_table(runs),
    }
    # rendered once, around the place of the signals: they may take what the rest leaves
    page = environment().get_template("report.html.j2").render(**facts, signals=Markup(_SIGNALS))
    before, after = page.split(_SIGNALS)
    room = max(LEAST_ROOM, PAGE - len(before.encode()) - len(after.encode()))
    return f"{before}{payload(runs, room, {each.key for part in parts for each in part.drawn})}{after}", parts


def _verdict(runs: Sequence[Run], parts: Sequence[SectionPart], comparing: bool = False) -> tuple[str, str]:
    """Of all parts in one sentence, and how they went, of `WENT`; with their numbers where a few measure the same."""
    heads = [part.headline for part in parts]
    if len(parts) == 1:
        return heads[0].verdict, heads[0].state
    pair = [part.runs for part in parts] if comparing and heads[0].column == heads[1].column else []
    if pair and (said := beside_each_other(*pair)):
        return said, ""
    good = sum(run.succeeded(row) for run in runs for row in run.trials)
    states = {head.state for head in heads}
    state = states.pop() if len(states) == 1 else "well" if states == {"well", ""} else "partly"
    state = "broken" if "broken" in states else state
    alike = len({head.what for head in heads}) == 1 and len(heads) <= MOST_ALIKE
    ours = (" beside " if len(heads) == 2 else ", ").join(head.ours for head in heads)
    beside = f"; {heads[0].what}: {ours}" if alike else ""
    words = {did(experiment_in(part.runs[-1]), part.runs) for part in parts if part.runs[0].trials}
    done = words.pop() if len(words) == 1 else "ended as meant"
    results = [result for part in parts for result in part.results]
    agreement = agreement_of(results)
    papers = f"; of the paper's own results {agreement}" if agreement and not comparing else ""
    n = sum(max(len(run.trials), int(run.manifest.get("trials") or 0)) for run in runs)
    count = f"{good} of {n} trials {done}, in {len(parts)} parts"
    return f"{went(state, runs)}: {count}{beside}{goals_of(results)}{papers}.", state


def _named(bench: str, groups: Sequence[Sequence[Run]]) -> dict[str, Sequence[Run]]:
    """Groups of runs by a name: their profiles where these differ, else numbers."""
    names = [", ".join(dict.fromkeys(_profile(run) for run in group)) for group in groups]
    if len(set(names)) < len(names):
        numbered = {f"settings {number}": group for number, group in enumerate(groups, start=1)}
        own = [row for row in differences(numbered) if row["setting"] != "runs"]
        label = f"{scale_of(own[0]['setting']).label} " if len(own) == 1 else ""
        names = [f"{bench}, {label}{own[0][name]}" if label else f"{bench}, {name}" for name in numbered]
    return dict(zip(names if len(groups) > 1 else [bench], groups, strict=True))


def _told_apart(runs: Sequence[Run]) -> Sequence[str]:
    """Runs by their profiles where these differ, else by their folders."""
    names = [_profile(run) for run in runs]
    return names if len(set(names)) == len(runs) else [run.folder.path.name for run in runs]


def _profile(run: Run) -> str:
    return str((run.manifest.get("profile") or {}).get("name", "?"))


def _contents(paper: Sequence[Mapping[str, str]], parts: Sequence[SectionPart]) -> list[Row]:
    """A paper's tables and figures, with links to the parts of the page that repeat each."""
    rows: list[Row] = []
    for item in paper:
        links = Markup(", ").join(
            Markup('<a href="#part{}">{}</a>').format(number, part.section.title)
            for number, part in enumerate(parts, start=1)
            if item["part"] in map(_profile, part.runs)
        )
        here = links or ("not run" if item["part"] else NOTHING)
        heads = ("paper", "what it shows", "here", "why ours differs")
        rows.append(dict(zip(heads, (item["item"], item["shows"], here, item["differs"]), strict=True)))
    return rows


def _part(experiment: str, name: str, runs: Sequence[Run], lost: str, figures: Figures) -> SectionPart:
    own = _experiment(runs[-1]).report
    section: Section = (
        import_module(own).section(runs, figures) if own else generic.section(experiment, runs, figures)
    )
    results = [Result(None, lost)] if lost else []
    results += [each._replace(met=None) if lost else each for each in section.summary]
    printed = {**settings_in(section.paper, runs[0]), **section.printed}
    body, ours = rendered(section, runs[0])
    return SectionPart(
        name,
        runs,
        section,
        results,
        settings_table(runs[0], printed),
        Markup(FIGURE.sub("", body)),  # figures stand before what is said about them
        ours,
        headline_of(experiment, runs, results, section.headline, bool(lost)),
        hero_of(experiment, runs, figures.page or runs) if section.shows_trials else [],
        [Markup(each) for each in FIGURE.findall(body)],
    )


def _experiment(run: Run) -> ExperimentKind:
    """What a run measured; of the user's own that is not there any more, what reports any experiment."""
    try:
        return experiment_of(experiment_in(run), own_folders(run.manifest))
    except KindError as error:
        return ExperimentKind(
            "", f"Its own module is not found ({error}): this is the section of any experiment."
        )


FIGURE = re.compile(r"<figure>.*?</figure>\s*", re.DOTALL)

MARKS = {
    "same": "= as the paper",
    "better": "▲ better than the paper",
    "worse": "▼ worse than the paper",
    "apart": "≠ not as the paper",
    "met": "✓ goal met",
    "missed": "✗ goal missed",
    "neither": "· not judged",
}
"""Marks and what they mean, for a terminal; the page has it beside its summary."""

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
        ours: What is ours and not the paper's, one sentence each.
        pictures: Its figures, which stand before the text.
    """

    name: str
    runs: Sequence[Run]
    section: Section
    results: Sequence[Result]
    settings: Sequence[Row]
    body: str
    ours: Sequence[str]
    headline: Headline
    drawn: Sequence[Drawn]
    pictures: Sequence[Markup]

    @property
    def agreement(self) -> str:
        """How many of the paper's results come out here, and how many better or worse."""
        return agreement_of(self.results)


def terminal_lines(part: SectionPart) -> Iterator[str]:
    """A part's name, its table where it has one, and its results, those that may be judged before the others."""
    yield f"{part.section.title}, {part.name}"
    if part.section.terminal:
        yield from _rows(part.section.terminal)
    for result in part.results:
        yield f"{MARKS[result.mark][0]} {result.text}"
    used = {result.mark for result in part.results}
    if used - {"neither"}:
        yield f"({', '.join(said for mark, said in MARKS.items() if mark in used)})"


def guard_lines(runs: Sequence[Run]) -> Iterator[str]:
    """What ended runs early, or one line that nothing did; and what was lost."""
    ends = [end for run in runs if (end := early_end(run)) is not None]
    for end in ends:
        yield f"{end.what}: {end.name}. {' '.join(end.stops) or end.reason}"
    if not ends:
        yield "The guard had nothing to stop."
    lost = [(stream, n) for run in runs for stream, n in (run.manifest.get("loss") or {}).items() if n]
    if lost:
        yield f"Samples lost: {', '.join(f'{n} of {stream}' for stream, n in lost)}."


def _rows(rows: Sequence[Row]) -> Iterator[str]:
    table = laid_out(rows)
    lines = [table.heads, *([str(cell) for cell in row] for row in table.rows)]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    each = iter(widths)
    spans = [name.ljust(sum(islice(each, n)) + len(GAP) * (n - 1)) for name, n in table.groups]
    if spans:
        yield GAP.join(spans).rstrip()
    for line in lines:
        looks = zip(line, widths, table.looks, strict=True)
        cells = [cell.ljust(width) if look == "left" else cell.rjust(width) for cell, width, look in looks]
        yield GAP.join(cells).rstrip()
