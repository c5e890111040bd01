"""Two runs beside each other: which settings differ, and by how much what was measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from controller.measures import meanings_of
from controller.outcomes import UNMEASURED
from controller.recording.reader import Run
from controller.recording.run_folder import RecordingError, RunFolderError
from controller.reports.counts import Row, half_width, mean_of
from controller.reports.generic import with_spread
from controller.reports.section import Comparing
from controller.reports.settings import flat
from controller.reports.trial_signals import is_instant, shown_as
from controller.scales import Scale, scale_of

SECOND = " (second)"
"""Ends the names of the second run's columns."""


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
    pairs = _pairs(first, second)
    yield f"{len(pairs)} pairs of trials, of {len(first.trials)} and {len(second.trials)}"
    same = int((pairs["outcome"] == pairs[f"outcome{SECOND}"]).sum()) if len(pairs) else 0
    yield f"outcome: equal in {same}"
    for column in first.table.columns:
        if f"{column}{SECOND}" in pairs and column != "outcome":
            line = _difference(scale_of(column), pairs[column], pairs[f"{column}{SECOND}"])
            if line:
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


def _pairs(first: Run, second: Run) -> pd.DataFrame:
    """A row for each trial that both have measured, the second's columns behind the first's."""
    keys = ["trial", *_factors(first, second)]
    # as objects: a factor may be a number in one run and a word in the other
    tables = (run.table.astype(dict.fromkeys(keys, object)) for run in (first, second))
    one, other = (table[~table["outcome"].isin(UNMEASURED)] for table in tables)
    return one.merge(other, on=keys, suffixes=("", SECOND))


def _tables(first: Run, second: Run) -> tuple[list[Row], list[Row]]:
    """What was measured in each run and by how much it differs; and every pair of trials."""
    pairs = _pairs(first, second)
    columns = [name for name in first.table.columns if f"{name}{SECOND}" in pairs]
    both = {name: (name, f"{name}{SECOND}") for name in columns}
    found = {name: [pd.to_numeric(pairs[each], errors="coerce") for each in both[name]] for name in columns}
    numbers = [name for name in columns if all(values.notna().any() for values in found[name])]
    meanings = meanings_of(first)
    numbers = [name for name in numbers if not is_instant(name, meanings.get(name, ""))]
    scales = {name: shown_as(name, list(pd.concat(found[name]).dropna())) for name in numbers}
    rows: list[Row] = []
    for name in numbers:
        heading, factor = scales[name].heading, scales[name].factor
        one, other = (with_spread(mean_of(values.dropna()), factor) for values in found[name])
        off = _difference(scales[name], *found[name]).removeprefix(f"{heading}: ")
        heads = ("measured", "first: mean ± σ (n)", "second", "second less first, mean (95 %)")
        rows.append(dict(zip(heads, (heading, one, other, off), strict=True)))
    every: list[Row] = []
    for pair in pairs.to_dict("records"):
        line: dict[str, Any] = {}
        for name in ("trial", *_factors(first, second)):
            line |= {scale_of(name).heading: _cell(scale_of(name), pair[name])}
        for name in ("outcome", *numbers):
            scale = scales.get(name) or scale_of(name)
            cells = [_cell(scale, pair[each]) for each in both[name]]
            line[scale.heading] = dict(zip(("first", "second"), cells, strict=True))
        every.append(line)
    return rows, every


def _cell(scale: Scale, value: Any) -> str:
    return "" if pd.isna(value) else scale.cell(value)


def _difference(scale: Scale, one: pd.Series[Any], other: pd.Series[Any]) -> str:
    """The mean of second less first over the pairs that have both, with Student's interval."""
    after, before = (pd.to_numeric(each, errors="coerce") for each in (other, one))
    found = (after - before).dropna().tolist()
    if not found:
        return ""
    mean, half = mean_of(found), half_width(mean_of(found))
    ends = (
        f" ({scale.cell(mean.mean - half)} to {scale.cell(mean.mean + half)})" if math.isfinite(half) else ""
    )
    sign = "+" * (mean.mean >= 0.0)
    return f"{scale.heading}: {sign}{scale.cell(mean.mean)}{ends}, n = {mean.n}"


def _factors(first: Run, second: Run) -> list[str]:
    """The columns of what was varied in both."""
    return [name for name in first.table.columns if name in first.factors and name in second.factors]
