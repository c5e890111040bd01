"""The table of all trials, which the page sorts and filters."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from controller.recording.reader import Run
from controller.reports.generic import is_number
from controller.reports.trial_signals import key_of
from controller.scales import scale_of

_DATE = re.compile(r"^\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ_")
"""What a run folder's name begins with; the rest distinguishes it."""


class Trials(NamedTuple):
    """Every trial of some runs.

    Attributes:
        names: Of the columns, each as trials.csv has it and as it is headed; the run first where there are several.
        rows: Each a key, by which its signals are found, and its cells: what is shown, and a number's exact value.
    """

    names: Sequence[tuple[str, str]]
    rows: Sequence[tuple[str, Sequence[tuple[str, str]]]]


def trial_table(runs: Sequence[Run]) -> Trials:
    """The trials of some runs, run by run."""
    names = list(dict.fromkeys(name for run in runs for row in run.trials for name in row)) or ["trial"]
    names.sort(key=lambda name: "." in name)  # varied settings last: what was measured fits a screen
    rows = []
    for run in runs:
        for row in run.trials:
            cells = [
                ("" if row.get(name) is None else scale_of(name).cell(row[name]), _exact(row.get(name)))
                for name in names
            ]
            cells[1:1] = [(_DATE.sub("", run.folder.path.name), "")] if len(runs) > 1 else []
            rows.append((key_of(runs, run, int(row["trial"] or 0)), cells))
    names[1:1] = ["run"] if len(runs) > 1 else []
    return Trials([(name, scale_of(name).heading) for name in names], rows)


def _exact(value: object) -> str:
    return repr(value) if is_number(value) else ""
