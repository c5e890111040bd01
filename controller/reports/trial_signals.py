"""The trials on the page: a table of all, and the signals of each: samples, detections, truth and states."""

import base64
import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from controller.measures import columns_of
from controller.outcomes import UNMEASURED
from controller.recording.reader import Run
from controller.recording.series import DETECTOR, Series, TrialRecording, extremes
from controller.reports.counts import is_number, number, title
from controller.reports.papers import RECORDED, came_to
from controller.reports.run_account import acting_of, declared_of, experiment_in, setting_of
from controller.scales import Scale, displayed, scale_of, spaced
from drivers.core.messages import Floats

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

CLOSE_S = 0.5
"""How far from what decided a trial is shown when it is opened, s."""

TRUTHS = ("onset_s", "touch_s", "slip_s", "slip_end_s")
"""Columns that hold an instant of what really happened, beside those that begin with `truth_`."""

EVENTS = {
    "slip_s": "slip",
    "truth_contact_s": "touch",
    "touch_truth_s": "touch",
    "onset_s": "first force",
    "touch_s": "touch",
    "detect_s": "decision",
}
"""Columns of what a trial is about, the first that is known: its times are shown from there."""

NAMES = {
    "truth_contact_s": "touched",
    "touch_truth_s": "touched",
    "truth_release_s": "released",
    "onset_s": "first force seen",
    "detect_s": "detected",
    "touch_s": "touch detected",
    "command_s": "stop sent",
    "standstill_s": "stood still",
    "slip_s": "slip began",
    "slip_end_s": "slip ended",
    "slide_s": "slide ordered",
    "listen_s": "detectors listen",
    "stop_travel_m": "travel to stop",
    "force_n": "force then",
    "force_peak_n": "largest force",
    "baseline_hz": "learned",
    "seen_to_stop_left_s": "left finger to stop",
    "seen_to_stop_right_s": "right finger to stop",
    "theta_bias_rad": "angle error, mean",
    "theta_sd_rad": "angle error, sd",
    "theta_rms_rad": "angle error, rms",
    "theta_max_rad": "angle error, largest",
    "theta_hysteresis_rad": "hysteresis",
    "theta_spread_rad": "spread of one sample",
}
"""Columns by the words that a person has for them, where their names do not say it."""

NEAR_S = 1.0
"""How near what decided is to what a trial is about, s (assumption): beyond it is about something else."""


class Moments(NamedTuple):
    """What a trial's times are shown from, and what is drawn of its stop; None where there is none.

    Attributes:
        zero: The event: `touch`, `slip`; `decision` where it is not known when.
    """

    zero: str
    zero_s: float | None
    detector: str = ""
    decided_s: float | None = None
    stood_s: float | None = None


def moments_of(run: Run, row: Mapping[str, Any], method: str = "") -> Moments:
    """Of a trial: what decided is what led to another state near the event, else the first alarm after it; of the
    detectors of a `method` alone where one is given, as of `ours`."""
    found = next(((EVENTS[name], float(row[name])) for name in EVENTS if is_number(row.get(name))), None)
    events = run.events_of(row["trial"])
    alarms = [event for event in events if _alarms(event) and str(event["detector"]).endswith(method)]
    if found:  # what is seen ahead is no answer to a touch
        alarms = [event for event in alarms if not event["event"].startswith("PreTouch")]
    led = list(_leading(alarms))
    if found:
        slips = found[0] == "slip"  # a touch before it is no answer to it
        near = [e for e in led if (0.0 if slips else -NEAR_S) <= e["t_s"] - found[1] <= NEAR_S]
        near += [event for event in alarms if 0.0 <= event["t_s"] - found[1] <= NEAR_S]
        led = near[:1] or ([] if slips else led)
    if not led:
        return Moments(*(found or ("", None)))
    decided_s = float(led[-1]["t_s"])
    stood = (e["t_s"] for e in events if e["event"] == "Standstill" and 0 < e["t_s"] - decided_s < NEAR_S)
    return Moments(
        *(found or ("decision", decided_s)), str(led[-1]["detector"]), decided_s, next(stood, None)
    )


def _alarms(event: Mapping[str, Any]) -> bool:
    """Whether a detector reports more than that it has learned."""
    return event.get("detector") is not None and not event["event"].startswith("Baseline")


def _leading(events: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """Those that led to another state."""
    return (event for event in events if event.get("next") != event.get("state"))


def payload(runs: Sequence[Run], room: int, first: Collection[str] = ()) -> str:
    """Every trial's signals as JSON; in `room` bytes, or nearly; those of the keys `first` before all others,
    and whole.

    A curve of more points than fit keeps the least and the largest sample of each stretch of time: no peak is lost.
    Trials that do not fit even so are not in it: those that stand out of no column.
    """
    trials = sorted(outliers_first(runs), key=lambda each: key_of(runs, *each) not in first)
    texts: list[str] = []
    points, used = POINTS, 0
    for run, trial in trials:
        recording = run.readable(trial)
        if recording is None:
            continue
        events = run.events_of(trial)
        deciding = {str(event["detector"]) for event in _leading(filter(_alarms, events))}
        curves = list(_chosen(run, recording, deciding or {acting_of(run)}))
        share = room / len(trials) / max(1, len(curves)) / BYTES_A_POINT
        key = key_of(runs, run, trial)
        points = POINTS if key in first else int(min(POINTS, max(LEAST_POINTS, share)))
        signals = {key: _trial(run, trial, events, curves, points)}
        texts.append(json.dumps(signals, separators=(",", ":"), ensure_ascii=False)[1:-1])
        used += len(texts[-1])
        if used > room:
            break
    # "</" would end the element that it stands in, "<!--" would hide its end
    return f"{{{','.join(texts)}}}".replace("<", "\\u003c")


def outliers_first(runs: Sequence[Run]) -> list[tuple[Run, int]]:
    """The recorded trials: those that failed, those that lead a column sorted up or down or stand in its middle, and
    so on."""
    rows = [(run, row) for run in runs for row in run.trials]
    ranks = [0 if not run.succeeded(row) else len(rows) for run, row in rows]
    factors = {"trial", *(name for run in runs for name in run.factors)}
    for name in dict.fromkeys(name for _, row in rows for name in row if not is_instant(name)):
        known = sorted((row[name], place) for place, (_, row) in enumerate(rows) if is_number(row.get(name)))
        if name in factors or len({value for value, _ in known}) < 2:
            continue
        for rank, (_, place) in enumerate(known):
            last = len(known) - 1
            ranks[place] = min(ranks[place], rank, last - rank, abs(rank - last // 2))
    first = {(id(run), row["trial"]): rank for (run, row), rank in zip(rows, ranks, strict=True)}
    trials = [(run, trial) for run in runs for trial in run.recorded_trials]
    return sorted(trials, key=lambda each: first.get((id(each[0]), each[1]), 0))


def key_of(runs: Sequence[Run], run: Run, trial: int) -> str:
    """Key of a trial on the page: `r0t37`."""
    return f"r{[each.folder.path for each in runs].index(run.folder.path)}t{trial}"


_DATE = re.compile(r"^\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ_")
"""What a run folder's name begins with; the rest distinguishes it."""


class TrialColumn(NamedTuple):
    """A column of the table of trials: its name in trials.csv, how it is shown, its meaning."""

    name: str
    heading: str
    meaning: str


class TrialRow(NamedTuple):
    """A trial: its key, whether it succeeded (`good`, `bad`, "" where it was only to be recorded, or `out` of every
    number, and then why), and of each cell
    what is shown and a number's exact value."""

    key: str
    state: str
    why: str
    cells: Sequence[tuple[str, str]]


def trial_table(runs: Sequence[Run]) -> tuple[list[TrialColumn], list[TrialRow]]:
    """Every trial of some runs, run by run: columns that hold anything, the run first where there are several.

    An instant is shown in ms from the trial's event, a time below a second in ms.
    """
    trials = [(run, row) for run in runs for row in run.trials]
    names = list(dict.fromkeys(name for _, row in trials for name in row)) or ["trial"]
    names = [name for name in names if any(row.get(name) is not None for _, row in trials)]
    names.sort(key=lambda name: "." in name)  # varied settings last: what was measured fits a screen
    declared = {
        name: meaning for run in runs for name, meaning in columns_of(run.manifest.get("experiment")).items()
    }
    instants = {name for name in names if is_instant(name, declared.get(name, ""))}
    scales = {name: shown_as(name, [row.get(name) for _, row in trials]) for name in names}
    scales |= {name: scales[name]._replace(unit="ms") for name in instants}
    rows = []
    for run, row in trials:
        zero_s = moments_of(run, row).zero_s
        cells = []
        for name in names:
            value = row.get(name)
            exact = str(value) if name == "outcome" else repr(value) if is_number(value) else ""
            if name in instants and is_number(value) and zero_s is not None:
                shown = number(value - zero_s, 0, 1e3)
            else:
                said = title(str(value)) if name == "outcome" else value
                shown = "" if value is None else scales[name].cell(said)
            cells.append((shown, exact))
        cells[1:1] = [(_DATE.sub("", run.folder.path.name), "")] if len(runs) > 1 else []
        why = _excluded(run, row)
        good = "" if came_to(experiment_in(run)) == RECORDED else "good"
        state = "out" if why else good if run.succeeded(row) else "bad"
        rows.append(TrialRow(key_of(runs, run, int(row["trial"] or 0)), state, why, cells))
    columns = [TrialColumn(name, scale.heading, declared.get(name, "")) for name, scale in scales.items()]
    columns[1:1] = [TrialColumn("run", "run", "")] if len(runs) > 1 else []
    return columns, rows


def is_instant(name: str, meaning: str = "") -> bool:
    """Whether a column holds a time of the trial's clock: its declared meaning says when."""
    when = meaning.startswith("when ") or name in EVENTS or name.startswith("truth_")
    return when and name.endswith("_s")


def shown_as(name: str, values: Sequence[object]) -> Scale:
    """The scale of a column as a person reads it: in ms where its times are below a second."""
    scale = scale_of(name)
    scale = scale._replace(label=NAMES.get(name, scale.label))
    largest = max((abs(value) for value in values if is_number(value)), default=1.0)
    return scale._replace(unit="ms", factor=1e3) if scale.unit == "s" and largest < 1.0 else scale


def _excluded(run: Run, row: Mapping[str, Any]) -> str:
    """Why a trial is in no number; "" where it is."""
    if row.get("outcome") not in UNMEASURED:
        return ""
    reasons = [str(e["reason"]) for e in run.events_of(row["trial"]) if e.get("reason")]
    return reasons[-1] if reasons else "it was broken off"


Curve = tuple[str, str, Series, int]
"""Panel, name, series, channel."""


def _chosen(run: Run, recording: TrialRecording, deciding: Collection[str]) -> Iterator[Curve]:
    """Curves: first the detectors' statistics, of what decided before the others';
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
    run: Run, trial: int, events: Sequence[Mapping[str, Any]], curves: Sequence[Curve], points: int
) -> dict[str, Any]:
    row = next((row for row in run.trials if row["trial"] == trial), {"trial": trial})
    moments = moments_of(run, row)
    around_s = moments.zero_s if moments.decided_s is None else moments.decided_s
    close = (around_s or 0.0) - CLOSE_S, (around_s or 0.0) + CLOSE_S
    panels: dict[str, dict[str, Any]] = {}
    # thresholds: of a detector that shows nothing from its last event; its panel is -1
    held = {
        str(event["detector"]): (-1, event["threshold"], "")
        for event in events
        if None not in (event.get("detector"), event.get("threshold"))
        and not event["event"].startswith("Baseline")
    }
    for stream, name, series, channel in curves:
        values, unit = displayed(stream, series.values, series.unit)
        detector = stream.removeprefix(DETECTOR)
        whose, label = "ours", f"{detector}, {unit}" if unit else detector
        panel = panels.setdefault(stream, {"stream": stream, "label": label, "whose": whose, "curves": []})
        decided_s: list[float] = []
        if detector != stream:
            decided_s = [event["t_s"] for event in events if event.get("detector") == detector]
            limits = values[:, 1]
            if len(known := limits[np.isfinite(limits)]):
                held[detector] = len(panels) - 1, float(known[-1]), unit
            changes = np.flatnonzero(~np.isclose(limits, np.roll(limits, 1), rtol=1e-12, equal_nan=True))
            places = np.union1d([0, len(limits) - 1], changes)
            panel["title"] = f"{detector}: {declared_of(run, detector)['statistic']}"
            panel["whose"] = _whose(run, detector)
            panel["threshold"] = _packed(series.times_s[places], limits[places], points, close)
        shown = _measured(series.times_s, values[:, channel], whole=detector != stream)
        panel["curves"].append({"name": name, **_packed(*shown, points, close, decided_s)})
    return {
        "title": f"Trial {trial}: {said_of(run, row)}",
        "zero": [moments.zero or "the trial began", moments.zero_s or 0.0],
        "around": around_s,
        "decided": moments.decided_s,
        "stood": moments.stood_s,
        "panels": list(panels.values()),
        "thresholds": [[number, name, value, unit] for name, (number, value, unit) in held.items()],
        "states": [[e["t_s"], e["next"]] for e in _leading(events)],
        "marks": [
            [e["t_s"], f"{e['detector']}: {spaced(e['event'])}", _whose(run, e["detector"])]
            for e in events
            if e.get("detector") is not None and e["event"] != "BaselineReady"
        ],
        "truths": [
            [title(name.removeprefix("truth_").removesuffix("_s")), value]
            for name, value in row.items()
            if (name.startswith("truth_") or name in TRUTHS) and name.endswith("_s") and is_number(value)
        ],
    }


def said_of(run: Run, row: Mapping[str, Any]) -> str:
    """Factors and outcome of a trial: `location f, speed 2.54 mm/s: contact`."""
    return ": ".join(filter(None, (factors_of(run, row), title(str(row.get("outcome", "not ended"))))))


def factors_of(run: Run, row: Mapping[str, Any]) -> str:
    """Factors of a trial alone."""
    return ", ".join(scale_of(name).said(row[name]) for name in run.factors if row.get(name) is not None)


def _whose(run: Run, detector: object) -> str:
    kind = setting_of(run, "detectors", str(detector), "kind")
    return "paper" if str(kind).endswith(".paper") else "ours"


def _measured(times_s: Floats, values: Floats, *, whole: bool = False) -> tuple[Floats, Floats]:
    """A curve with a break where there was no subscriber; but for a `whole` one the few samples before the first
    stretch are left out."""
    steps_s = np.diff(times_s)
    cuts = np.flatnonzero(steps_s > SILENCE * np.median(steps_s)) + 1
    first = 0 if whole else next((cut for cut in cuts[::-1] if cut <= FEW * len(times_s)), 0)
    cuts = cuts[cuts > first] - first
    times_s, values = times_s[first:], values[first:]
    return np.insert(times_s, cuts, times_s[cuts - 1]), np.insert(values, cuts, np.nan)


def _packed(
    times_s: Floats,
    values: Floats,
    points: int,
    close: tuple[float, float] = (0.0, 0.0),
    kept_s: Sequence[float] = (),
) -> dict[str, Any]:
    """A curve in two rows of 16-bit numbers between their ends, its samples at `kept_s` among them; 65535 is no
    value. Two thirds of its points are where it is `close` to what decided."""
    first, last = np.searchsorted(times_s, close)
    near = first + extremes(values[first:last], 2 * points // 3) if last > first else []
    far = extremes(values, points // 3 if len(near) else points)
    keep = np.union1d(np.union1d(far, near), np.flatnonzero(np.isin(times_s, kept_s))).astype(int)
    ends = [float(times_s[0]), float(times_s[-1])]
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)

    def packed(numbers: Floats, least: float, most: float) -> str:
        scaled = np.round((numbers - least) / ((most - least) or 1.0) * 65534.0)
        codes = np.where(np.isfinite(scaled), scaled, 65535.0).astype("<u2")
        return base64.b64encode(codes.tobytes()).decode()

    t, y = packed(times_s[keep], *ends), packed(values[keep], low, high)
    return {"span": [*ends, low, high], "t": t, "y": y}
