"""What the papers print, to stand beside what is measured here: tables as CSV files, beside this one.

Light contact's place and lock, and the sensors of which noise or structure had to be assumed, make what follows from
them an assumption (`kind`); both ends of the static frequencies, and the forces of the `fitted` rows of Table I, were
fitted (docs/explanation/finger_physics.md, docs/explanation/slip.md). How close a static frequency counts as reproduced
(`tolerance_hz`) is ours: the paper has only "approximately". Table I's zero of the micrometer is taken as distal.
"""

import csv
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from controller.recording.reader import Run
from controller.reports.run_account import setting_of
from controller.reports.section import Printed

CITATION = {
    "backus": "S. B. Backus and A. M. Dollar, “Robust, Inexpensive Resonant Frequency Based Contact Detection for "
    "Robotic Manipulators”",
    "fernandez": "R. Fernandez, I. Payo, A. S. Vazquez and J. Becedas, “Micro-Vibration-Based Slip Detection in "
    "Tactile Force Sensors”, Sensors 2014, 14",
    "rupavatharam": "S. Rupavatharam, C. Escobedo, D. Lee, C. Prepscius, L. Jackel, R. Howard and V. Isler, "
    "“SonicFinger: Pre-touch and Contact Detection Tactile Sensor for Reactive Pregrasping”",
}

AUTHORS = {
    "backus": "Backus and Dollar",
    "fernandez": "Fernandez et al.",
    "rupavatharam": "Rupavatharam et al.",
}
"""Whose paper it is, in a line."""

BEST_HZ = 40_000.0
"""Frequency that transfers best (Rupavatharam et al., III.A.2)."""

PRE_TOUCH = (0.924, 0.953)
"""True positive and true negative rate of pre-touch (IV.B.1)."""

CONTACT = (0.937, 0.987)
"""The same of contact (IV.B.3)."""


def table(name: str) -> list[dict[str, Any]]:
    """A paper's table, row by row: numbers in SI units (`speed_mm_s` is `speed_m_s` here), None for an empty cell."""
    return [
        {head.replace("_mm", "_m"): _cell(text, "_mm" in head) for head, text in row.items()}
        for row in as_printed(name)
    ]


def as_printed(name: str) -> list[dict[str, str]]:
    """The same with its cells as they are printed."""
    with Path(__file__).with_name(f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _cell(text: str, millimetres: bool) -> Any:
    try:
        return (float(text) / 1000.0 if millimetres else float(text)) if text else None
    except ValueError:
        return text


def settings_in(paper: str, run: Run) -> Mapping[str, Printed]:
    """What a paper prints of the settings of a run's profile, by their path: of each detector of a kind."""
    detectors: Mapping[str, Any] = setting_of(run, "detectors") or {}
    found: dict[str, Printed] = {}
    for row in table("settings"):
        printed = Printed(row["value"], row["source"])
        if row["paper"] == paper and row["kind"] is None:
            found[row["setting"]] = printed
        elif row["paper"] == paper:
            own = [name for name, settings in detectors.items() if settings.get("kind") == row["kind"]]
            found |= {f"detectors.{name}.{row['setting']}": printed for name in own}
    return found


RECORDED = "recorded"
"""What a trial did whose outcome says nothing of the detectors."""


@cache
def headlines(experiment: str) -> list[dict[str, Any]]:
    """What a report of an experiment opens with: lines of headlines.csv, the first that has a number first.

    Columns: `where` and `column` of trials.csv it is of, `over` which it is made of these, the `detector` that the
    paper's figure is of, and what its `trials` did that came out as they should ("": ended as meant).
    """
    return [line for line in table("headlines") if line["experiment"] == experiment]


def came_to(experiment: str) -> str:
    """What a trial that came out as it should did, in a word."""
    return next((str(line["trials"]) for line in headlines(experiment) if line["trials"]), "ended as meant")
