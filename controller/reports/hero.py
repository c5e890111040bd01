"""The first figure of a report: signal, threshold, touch, decision and stop of the typical trial and of the worst."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from controller.recording.reader import Run
from controller.recording.series import DETECTOR, TrialRecording
from controller.reports.counts import METHODS, Row, is_number
from controller.reports.first_screen import first_measured, holds
from controller.reports.papers import headlines
from controller.reports.run_account import declared_of
from controller.reports.trial_signals import Moments, factors_of, key_of, moments_of, said_of, shown_as
from controller.scales import displayed, scale_of

LEAST_S, MOST_S = 0.3, 2.0
"""What a picture of a trial spans, at least and at most, s (assumption)."""


class Drawn(NamedTuple):
    """A trial in the first figure.

    Attributes:
        name: What it is: `typical`, `worst`, `largest force`, `failed`, or what it missed: `slip missed`.
        moments: What its time axis begins with, and what is marked in it.
        shown: For the page, which draws it from the trial's signals: streams, and from when to when, s.
    """

    name: str
    key: str
    trial: int
    said: str
    moments: Moments
    shown: dict[str, Any]


def hero_of(experiment: str, runs: Sequence[Run], page: Sequence[Run] = ()) -> list[Drawn]:
    """The typical trial and the worst, each from before its event to where it stood; empty where no detector decided.

    Typical is the success whose number is the median; beside it stands a failed trial, else one whose event was missed,
    else that of the largest number: the worst where less is better. Trials are named by the runs of the whole `page`.
    """
    line = next(iter(headlines(experiment)), dict.fromkeys(("column", "where", "over", "less")))
    column = str(line["column"] or "")
    measured = any(is_number(row.get(column)) for run in runs for row in run.trials)
    method = next((each for each in METHODS if measured and column.startswith(f"{each}_")), "")
    recorded = {(id(run), trial) for run in runs for trial in run.recorded_trials}
    trials = [(run, row) for run in runs for row in run.trials if (id(run), row["trial"]) in recorded]
    decided = [(each, moments_of(*each, method).decided_s is not None) for each in trials]
    seen = [each for each, was in decided if was]
    missed = [each for each, was in decided if method and not was and not is_number(each[1].get(column))]
    column = column or first_measured(runs, [row for _, row in seen])
    measured = measured or (bool(column) and not headlines(experiment))
    seen = [each for each in seen if holds(line, each[1])] or seen

    def size(each: tuple[Run, Row]) -> float:
        value = each[1].get(column)
        return abs(float(value)) if is_number(value) else -1.0

    good = sorted((each for each in seen if each[0].succeeded(each[1])), key=size)
    bad = [each for each in seen if not each[0].succeeded(each[1])]
    chosen = [("typical", good[(len(good) - 1) // 2])] if good else []
    counted = line["over"] in ("share", "ratio")  # of one trial it says yes or no
    if bad:
        chosen.append(("failed", bad[0]))
    elif good and missed:
        chosen.append(("missed", missed[0]))
    elif len(good) > 1 and measured and not counted:
        chosen.append(("worst" if line["less"] else f"largest {scale_of(column).label}", good[-1]))
    found = (_drawn(name, page or runs, *each, method, "" if counted else column) for name, each in chosen)
    return [drawn for drawn in found if drawn is not None]


def _drawn(name: str, runs: Sequence[Run], run: Run, row: Row, method: str, column: str) -> Drawn | None:
    trial, moments = int(row["trial"]), moments_of(run, row, method)
    recording = run.readable(trial)
    if recording is None:
        return None
    if moments.decided_s is None:
        names = [stream.removeprefix(DETECTOR) for stream in recording.streams if stream.startswith(DETECTOR)]
        heard = [each for each in names if each.endswith(method)]
        if moments.zero_s is None or not heard:
            return None
        moments = moments._replace(detector=heard[0])
    event_s = moments.zero_s if moments.zero_s != moments.decided_s else None
    looks = {"zero": event_s, "decided": moments.decided_s, "stood": moments.stood_s}
    marks = {look: t_s for look, t_s in looks.items() if t_s is not None}
    first_s, last_s = min(marks.values()), max(marks.values())
    margin_s = max(0.5 * (last_s - first_s), LEAST_S / 2.0)
    start, end = first_s - margin_s, min(last_s + margin_s, first_s + MOST_S)
    key = key_of(runs, run, trial)
    shown = {
        "key": key,
        "streams": _streams(run, recording, moments.detector),
        "span": [start, end],
        "zero": moments.zero_s or moments.decided_s or 0.0,
        "marks": {look: t_s for look, t_s in marks.items() if start <= t_s <= end},
    }
    name = f"{moments.zero} missed" if name == "missed" else name
    said = factors_of(run, row) if run.succeeded(row) else said_of(run, row)  # a success's name says no more
    said += f": {shown_as(column, [row[column]]).said(row[column])}" if is_number(row.get(column)) else ""
    return Drawn(name, key, trial, said, moments, shown)


def _streams(run: Run, recording: TrialRecording, detector: str) -> list[str]:
    """What a detector hears, and what it compares; a force in place of what is heard in the statistic's unit."""
    inputs = declared_of(run, detector).get("inputs") or ()
    statistic = recording.stream(f"{DETECTOR}{detector}")
    unit = displayed(DETECTOR, np.ones((1, 2)), statistic.unit)[1]
    heard = [name for name in inputs if name in recording.streams][:1]
    if heard and unit and displayed(heard[0], np.ones(1), recording.stream(heard[0]).unit)[1] == unit:
        forces = [name for name in recording.streams if recording.stream(name).unit == "N"]
        heard = [name for name in forces if not name.startswith(DETECTOR) and name not in inputs][:1] or heard
    return [*heard, f"{DETECTOR}{detector}"]
