"""Two runs beside each other: which settings differ, and by how much what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from controller.measures import columns_of
from controller.recording.reader import Run
from controller.recording.run_folder import RecordingError, RunFolderError
from controller.reports.counts import Row, Trials, half_width, mean_of, pairs_of, with_spread
from controller.reports.section import Comparing
from controller.reports.settings import flat
from controller.reports.trial_signals import is_instant, shown_as
from controller.scales import Scale, scale_of


def compared(first: Run, second: Run) -> Iterator[str]:
    """What differs between two runs, a line each.

    Trials are paired by their number, as long as both have the same factors there.

    Raises:
        RunFolderError: a run in which no trial has ended.
    """
    for run in (first, second):
        if not run.trials:
            raise RunFolderError(f"{run.folder.path}: no trial has ended, so there is nothing to compare")
    one, other = (
        dict(flat(manifest["profile"]["resolved"])) | {key: manifest[key] for key in ("commit", "seed")}
        for manifest in (first.manifest, second.manifest)
    )
    for key in sorted(one.keys() | other.keys()):
        if one.get(key) != other.get(key) and not key.startswith("trials."):
            yield f"{key}: {one.get(key, 'absent')} → {other.get(key, 'absent')}"
    names, pairs = _compared(first, second)
    yield f"{len(pairs)} pairs of trials, of {len(first.trials)} and {len(second.trials)}"
    yield f"outcome: equal in {sum(one['outcome'] == other['outcome'] for one, other in pairs)}"
    for name in names:
        if line := _difference(scale_of(name), name, pairs):
            yield line


def side_by_side(first: Run, second: Run, lines: Sequence[str]) -> tuple[Path, str]:
    """Write the report of both, each in a part of its own, with tables and figures of both beside each other, into the
    second run's folder.

    Returns:
        The page, and its sentence of verdict.

    Raises:
        RecordingError: it cannot be written.
    """
    from controller.reports.report import comparison_page  # what draws is loaded where something is drawn

    path = second.folder.path / "compare.html"
    means, pairs = _tables(first, second) if first.trials and second.trials else ([], [])
    others = [line for line in lines if ", n = " not in line]  # those with n are in the table
    page, verdict = comparison_page(first, second, Comparing(others, means, pairs))
    try:
        path.write_text(page, "utf-8")
    except OSError as error:
        raise RecordingError(path, "writing", error, option="") from error
    return path, verdict


def _compared(first: Run, second: Run) -> tuple[list[str], list[tuple[Row, Row]]]:
    """Columns that both runs have, but for those that pair trials; and every pair of trials that both measured."""
    keys = {"trial", "outcome", *_factors(first, second)}
    names = [name for name in first.trials[0] if name in second.trials[0] and name not in keys]
    return names, pairs_of(first, second, Trials.of([first]), Trials.of([second]))


def _tables(first: Run, second: Run) -> tuple[list[Row], list[Row]]:
    """What was measured in each run and by how much it differs; and every pair of trials."""
    names, pairs = _compared(first, second)
    sides = [Trials(each) for each in zip(*pairs, strict=True)] or [Trials(), Trials()]
    meanings = columns_of(first.manifest.get("experiment"))
    numbers = [name for name in names if not is_instant(name, meanings.get(name, ""))]
    numbers = [name for name in numbers if all(side.values(name) for side in sides)]
    scales = {name: scale_of(name) for name in ("trial", *_factors(first, second), "outcome")}
    scales |= {
        name: shown_as(name, [cell for side in sides for cell in side.values(name)]) for name in numbers
    }
    heads = ("measured", "first: mean ± σ (n)", "second", "second less first, mean (95 %)")
    rows: list[Row] = []
    for name in numbers:
        heading, factor = scales[name].heading, scales[name].factor
        means = [with_spread(side.mean(name), factor) for side in sides]
        off = _difference(scales[name], name, pairs).removeprefix(f"{heading}: ")
        rows.append(dict(zip(heads, (heading, *means, off), strict=True)))
    every: list[Row] = []
    for pair in pairs:
        line: dict[str, Any] = {}
        for name, scale in scales.items():
            cells = ["" if (cell := row.get(name)) is None else scale.cell(cell) for row in pair]
            beside = dict(zip(("first", "second"), cells, strict=True))
            line[scale.heading] = beside if name in ("outcome", *numbers) else cells[0]
        every.append(line)
    return rows, every


def _difference(scale: Scale, name: str, pairs: Sequence[tuple[Row, Row]]) -> str:
    """The mean of second less first over the pairs that have both, with Student's interval."""
    known = [Trials(pair).values(name) for pair in pairs]
    mean = mean_of(each[1] - each[0] for each in known if len(each) == 2)
    if not mean.n:
        return ""
    ends, half = "", half_width(mean)
    if math.isfinite(half):
        ends = f" ({scale.cell(mean.mean - half)} to {scale.cell(mean.mean + half)})"
    sign = "+" * (mean.mean >= 0.0)
    return f"{scale.heading}: {sign}{scale.cell(mean.mean)}{ends}, n = {mean.n}"


def _factors(first: Run, second: Run) -> list[str]:
    """The columns of what was varied in both."""
    return [name for name in first.factors if name in second.factors]
