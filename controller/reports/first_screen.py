"""What a report opens with: a sentence of verdict, three numbers, and the typical and the worst trial, drawn."""

import math
import shlex
import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from controller.outcomes import UNMEASURED
from controller.recording.reader import Run
from controller.recording.series import DETECTOR, Series, TrialRecording, extremes
from controller.reports.counts import METHODS, Comparison, Row, is_number, percent, three, title, within_all
from controller.reports.papers import table
from controller.reports.run_account import acting_of, setting_of
from controller.reports.section import Headline, Result, rated
from controller.reports.trial_signals import Moments, is_instant, key_of, moments_of, said_of
from controller.scales import displayed, figure, scale_of

Floats = NDArray[np.float64]

POINTS = 400
"""Most points of a curve: two for each of the dots that it is wide."""

LEAST_S, MOST_S = 0.3, 2.0
"""What a picture of a trial spans, at least and at most, s (assumption)."""


class Drawn(NamedTuple):
    """A trial in the first figure.

    Attributes:
        name: What it is: `typical`, `worst`, `largest`, `missed` or `failed`.
        moments: What its time axis begins with, and what is marked in it.
        panels: Its plots as SVG, the upper one first.
    """

    name: str
    key: str
    trial: int
    said: str
    moments: Moments
    panels: Sequence[Markup]


def headline_of(
    experiment: str, runs: Sequence[Run], results: Sequence[Result], given: Headline | None
) -> Headline:
    """The sentence and the numbers: what a section gives, else what papers/headlines.csv names, else, of an experiment
    of no paper, the first column that was measured."""
    rows = [row for run in runs for row in run.trials if row.get("outcome") not in UNMEASURED]
    good = sum(run.succeeded(row) for run in runs for row in run.trials)
    n = sum(len(run.trials) for run in runs)
    bad = Counter(str(row["outcome"]) for run in runs for row in run.trials if not run.succeeded(row))
    count = f"{good} of {n} {'trial' if n == 1 else 'trials'} succeeded"
    missed = f" ({', '.join(f'{n} {title(name)}' for name, n in bad.most_common())})" if bad else ""
    foreign = any(not _kind(run).startswith("resonance") for run in runs if _kind(run))
    found = (
        given or _listed(experiment, rows, good, foreign) or _measured(runs, rows) or _successes(good, rows)
    )
    beside = f"; {found.verdict}" if found.verdict else ""
    listed = any(line["experiment"] == experiment for line in table("headlines"))
    beside += "; no paper has this figure" if listed and not found.paper else ""
    state = "none" if not good else "all" if good == n else "some"
    if found.column == "delay_s":
        found = found._replace(what=f"{found.what}, {_deciding(runs)}")
    verdict = f"{count}{missed}{beside}{outcome_of(results)}."
    return found._replace(verdict=verdict, state=found.state if found.state and good == n else state)


def _deciding(runs: Sequence[Run]) -> str:
    """By which detector the trials were decided; where a factor or a run chooses it, by several."""
    acting = {acting_of(run) for run in runs}
    chosen = any("behavior.detector" in row for run in runs for row in run.trials)
    kinds = set(map(_kind, runs))
    if chosen or len(acting) > 1 or len(kinds) > 1:
        return "by several detectors"
    return "by the paper's detector" if kinds.pop().endswith(".paper") else f"by the detector {acting.pop()}"


def outcome_of(results: Sequence[Result]) -> str:
    """`; 2 of 3 predictions as the paper; 1 of 2 goals met`, of what is judged."""
    counts = Counter(result.mark for result in results)
    said = ""
    for good, bad, what in (("same", "apart", "predictions as the paper"), ("met", "missed", "goals met")):
        if of := counts[good] + counts[bad]:
            said += f"; {counts[good]} of {of} {what}"
    return said


def _kind(run: Run) -> str:
    return str(setting_of(run, "detectors", acting_of(run), "kind") or "")


def _listed(experiment: str, rows: Sequence[Row], good: int, foreign: bool = False) -> Headline | None:
    """What the table has of an experiment; a delay of `foreign` detectors, which read no resonance, has no paper."""
    for line in table("headlines"):
        if line["experiment"] != experiment:
            continue
        where = str(line["where"] or "").split("&")
        own = [row for row in rows if all(_holds(each, row) for each in where)]
        others = [] if own else [row for row in rows if _holds(where[0], row)] or rows
        if line["over"] == "success":
            return _successes(good, rows)._replace(what=line["what"], verdict=line["what"])
        # the paper's figure is not of others
        alone = not own or (foreign and line["column"] == "delay_s")
        if found := _number(own or others, {**line, "paper": None} if alone else line):
            return found
    return None


def _holds(where: str, row: Row) -> bool:
    name, sign, value = where.partition("!=") if "!=" in where else where.partition("=")
    if not sign or name not in row:
        return True
    cell = row.get(name)
    same = float(cell) == float(value) if is_number(cell) else str(cell) == value
    return same == (sign == "=")


def _number(own: Sequence[Row], line: Mapping[str, Any]) -> Headline | None:
    """One figure over some trials, with its 95 % interval, beside the paper's."""
    name, over, paper = str(line["column"]), str(line["over"]), line["paper"]
    known = [float(row[name]) for row in own if is_number(row.get(name))]
    scale = scale_of(name)
    source = f"the paper's ({line['source']})" if paper is not None else ""

    def said(value: float) -> str:
        return f"{three(value * scale.factor)} {scale.unit}".rstrip()

    rows = "" if len(known) == len(own) else f"{name}>-1e300"
    if not known:
        return None
    n, better = len(known), "; less is better" if line.get("less") else ""
    if over in ("ratio", "share"):
        of = sum(int(row.get(line["of"]) or 0) for row in own) if over == "ratio" else n
        hits = int(sum(known))
        if not of:
            return None
        return rated(line["what"], hits, of, percent(paper) if paper is not None else "", source, rows, name)
    if over == "worst":
        worst = max(map(abs, known))
        where = "within" if paper is None or worst <= paper else "beyond"
        beside = f"{line['what']} {said(worst)}" + (f", {where} the paper's {said(paper)}" if paper else "")
        least = within_all(n)
        theirs = said(paper) if paper else ""
        of_all = f"largest of {n}{better}"
        return Headline(line["what"], said(worst), of_all, theirs, source, least, beside, rows, name)
    mean = statistics.fmean(known)
    beside = f"{line['what']} {said(mean)}"
    theirs = said(paper) if paper is not None else ""
    if paper is not None:
        beside += f", {_against(mean, paper, name)} the paper's {theirs}"
    return Headline(
        line["what"],
        said(mean),
        f"mean of {n}{better}" if n > 1 else "one trial",
        theirs,
        source,
        _interval(known, name),
        beside,
        rows,
        name,
    )


def _against(ours: float, paper: float, name: str) -> str:
    beside = Comparison(ours, paper)
    off = abs(ours / paper - 1.0)
    return beside.times if off >= 0.5 else f"{100.0 * off:.2g} % {beside.side}" if off >= 0.005 else "as"


def _interval(known: Sequence[float], name: str) -> str:
    """Of a mean (Student's t); "" of one trial."""
    if len(known) < 2:
        return ""
    from scipy.special import stdtrit  # a fifth of a second, for few

    half = float(stdtrit(len(known) - 1, 0.975)) * statistics.stdev(known) / math.sqrt(len(known))
    mean, scale = statistics.fmean(known), scale_of(name)
    least = 0.0 if min(known) >= 0.0 else -math.inf  # of what is never negative
    low, high = (three(scale.factor * max(least, mean + end)) for end in (-half, half))
    return f"{low} to {high} {scale.unit}".rstrip()


def _measured(runs: Sequence[Run], rows: Sequence[Row]) -> Headline | None:
    """The first number that an experiment of no paper measured: no factor, no instant of the trial."""
    factors = {"trial", "outcome", *(name for run in runs for name in run.factors)}
    names = dict.fromkeys(name for row in rows for name in row if name not in factors)
    for name in names:
        if any(is_number(row.get(name)) for row in rows) and not is_instant(name):
            label = scale_of(name).label
            return _number(rows, {"column": name, "over": "mean", "paper": None, "what": label, "source": ""})
    return None


def _successes(good: int, rows: Sequence[Row]) -> Headline:
    if not rows:
        return Headline("trials that succeeded", "none", "0 of 0")
    return rated("trials that succeeded", good, len(rows))._replace(verdict="")


def again(run: Run) -> str:
    """The command that makes a run again."""
    asked = (run.manifest.get("profile") or {}).get("asked") or {}
    words = [
        "run.py",
        "run",
        str(asked.get("profile") or (run.manifest.get("profile") or {}).get("name", "?")),
    ]
    words += [
        word for path, value in (asked.get("set") or {}).items() for word in ("--set", f"{path}={value}")
    ]
    for trial in asked.get("only") or ():
        words += ["--only", str(trial)]
    seed = run.manifest.get("seed")
    return shlex.join([*words, *(["--seed", str(seed)] if seed else [])])


# --- the figure --------------------------------------------------------------------------------------


def hero_of(experiment: str, runs: Sequence[Run]) -> list[Drawn]:
    """The typical trial and the worst, each from before its event to where it stood; empty where no detector decided,
    and where the number is success itself: there the section's own figure stands.

    Typical is the success whose number is the median; beside it stands a failed trial, else one whose event was missed,
    else that of the largest number: the worst where less is better.
    """
    line = next((row for row in table("headlines") if row["experiment"] == experiment), None)
    if line and line["over"] == "success":
        return []
    column: str | None = line["column"] if line else None
    measured = column and any(is_number(row.get(column)) for run in runs for row in run.trials)
    method = next((each for each in METHODS if measured and str(column).startswith(f"{each}_")), "")
    recorded = {id(run): set(run.recorded_trials) for run in runs}
    all_seen = [
        (run, row, moments_of(run, row, method))
        for run in runs
        for row in run.trials
        if row["trial"] in recorded[id(run)]
    ]
    seen = [(run, row) for run, row, moments in all_seen if moments.decided_s is not None]
    missed = [
        (run, row)
        for run, row, moments in all_seen
        if method and moments.decided_s is None and not is_number(row.get(column or ""))
    ]
    if column is None:
        rows = [row for _, row in seen]
        found = _measured(runs, rows)
        column = found and found.column
    where = str(line["where"] or "").split("&") if line else []
    asked = [each for each in seen if all(_holds(condition, each[1]) for condition in where)]
    seen = asked or seen
    good = [each for each in seen if each[0].succeeded(each[1])]
    good.sort(key=lambda each: abs(_value(each[1], column)))
    bad = [each for each in seen if not each[0].succeeded(each[1])]
    chosen = [("typical", good[(len(good) - 1) // 2])] if good else []
    if bad:
        chosen.append(("failed", bad[0]))
    elif good and missed:
        chosen.append(("missed", missed[0]))
    elif len(good) > 1 and measured:
        chosen.append(("worst" if line and line["less"] else "largest", good[-1]))
    drawn = [_drawn(name, runs, run, row, method) for name, (run, row) in chosen]
    return [each for each in drawn if each is not None]


def _value(row: Row, column: str | None) -> float:
    value = row.get(column) if column else None
    return float(value) if is_number(value) else -1.0


def _drawn(name: str, runs: Sequence[Run], run: Run, row: Row, method: str) -> Drawn | None:
    recording, moments = run.readable(int(row["trial"])), moments_of(run, row, method)
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
    start, end = min(instants) - margin, min(max(instants) + margin, min(instants) + MOST_S)
    panels = [
        SignalPanel(*each).svg(moments, start, end) for each in _panels(run, recording, moments, start, end)
    ]
    return Drawn(
        name, key_of(runs, run, int(row["trial"])), int(row["trial"]), said_of(run, row), moments, panels
    )


def _panels(
    run: Run, recording: TrialRecording, moments: Moments, start: float, end: float
) -> Iterator[tuple[str, Sequence[tuple[str, Floats, Floats]]]]:
    """Heading and curves of what the deciding detector hears, and of what it compares: a signal in the unit of the
    statistic stands beside it, and a force takes its place."""
    declared = (run.manifest.get("detectors") or {}).get(moments.detector) or {}
    held = recording.stream(f"{DETECTOR}{moments.detector}").between(start - LEAST_S, end + LEAST_S)
    inputs = [name for name in declared.get("inputs") or () if name in recording.streams][:1]
    signals = [name for name in recording.streams if not name.startswith(DETECTOR)]
    forces = [name for name in signals if recording.stream(name).unit == "N"]
    raw, above = None, inputs[0] if inputs else None
    values, unit = displayed(f"{DETECTOR}{moments.detector}", held.values, held.unit)
    if above is not None and unit and displayed(above, np.ones(1), recording.stream(above).unit)[1] == unit:
        raw, above = above, next((name for name in forces if name not in inputs), None)
    if above is not None:
        yield _signal(above, recording.stream(above), start, end)
    if len(held) > 1:
        curves = [("raw", *_xy(raw, recording.stream(raw), start, end)[:2])] if raw else []
        curves += [("statistic", held.times_s, values[:, 0]), ("threshold", held.times_s, values[:, 1])]
        name = str(declared.get("statistic") or moments.detector)
        yield f"{name}, {unit}" if unit else name, curves


def _xy(name: str, series: Series, start: float, end: float) -> tuple[Floats, Floats, str]:
    own = series.between(start, end)
    values, unit = displayed(name, own.values[:, 0] if own.values.ndim > 1 else own.values, own.unit)
    places = extremes(values, POINTS)
    return own.times_s[places], values[places], unit


def _signal(
    name: str, series: Series, start: float, end: float
) -> tuple[str, list[tuple[str, Floats, Floats]]]:
    times_s, values, unit = _xy(name, series, start, end)
    return (f"{name}, {unit}" if unit else name), [("signal", times_s, values)]


WIDE, HIGH, LEFT, TOP, BELOW = 380.0, 92.0, 50.0, 20.0, 20.0
"""A plot, and the room for numbers on its left, its heading and its time axis, in the page's dots."""


class SignalPanel(NamedTuple):
    """A plot: its heading, and curves by (look, times in s, values)."""

    heading: str
    curves: Sequence[tuple[str, Floats, Floats]]

    def svg(self, moments: Moments, start: float, end: float) -> Markup:
        """The element; its time is in ms since the trial's event, its looks are the page's."""
        zero = moments.zero_s or moments.decided_s or 0.0
        inside = [y[(t >= start) & (t <= end)] for _, t, y in self.curves]
        known = np.concatenate([y[np.isfinite(y)] for y in inside] or [np.zeros(0)])
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        held = [
            y[np.isfinite(y)] for (look, *_), y in zip(self.curves, inside, strict=True) if look in STANDS
        ]
        if len(self.curves) > len(held) and len(beside := np.concatenate(held or [known])):
            span = (
                float(np.ptp(beside)) or high - low
            )  # what is compared fills a third; what is heard may leave
            low, high = max(low, float(beside.min()) - span), min(high, float(beside.max()) + span)
        pad = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
        low, high = low - pad, high + pad

        def x(t: Any) -> Any:
            return LEFT + (np.clip(t, start, end) - start) / (end - start) * (WIDE - LEFT - 8.0)

        def y(value: Any) -> Any:
            return TOP + HIGH - (np.clip(value, low, high) - low) / (high - low) * HIGH

        parts = [f'<text class="head" x="{LEFT:.0f}" y="12">{Markup.escape(self.heading)}</text>']
        for tick in _ticks(low, high, 3):
            parts.append(f'<path class="grid" d="M{LEFT:.0f} {y(tick):.1f}H{WIDE - 8:.0f}"/>')
            parts.append(f'<text class="y" x="{LEFT - 5:.0f}" y="{y(tick) + 3.5:.1f}">{figure(tick)}</text>')
        for tick in _ticks(1e3 * (start - zero), 1e3 * (end - zero), 4):
            at = x(zero + tick / 1e3)
            parts.append(f'<text class="x" x="{at:.1f}" y="{TOP + HIGH + 14:.0f}">{figure(tick)}</text>')
        event_s = moments.zero_s if moments.zero_s != moments.decided_s else None
        marks = (("zero", event_s), ("decided", moments.decided_s), ("stood", moments.stood_s))
        for look, t in marks:
            if t is not None and start <= t <= end:
                parts.append(f'<path class="{look}" d="M{x(t):.1f} {TOP:.0f}V{TOP + HIGH:.0f}"/>')
        for look, times_s, values in self.curves:
            stands = look in STANDS
            seen = (times_s, values) if stands else _within(times_s, values, low, high)
            parts.append(f'<path class="{look}" d="{_path(x(seen[0]), y(seen[1]), stands)}"/>')
        size = f'viewBox="0 0 {WIDE:.0f} {TOP + HIGH + BELOW:.0f}"'
        label = f'role="img" aria-label="{Markup.escape(self.heading)}"'
        return Markup(f'<svg xmlns="http://www.w3.org/2000/svg" {size} {label}>{"".join(parts)}</svg>')


STANDS = ("statistic", "threshold")
"""Curves whose value stands until the next."""


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
    first, last = math.ceil(low / step), math.floor(high / step)
    return [round(place * step, 12) for place in range(first, last + 1)]
