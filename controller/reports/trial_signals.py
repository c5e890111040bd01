"""The signals of each trial, small enough for the page: samples, detections, truth and states."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.recording.reader import Run
from controller.recording.series import DETECTOR, Series, TrialRecording, extremes
from controller.reports.run_account import setting_of
from controller.reports.text import title
from controller.wording import spaced

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
        curves = list(_chosen(run, recording))
        share = room / max(1, min(len(trials), fitting)) / max(1, len(curves)) / BYTES_A_POINT
        points = int(min(POINTS, max(LEAST_POINTS, share)))
        signals[key_of(runs, run, trial)] = _trial(run, trial, curves, points)
    # "</" would end the element that it stands in, "<!--" would hide its end
    return json.dumps(signals, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")


def key_of(runs: Sequence[Run], run: Run, trial: int) -> str:
    """Key of a trial on the page: `r0t37`."""
    return f"r{[each.folder.path for each in runs].index(run.folder.path)}t{trial}"


def _chosen(run: Run, recording: TrialRecording) -> Iterator[tuple[str, str, Series, int]]:
    """Curves as (panel, name, series, channel): first the detectors' statistics, then the streams they subscribe to,
    then what else the profile names."""
    named = json.dumps([setting_of(run, part) for part in ("detectors", "behavior", "limits")], default=str)

    def place(stream: str) -> int:
        if stream.startswith(DETECTOR):
            return -1
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
    run: Run, trial: int, curves: Sequence[tuple[str, str, Series, int]], points: int
) -> dict[str, Any]:
    row = next((row for row in run.trials if row["trial"] == trial), {})
    events = [event for event in run.events if event.get("trial") == trial]
    panels: dict[str, dict[str, Any]] = {}
    for stream, name, series, channel in curves:
        values, unit = series.values[:, channel], series.unit
        if stream.endswith(".period"):  # as a frequency, in which the detectors' thresholds are
            values, unit = 1.0 / values, "Hz"
        elif unit == "m":
            values, unit = 1e3 * values, "mm"
        detector = stream.removeprefix(DETECTOR) if stream.startswith(DETECTOR) else ""
        label = f"{detector}, statistic" if detector else stream
        fresh = {"label": f"{label}, {unit}" if unit else label, "whose": _whose(run, detector), "curves": []}
        panel = panels.setdefault(stream, fresh)
        panel["curves"].append({"name": name, **_packed(*_measured(series.times_s, values), points)})
    factors = ", ".join(f"{name} {row[name]}" for name in run.factors if row.get(name) is not None)
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
    """Panel (-1 is none), detector and threshold: as it was recorded, or from the detector's last event."""
    thresholds = {str(e["detector"]): (-1, e["threshold"]) for e in events if e.get("threshold") is not None}
    for number, stream in enumerate(panels):
        if stream.startswith(DETECTOR):
            column = next(series.values[:, 1] for name, _, series, _ in curves if name == stream)
            known = column[np.isfinite(column)]
            if len(known):
                thresholds[stream.removeprefix(DETECTOR)] = number, float(known[-1])
    for detector, (number, threshold) in thresholds.items():
        yield [number, detector, threshold]


def _measured(times_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """A curve with a break where there was no subscriber; the few samples before the first stretch are left out."""
    steps_s = np.diff(times_s)
    cuts = np.flatnonzero(steps_s > SILENCE * np.median(steps_s)) + 1
    first = next((cut for cut in cuts[::-1] if cut <= FEW * len(times_s)), 0)
    cuts = cuts[cuts > first] - first
    times_s, values = times_s[first:], values[first:]
    return np.insert(times_s, cuts, times_s[cuts - 1]), np.insert(values, cuts, np.nan)


def _packed(times_s: Floats, values: Floats, points: int) -> dict[str, Any]:
    """A curve in two rows of 16-bit numbers between their ends; 65535 is no value."""
    keep = extremes(values, points)
    ends = [float(times_s[0]), float(times_s[-1])]
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)

    def packed(numbers: Floats, least: float, most: float) -> str:
        scaled = np.round((numbers - least) / ((most - least) or 1.0) * 65534.0)
        codes = np.where(np.isfinite(scaled), scaled, 65535.0).astype("<u2")
        return base64.b64encode(codes.tobytes()).decode()

    t, y = packed(times_s[keep], *ends), packed(values[keep], low, high)
    return {"span": [*ends, low, high], "t": t, "y": y}
