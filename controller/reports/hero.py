"""The first figure of a report: signal, threshold, touch, decision and stop of the typical trial and of the worst."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from controller.recording.reader import Run
from controller.recording.series import DETECTOR, Series, TrialRecording, extremes
from controller.reports.counts import METHODS, Row, is_number
from controller.reports.first_screen import first_measured, holds
from controller.reports.papers import headlines
from controller.reports.trial_signals import Moments, factors_of, key_of, moments_of, said_of
from controller.scales import displayed, figure

Floats = NDArray[np.float64]

Curve = tuple[str, Floats, Floats]
"""Its look, as the page's style has it, times in s, and values."""

POINTS = 400
"""Most points of a curve: two for each of the dots that it is wide."""

LEAST_S, MOST_S = 0.3, 2.0
"""What a picture of a trial spans, at least and at most, s (assumption)."""


class Drawn(NamedTuple):
    """A trial in the first figure.

    Attributes:
        name: What it is: `typical`, `worst`, `largest`, `failed`, or what it missed: `slip missed`.
        moments: What its time axis begins with, and what is marked in it.
        panels: Its plots as SVG, the upper one first.
    """

    name: str
    key: str
    trial: int
    said: str
    moments: Moments
    panels: Sequence[Markup]


def hero_of(experiment: str, runs: Sequence[Run]) -> list[Drawn]:
    """The typical trial and the worst, each from before its event to where it stood; empty where no detector decided.

    Typical is the success whose number is the median; beside it stands a failed trial, else one whose event was missed,
    else that of the largest number: the worst where less is better.
    """
    line = next(iter(headlines(experiment)), dict.fromkeys(("column", "where", "over", "less")))
    column = str(line["column"] or "")
    measured = any(is_number(row.get(column)) for run in runs for row in run.trials)
    method = next((each for each in METHODS if measured and column.startswith(f"{each}_")), "")
    seen: list[tuple[Run, Row]] = []
    missed: list[tuple[Run, Row]] = []
    for run in runs:
        recorded = set(run.recorded_trials)
        for row in (row for row in run.trials if row["trial"] in recorded):
            if moments_of(run, row, method).decided_s is not None:
                seen.append((run, row))
            elif method and not is_number(row.get(column)):
                missed.append((run, row))
    column = column or first_measured(runs, [row for _, row in seen])
    seen = [each for each in seen if holds(line, each[1])] or seen

    def size(each: tuple[Run, Row]) -> float:
        value = each[1].get(column)
        return abs(float(value)) if is_number(value) else -1.0

    good = sorted((each for each in seen if each[0].succeeded(each[1])), key=size)
    bad = [each for each in seen if not each[0].succeeded(each[1])]
    chosen = [("typical", good[(len(good) - 1) // 2])] if good else []
    if bad:
        chosen.append(("failed", bad[0]))
    elif good and missed:
        chosen.append(("missed", missed[0]))
    elif len(good) > 1 and measured and line["over"] not in ("share", "ratio"):
        chosen.append(("worst" if line["less"] else "largest", good[-1]))
    return [drawn for name, each in chosen if (drawn := _drawn(name, runs, *each, method)) is not None]


def _drawn(name: str, runs: Sequence[Run], run: Run, row: Row, method: str) -> Drawn | None:
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
    instants = [t for t in (moments.zero_s, moments.decided_s, moments.stood_s) if t is not None]
    margin = max(0.5 * (max(instants) - min(instants)), LEAST_S / 2.0)
    span = min(instants) - margin, min(max(instants) + margin, min(instants) + MOST_S)
    panels = [plot(*each, moments, *span) for each in _panels(run, recording, moments, *span)]
    name = f"{moments.zero} missed" if name == "missed" else name
    said = (
        factors_of(run, row) if run.succeeded(row) else said_of(run, row)
    )  # what a success is called says no more
    return Drawn(name, key_of(runs, run, trial), trial, said, moments, panels)


def _panels(
    run: Run, recording: TrialRecording, moments: Moments, start: float, end: float
) -> Iterator[tuple[str, Sequence[Curve]]]:
    """Heading and curves of what the deciding detector hears, and of what it compares: a signal in the unit of the
    statistic stands beside it, and a force takes its place."""
    declared = (run.manifest.get("detectors") or {}).get(moments.detector) or {}
    stream = f"{DETECTOR}{moments.detector}"
    held = recording.stream(stream).between(start - LEAST_S, end + LEAST_S)
    inputs = [name for name in declared.get("inputs") or () if name in recording.streams][:1]
    signals = [name for name in recording.streams if not name.startswith(DETECTOR)]
    forces = [name for name in signals if recording.stream(name).unit == "N"]
    raw, above = None, inputs[0] if inputs else None
    values, unit = displayed(stream, held.values, held.unit)
    if above is not None and unit and displayed(above, np.ones(1), recording.stream(above).unit)[1] == unit:
        raw, above = above, next((name for name in forces if name not in inputs), None)
    if above is not None:
        times_s, seen, its_unit = _xy(above, recording.stream(above), start, end)
        yield ", ".join(filter(None, (above, its_unit))), [("signal", times_s, seen)]
    if len(held) > 1:
        curves = [("raw", *_xy(raw, recording.stream(raw), start, end)[:2])] if raw else []
        curves += [("statistic", held.times_s, values[:, 0]), ("threshold", held.times_s, values[:, 1])]
        yield ", ".join(filter(None, (str(declared.get("statistic") or moments.detector), unit))), curves


def _xy(name: str, series: Series, start: float, end: float) -> tuple[Floats, Floats, str]:
    own = series.between(start, end)
    values, unit = displayed(name, own.values[:, 0] if own.values.ndim > 1 else own.values, own.unit)
    places = extremes(values, POINTS)
    return own.times_s[places], values[places], unit


WIDE, HIGH, LEFT, TOP, BELOW = 380.0, 92.0, 56.0, 20.0, 20.0
"""A plot, and the room for numbers on its left, its heading and its time axis, in the page's dots."""

STANDS = ("statistic", "threshold")
"""Curves whose value stands until the next."""


def plot(heading: str, curves: Sequence[Curve], moments: Moments, start: float, end: float) -> Markup:
    """A plot as an SVG element; its time is in ms since the trial's event, its looks are the page's."""
    zero = moments.zero_s or moments.decided_s or 0.0
    low, high = _reach(curves, start, end)

    def x(t: Any) -> Any:
        return LEFT + (np.clip(t, start, end) - start) / (end - start) * (WIDE - LEFT - 8.0)

    def y(value: Any) -> Any:
        return TOP + HIGH - (np.clip(value, low, high) - low) / (high - low) * HIGH

    parts = [f'<text class="head" x="{LEFT:.0f}" y="12">{Markup.escape(heading)}</text>']
    for tick in _ticks(low, high, 3):
        parts.append(f'<path class="grid" d="M{LEFT:.0f} {y(tick):.1f}H{WIDE - 8:.0f}"/>')
        parts.append(f'<text class="y" x="{LEFT - 5:.0f}" y="{y(tick) + 3.5:.1f}">{figure(tick)}</text>')
    for tick in _ticks(1e3 * (start - zero), 1e3 * (end - zero), 4):
        at = x(zero + tick / 1e3)
        parts.append(f'<text class="x" x="{at:.1f}" y="{TOP + HIGH + 14:.0f}">{figure(tick)}</text>')
    event_s = moments.zero_s if moments.zero_s != moments.decided_s else None
    for look, t in (("zero", event_s), ("decided", moments.decided_s), ("stood", moments.stood_s)):
        if t is not None and start <= t <= end:
            parts.append(f'<path class="{look}" d="M{x(t):.1f} {TOP:.0f}V{TOP + HIGH:.0f}"/>')
    for look, times_s, values in curves:
        stands = look in STANDS
        seen = (times_s, values) if stands else _within(times_s, values, low, high)
        parts.append(f'<path class="{look}" d="{_path(x(seen[0]), y(seen[1]), stands)}"/>')
    size = f'viewBox="0 0 {WIDE:.0f} {TOP + HIGH + BELOW:.0f}"'
    label = f'role="img" aria-label="{Markup.escape(heading)}"'
    return Markup(f'<svg xmlns="http://www.w3.org/2000/svg" {size} {label}>{"".join(parts)}</svg>')


def _reach(curves: Sequence[Curve], start: float, end: float) -> tuple[float, float]:
    """From where to where a plot reaches: what is compared fills a third of it; what is heard may leave it."""
    inside = [(look, y[(t >= start) & (t <= end)]) for look, t, y in curves]
    finite = [(look, y[np.isfinite(y)]) for look, y in inside]
    known = np.concatenate([y for _, y in finite] or [np.zeros(0)])
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    held = [y for look, y in finite if look in STANDS]
    if len(finite) > len(held) and len(beside := np.concatenate(held or [known])):
        span = float(np.ptp(beside)) or high - low
        low, high = max(low, float(beside.min()) - span), min(high, float(beside.max()) + span)
    pad = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return low - pad, high + pad


def _within(t: Floats, v: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    """A curve where it lies between two values, cut where it crosses them."""
    for level in (low, high):
        off = v - level
        (at,) = np.nonzero(off[:-1] * off[1:] < 0.0)
        crossed = t[at] + np.diff(t)[at] * off[at] / (off[at] - off[at + 1])
        t, v = np.insert(t, at + 1, crossed), np.insert(v, at + 1, level)
    return t, np.where((v < low) | (v > high), np.nan, v)


def _path(x: Floats, y: Floats, stands: bool) -> str:
    texts, pen = [], "M"
    for at, value in zip(x, y, strict=True):
        if not math.isfinite(value):
            pen = "M"
            continue
        texts.append(f"H{at:.1f}V{value:.1f}" if stands and pen == "L" else f"{pen}{at:.1f} {value:.1f}")
        pen = "L"
    return "".join(texts)


def _ticks(low: float, high: float, most: int) -> list[float]:
    """At most `most` + 1 round numbers from `low` to `high`."""
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step *= next(times for times in (1.0, 2.0, 5.0, 10.0) if (high - low) / (step * times) <= most)
    return [round(place * step, 12) for place in range(math.ceil(low / step), math.floor(high / step) + 1)]
