"""The trials on the page: a table of all, and the signals of each: samples, detections, truth and states."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.measures import Column, columns_of
from controller.recording.reader import Run
from controller.recording.series import DETECTOR, Series, TrialRecording, extremes
from controller.reports.counts import is_number, title
from controller.reports.run_account import acting_of, setting_of, statistic_of
from controller.scales import displayed, scale_of, spaced

Floats = NDArray[np.float64]

POINTS = 1500
"""Most points of one curve: two for each of the dots that a wide screen shows side by side in a plot."""

LEAST_POINTS = 200
"""Fewest: below that a curve shows nothing. What does not fit then is left to the recording."""

BYTES_A_POINT = 16 / 3
"""Two numbers of 16 bits, as text (base64)."""

CURVES = 12
"""Most curves of one trial: six panels of two, as many as a page holds one above the other (assumption)."""

SILENCE = 20.0
"""A step in time so many times the usual one is a stretch without a subscriber (assumption)."""

FEW = 0.05
"""Samples before such a stretch that are fewer than this share are left out: what follows is what was measured."""

TRUTHS = ("onset_s", "touch_s", "slip_s", "slip_end_s")
"""Columns that hold an instant of what really happened, beside those that begin with `truth_`."""


def payload(runs: Sequence[Run], room: int) -> str:
    """Every trial's signals as JSON; in `room` bytes, or nearly.

    A curve of more points than fit keeps the least and the largest sample of each stretch of time: no peak is lost.
    Trials that do not fit even so are not in it.
    """
    trials = [(run, trial) for run in runs for trial in run.recorded_trials]
    fitting = max(1, int(room / (CURVES * LEAST_POINTS * BYTES_A_POINT)))
    signals: dict[str, Any] = {}
    points = POINTS
    for run, trial in trials[: max(fitting, 1)]:
        recording = run.readable(trial)
        if recording is None:
            continue
        events = [event for event in run.events if event.get("trial") == trial]
        curves = list(_chosen(run, recording, _deciding(run, events)))
        share = room / max(1, min(len(trials), fitting)) / max(1, len(curves)) / BYTES_A_POINT
        points = int(min(POINTS, max(LEAST_POINTS, share)))
        signals[key_of(runs, run, trial)] = _trial(run, trial, events, curves, points)
    # "</" would end the element that it stands in, "<!--" would hide its end
    return json.dumps(signals, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")


def key_of(runs: Sequence[Run], run: Run, trial: int) -> str:
    """Key of a trial on the page: `r0t37`."""
    return f"r{[each.folder.path for each in runs].index(run.folder.path)}t{trial}"


_DATE = re.compile(r"^\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ_")
"""What a run folder's name begins with; the rest distinguishes it."""


def trial_table(runs: Sequence[Run]) -> tuple[list[tuple[str, ...]], list[tuple[str, list[tuple[str, str]]]]]:
    """Every trial of some runs, run by run.

    Returns:
        Of each column its name in trials.csv, its heading and its meaning, the run first where there are several. Of
        each trial its key, and of each cell what is shown and a number's exact value.
    """
    names = list(dict.fromkeys(name for run in runs for row in run.trials for name in row)) or ["trial"]
    names.sort(key=lambda name: "." in name)  # varied settings last: what was measured fits a screen
    rows = []
    for run in runs:
        for row in run.trials:
            cells = [_cell(name, row.get(name)) for name in names]
            cells[1:1] = [(_DATE.sub("", run.folder.path.name), "")] if len(runs) > 1 else []
            rows.append((key_of(runs, run, int(row["trial"] or 0)), cells))
    names[1:1] = ["run"] if len(runs) > 1 else []
    declared: dict[str, Column] = {}
    for run in runs:
        declared |= columns_of(str(run.manifest.get("experiment")))
    said = {name: f": {column.meaning}" for name, column in declared.items()}
    return [(name, scale_of(name).heading, said.get(name, "")) for name in names], rows


def _cell(name: str, value: object) -> tuple[str, str]:
    return "" if value is None else scale_of(name).cell(value), repr(value) if is_number(value) else ""


def _deciding(run: Run, events: Sequence[Mapping[str, Any]]) -> list[str]:
    """Detectors that decided in a trial, those whose events led to another state; else the one that would have."""
    found = [
        str(event["detector"])
        for event in events
        if event.get("detector") is not None
        and event.get("next") != event.get("state")
        and not event["event"].startswith("Baseline")
    ]
    return list(dict.fromkeys(found or [acting_of(run)]))


def _chosen(
    run: Run, recording: TrialRecording, deciding: Sequence[str]
) -> Iterator[tuple[str, str, Series, int]]:
    """Curves as (panel, name, series, channel): first the detectors' statistics, of what decided before the others';
    then the streams they subscribe to, then what else the profile names."""
    named = json.dumps([setting_of(run, part) for part in ("detectors", "behavior", "limits")], default=str)

    def place(stream: str) -> int:
        if stream.startswith(DETECTOR):
            return -1 - (stream.removeprefix(DETECTOR) in deciding)
        found = named.find(f'"{stream}"')
        return found if found >= 0 else len(named)

    curves = 0
    for stream in sorted(recording.streams, key=place):
        series = recording.stream(stream)
        if len(series) < 2:
            continue
        width = 1 if stream.startswith(DETECTOR) else series.values.shape[1]
        for channel in range(min(width, 3, CURVES - curves)):
            curves += 1
            yield stream, f"{channel}" if width > 1 else "", series, channel


def _trial(
    run: Run,
    trial: int,
    events: Sequence[Mapping[str, Any]],
    curves: Sequence[tuple[str, str, Series, int]],
    points: int,
) -> dict[str, Any]:
    row = next((row for row in run.trials if row["trial"] == trial), {})
    panels: dict[str, dict[str, Any]] = {}
    for stream, name, series, channel in curves:
        values, unit = displayed(stream, series.values[:, channel], series.unit)
        if stream.startswith(DETECTOR):
            panels[stream] = _statistic(run, events, stream.removeprefix(DETECTOR), series, points)
            continue
        fresh = {"label": f"{stream}, {unit}" if unit else stream, "whose": "ours", "curves": []}
        panel = panels.setdefault(stream, fresh)
        panel["curves"].append({"name": name, **_packed(*_measured(series.times_s, values), points)})
    factors = ", ".join(scale_of(name).said(row[name]) for name in run.factors if row.get(name) is not None)
    return {
        "title": f"Trial {trial}, {factors}: {title(str(row.get('outcome', 'not ended')))}",
        "run": run.folder.path.name,
        "panels": list(panels.values()),
        "thresholds": list(_thresholds(events, panels, curves)),
        "states": [[e["t_s"], e["next"]] for e in events if e.get("next") != e.get("state")],
        "marks": list(_marks(run, events)),
        "truths": [
            [title(name.removeprefix("truth_").removesuffix("_s")), value]
            for name, value in row.items()
            if (name.startswith("truth_") or name in TRUTHS)
            and name.endswith("_s")
            and isinstance(value, int | float)
        ],
    }


def _statistic(
    run: Run, events: Sequence[Mapping[str, Any]], detector: str, series: Series, points: int
) -> dict[str, Any]:
    """The panel of a detector's statistic and of its threshold, which is packed where it changes."""
    values, unit = displayed(DETECTOR, series.values, series.unit)
    decided_s = [event["t_s"] for event in events if event.get("detector") == detector]
    times_s, shown = _measured(series.times_s, values[:, 0], whole=True)
    limits = values[:, 1]
    changes = np.flatnonzero(~np.isclose(limits, np.roll(limits, 1), rtol=1e-12, equal_nan=True))
    places = np.union1d([0, len(limits) - 1], changes)
    return {
        "label": f"{detector}, {unit}" if unit else detector,
        "title": f"{detector}: {statistic_of(run, detector)[0]}",
        "whose": _whose(run, detector),
        "curves": [{"name": "", **_packed(times_s, shown, points, decided_s)}],
        "threshold": _packed(series.times_s[places], limits[places], points),
    }


def _whose(run: Run, detector: object) -> str:
    kind = setting_of(run, "detectors", str(detector), "kind")
    return "paper" if str(kind).endswith(".paper") else "ours"


def _marks(run: Run, events: Sequence[Mapping[str, Any]]) -> Iterator[list[Any]]:
    """Detections: when, what, whose method."""
    for event in events:
        if event.get("detector") is not None and event["event"] != "BaselineReady":
            text = f"{event['detector']}: {spaced(event['event'])}"
            yield [event["t_s"], text, _whose(run, event["detector"])]


def _thresholds(
    events: Sequence[Mapping[str, Any]],
    panels: Mapping[str, Mapping[str, Any]],
    curves: Sequence[tuple[str, str, Series, int]],
) -> Iterator[list[Any]]:
    """Panel (-1 is none), detector, threshold and its unit: as it was recorded; of a detector that shows nothing from
    the last event that its statistic led to."""
    thresholds: dict[str, tuple[int, float, str]] = {
        str(event["detector"]): (-1, event["threshold"], "")
        for event in events
        if event.get("threshold") is not None and not event["event"].startswith("Baseline")
    }
    for number, stream in enumerate(panels):
        if stream.startswith(DETECTOR):
            series = next(series for name, _, series, _ in curves if name == stream)
            column, unit = displayed(stream, series.values[:, 1], series.unit)
            known = column[np.isfinite(column)]
            if len(known):
                thresholds[stream.removeprefix(DETECTOR)] = number, float(known[-1]), unit
    for detector, (number, threshold, unit) in thresholds.items():
        yield [number, detector, threshold, unit]


def _measured(times_s: Floats, values: Floats, *, whole: bool = False) -> tuple[Floats, Floats]:
    """A curve with a break where there was no subscriber; but for a `whole` one the few samples before the first
    stretch are left out."""
    steps_s = np.diff(times_s)
    cuts = np.flatnonzero(steps_s > SILENCE * np.median(steps_s)) + 1
    first = 0 if whole else next((cut for cut in cuts[::-1] if cut <= FEW * len(times_s)), 0)
    cuts = cuts[cuts > first] - first
    times_s, values = times_s[first:], values[first:]
    return np.insert(times_s, cuts, times_s[cuts - 1]), np.insert(values, cuts, np.nan)


def _packed(times_s: Floats, values: Floats, points: int, kept_s: Sequence[float] = ()) -> dict[str, Any]:
    """A curve in two rows of 16-bit numbers between their ends, its samples at `kept_s` among them; 65535 is no
    value."""
    keep = np.union1d(extremes(values, points), np.flatnonzero(np.isin(times_s, kept_s)))
    ends = [float(times_s[0]), float(times_s[-1])]
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)

    def packed(numbers: Floats, least: float, most: float) -> str:
        scaled = np.round((numbers - least) / ((most - least) or 1.0) * 65534.0)
        codes = np.where(np.isfinite(scaled), scaled, 65535.0).astype("<u2")
        return base64.b64encode(codes.tobytes()).decode()

    t, y = packed(times_s[keep], *ends), packed(values[keep], low, high)
    return {"span": [*ends, low, high], "t": t, "y": y}
