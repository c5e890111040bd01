"""The settings behind a page: which runs may be averaged, what differs between the others, what the paper has."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from controller.recording.reader import Run
from controller.reports.counts import Row
from controller.reports.section import Printed
from controller.scales import NOTHING

_NO_EFFECT = ("title", "description", "trials")
"""Parts of a profile that change no trial: two runs that differ in these alone may be averaged."""


def settings_of(run: Run) -> Mapping[str, Any]:
    """What of a run's resolved profile changes its trials."""
    settings = {name: value for name, value in run.resolved.items() if name not in _NO_EFFECT}
    # where a device is plugged in is no setting of a trial; runs on different kinds of bench are separated before
    own = {
        name: {key: table[key] for key in table if key != "port"}
        for name, table in run.resolved.get("devices", {}).items()
    }
    return settings | {"devices": own}


def by_settings(runs: Sequence[Run], apart: bool) -> list[list[Run]]:
    """Runs of equal settings together.

    Args:
        runs: Of one experiment on one kind of bench.
        apart: Whether trials in which a setting was varied stand apart from the others as well; a section that
            separates them by itself is given them together.
    """
    groups: dict[str, list[Run]] = {}
    for run in runs:
        for varied, part in _parts(run) if apart else [("", run)]:
            key = json.dumps(settings_of(run), sort_keys=True, default=str) + varied
            groups.setdefault(key, []).append(part)
    return list(groups.values())


def varied_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of the profile that a trial varied, by path."""
    return {name: value for name, value in row.items() if "." in name and value is not None}


def _parts(run: Run) -> list[tuple[str, Run]]:
    """A run's trials by the settings that they varied, each part with the manifest of a run of so many trials."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in run.trials:
        found.setdefault(json.dumps(varied_of(row), sort_keys=True), []).append(row)
    if len(found) < 2:
        return [(varied, run) for varied in found or ("",)]
    return [
        (varied, replace(run, trials=rows, manifest={**run.manifest, "trials": len(rows)}))
        for varied, rows in found.items()
    ]


def differences(groups: Mapping[str, Sequence[Run]]) -> list[Row]:
    """The runs of named groups, and one row a setting that differs between them: its path, and each group's value."""
    tables, runs = {}, {}
    for name, group in groups.items():
        own = varied_of(group[0].trials[0]) if group[0].trials else {}
        tables[name] = dict(flat(settings_of(group[0]))) | own
        runs[name] = ", ".join(dict.fromkeys(run.folder.path.name for run in group))
    rows: list[Row] = [{"setting": "runs", **runs}]
    for path in sorted(set().union(*tables.values())):
        values = {name: shown(table.get(path)) for name, table in tables.items()}
        rows += [{"setting": path, **values}] if len(set(values.values())) > 1 else []
    return rows


def settings_table(run: Run, printed: Mapping[str, Printed]) -> list[Row]:
    """Detectors, behavior and limits as (what, ours, the paper's): what the paper prints first, the rest by table."""
    settings = settings_of(run)
    usual = dict(flat(settings))
    leaves = dict(usual)
    for path in dict.fromkeys(name for row in run.trials for name in varied_of(row)):
        base = usual.get(path)
        values = [*dict.fromkeys(shown(varied_of(row).get(path, base)) for row in run.trials)]
        leaves[path] = values[0] if len(values) == 1 else f"{shown(base)} (varied: {', '.join(values)})"
    rows: list[Row] = [
        {"setting": path, "here": shown(leaves[path]), "the paper": f"{shown(paper.value)} ({paper.source})"}
        for path, paper in printed.items()
        if path in leaves
    ]
    for name in (*(f"detectors.{name}" for name in settings.get("detectors") or ()), "behavior", "limits"):
        own = [path for path in usual if path.startswith(f"{name}.") and path not in printed]
        if own:
            rest = ", ".join(f"{path.removeprefix(f'{name}.')} {shown(leaves[path])}" for path in own)
            rows.append({"setting": name, "here": rest, **({"the paper": NOTHING} if printed else {})})
    return rows  # an experiment of no paper has nothing to stand beside


def flat(
    value: Mapping[str, Any],
    prefix: str = "",
    joint: str = ".",
    whole: Callable[[Mapping[str, Any]], bool] = lambda _: False,
) -> Iterator[tuple[str, Any]]:
    """Every setting by its dotted path; a list of tables by the number of each, and a table that stays `whole` as it
    is."""
    for name, item in value.items():
        path = f"{prefix}{name}"
        if isinstance(item, Mapping) and not whole(item):
            yield from flat(item, f"{path}{joint}", joint, whole)
        elif isinstance(item, list) and item and all(isinstance(each, Mapping) for each in item):
            yield path, f"{len(item)} entries"
            numbered = {str(place): each for place, each in enumerate(item, start=1)}
            yield from flat(numbered, f"{path}{joint}", joint, whole)
        else:
            yield path, item


def shown(value: object) -> str:
    """A setting's value as it is read."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {shown(each)}" for name, each in value.items())
    return ", ".join(map(shown, value)) or "none" if isinstance(value, list) else str(value)
