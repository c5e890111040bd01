"""One self-contained page about one or several runs, and its figures, from recordings alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from itertools import groupby
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from controller.recording.reader import Run
from controller.recording.run_folder import RecordingError
from controller.reports.counts import judged
from controller.reports.figures import Figures
from controller.reports.run_account import account_of, setting_of
from controller.reports.section import Section
from controller.reports.text import title

_SECTIONS = {
    "aura": "controller.reports.aura",
    "centering": "controller.reports.centering",
    "chirp": "controller.reports.chirp",
    "pointer": "controller.reports.pointer",
    "slip": "controller.reports.slip",
    "static": "controller.reports.static",
    "transient": "controller.reports.transient",
    "weights": "controller.reports.weights",
}
"""Experiment → module whose `section(runs, figures)` tells of it; another one gets its bare table."""

_OURS = (
    "An arm on this bench is a Universal Robots one (the papers': Stäubli RX-90, Kinova Gen3), a gripper an SSG-48 "
    "(theirs: BarrettHand, Robotiq 2F-85); stage, sensor board and this program stand in for theirs."
)
_SIMULATED = (
    "Numbers and figures from mock and emulated benches are simulated: they come from a model of finger and object, "
    "not from a finger."
)


def build_report(runs: Sequence[Run], out: Path | None = None) -> Path:
    """Write `report.html` and `figures/`.

    Args:
        runs: What to tell of, one experiment or several; trials of one experiment on one kind of bench are pooled.
        out: Folder to write to; by default that of the last run.

    Returns:
        The page.

    Raises:
        RecordingError: it cannot be written.
    """
    if not runs:
        raise ValueError("a report needs at least one run")
    folder = out or runs[-1].folder.path
    path = folder / "report.html"
    try:
        page = _page(runs, folder / "figures")
        temporary = path.with_suffix(".html.tmp")
        temporary.write_text(page, "utf-8")
        temporary.replace(path)
    except OSError as error:
        raise RecordingError(path, "writing", error) from error
    return path


def _page(runs: Sequence[Run], figures_path: Path) -> str:
    def kind(run: Run) -> tuple[str, str]:
        return str(run.manifest.get("experiment", "")), str(run.manifest.get("bench", ""))

    groups = [(key, list(group)) for key, group in groupby(sorted(runs, key=kind), key=kind)]
    sections: list[tuple[str, Section]] = []
    for (experiment, bench), members in groups:
        folder = figures_path if len(groups) == 1 else figures_path / f"{experiment}_{bench}"
        figures = Figures(folder, simulated=members[0].simulated, prefix=f"s{len(sections)}")
        sections.append((bench, _section(experiment, members, figures)))
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        finalize=_typographic,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    first = runs[0]
    simulated = any(run.simulated for run in runs)
    ours = [_OURS, *dict.fromkeys(text for _, section in sections for text in section.not_the_papers)]
    heading = setting_of(first, "title") if len(runs) == 1 else None
    return environment.get_template("report.html.j2").render(
        heading=heading or " and ".join(dict.fromkeys(section.title for _, section in sections)),
        citations=list(dict.fromkeys(section.citation for _, section in sections if section.citation)),
        simulated=simulated,
        all_simulated=all(run.simulated for run in runs),
        simulated_says=_SIMULATED,
        ours=ours,
        sections=sections,
        accounts=[account_of(run) for run in runs],
        started=str(first.manifest.get("started_utc", "?"))[:19].replace("T", " "),
    )


def _typographic(value: object) -> object:
    return value.replace("'", "\u2019") if type(value) is str else value  # Markup is left alone


def _section(experiment: str, runs: Sequence[Run], figures: Figures) -> Section:
    if experiment in _SECTIONS:
        tell: Callable[[Sequence[Run], Figures], Section] = import_module(_SECTIONS[experiment]).section
        told = tell(runs, figures)
        return replace(told, summary=judged(runs, told.summary))
    columns = list(dict.fromkeys(name for run in runs for row in run.trials for name in row))
    trials = [row for run in runs for row in run.trials]
    rows = [["" if row.get(name) is None else str(row[name]) for name in columns] for row in trials]
    return Section(title(experiment) or "trials", "bare.html.j2", {"columns": columns, "rows": rows})
