"""What a report opens with: a sentence of verdict and three numbers, by papers/headlines.csv."""

import math
import shlex
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from controller.outcomes import UNMEASURED
from controller.recording.reader import Run
from controller.reports.counts import (
    Comparison,
    Row,
    half_width,
    is_number,
    mean_of,
    median_within,
    three,
    title,
    within_all,
)
from controller.reports.papers import came_to, headlines
from controller.reports.run_account import acting_of, setting_of
from controller.reports.section import Headline, Result, rated
from controller.reports.trial_signals import is_instant
from controller.scales import scale_of


def headline_of(
    experiment: str, runs: Sequence[Run], results: Sequence[Result], given: Headline | None
) -> Headline:
    """The sentence and the numbers: what a section gives, else what papers/headlines.csv names, else, of an experiment
    of no paper, the first column that was measured."""
    trials = [(run, row) for run in runs for row in run.trials]
    rows = [row for _, row in trials if row.get("outcome") not in UNMEASURED]
    good, n = sum(run.succeeded(row) for run, row in trials), len(trials)
    bad = Counter(str(row["outcome"]) for run, row in trials if not run.succeeded(row))
    lines = headlines(experiment)
    count = f"{good} of {n} {'trial' if n == 1 else 'trials'} {came_to(experiment)}"
    named = {title(str(row["outcome"])) for run, row in trials if run.succeeded(row)}
    count += (
        f" ({named.pop()})" if len(named) == 1 and not lines else ""
    )  # of an experiment that nobody knows
    missed = f" ({', '.join(f'{n} {title(name)}' for name, n in bad.most_common())})" if bad else ""
    found = given or listed(lines, rows, set(map(_kind, runs))) or _measured(runs, rows)
    if found is None and rows:
        found = rated("trials that succeeded", good, len(rows))._replace(verdict="")
    found = found or Headline("trials that succeeded", "none", "0 of 0")
    said = [found.verdict] if found.verdict else []
    if not found.paper:
        said.append("no paper prints this number" if lines else "there is no paper to compare with")
    # where the trials only record, how many did is said last
    said.insert(len(said) if found.state else 0, f"{count}{missed}")
    if found.column == "delay_s" and any(setting_of(run, "behavior", "detector") for run in runs):
        found = found._replace(what=f"{found.what}, {_deciding(runs)}")
    state = "none" if not good else "all" if good == n else "some"
    sentence = f"{'; '.join(said)}{goals_of(results)}."
    return found._replace(
        verdict=f"{sentence[:1].upper()}{sentence[1:]}",
        agreement=agreement_of(results),
        state=found.state if found.state and good == n else state,
    )


def _deciding(runs: Sequence[Run]) -> str:
    """By which detector the trials were decided; where a factor or a run chooses it, by several."""
    acting, kinds = {acting_of(run) for run in runs}, set(map(_kind, runs))
    chosen = any("behavior.detector" in row for run in runs for row in run.trials)
    if chosen or len(acting) > 1 or len(kinds) > 1:
        return "by several detectors"
    return "by the paper's detector" if kinds.pop().endswith(".paper") else f"by the detector {acting.pop()}"


def goals_of(results: Iterable[Result]) -> str:
    """`; 1 of 2 goals met (missed: force at detection)`, of those that are judged."""
    judged = [result for result in results if result.mark in ("met", "missed")]
    missed = [f"{each.text[:1].lower()}{each.text[1:]}" for each in judged if each.mark == "missed"]
    if len(judged) == 1:
        return f"; its goal is {'missed' if missed else 'met'}"
    named = (
        f" (missed: {', '.join(text.partition(':')[0] for text in missed)})" if 0 < len(missed) <= 2 else ""
    )
    return f"; {len(judged) - len(missed)} of {len(judged)} goals met{named}" if judged else ""


def agreement_of(results: Iterable[Result]) -> str:
    """How many of the paper's results come out here, which is no praise and no blame; "" where none is judged."""
    marks = Counter(result.mark for result in results)
    of = marks["same"] + marks["apart"]
    return f"{marks['same']} of {of} reproduced" if of else ""


def _kind(run: Run) -> str:
    return str(setting_of(run, "detectors", acting_of(run), "kind") or "")


def listed(lines: Sequence[Row], rows: Sequence[Row], kinds: Iterable[str] = ()) -> Headline | None:
    """What the first line that has a number says, of detectors of such kinds: the paper's figure stands beside the
    trials and the `detector` that it is of alone."""
    for line in lines:
        own = [row for row in rows if holds(line, row)]
        others = [] if own else [row for row in rows if _meets(conditions(line)[0], row)] or rows
        foreign = line["detector"] and any(kind and not kind.startswith(line["detector"]) for kind in kinds)
        shown = line if own and not foreign else {**line, "paper": None}
        if line["column"] and (found := _number(own or others, shown)):
            return found
    return None


def conditions(line: Row) -> list[str]:
    """Of which trials a line is: `object!=none`, `axis=x`."""
    return str(line["where"] or "").split("&")


def holds(line: Row, row: Row) -> bool:
    """Whether a line is of a trial."""
    return all(_meets(condition, row) for condition in conditions(line))


def _meets(condition: str, row: Row) -> bool:
    name, sign, value = condition.partition("!=") if "!=" in condition else condition.partition("=")
    if not sign or name not in row:
        return True
    cell = row.get(name)
    same = float(cell) == float(value) if is_number(cell) else str(cell) == value
    return same == (sign == "=")


def _span_of_mean(known: Sequence[float]) -> tuple[float, float]:
    mean = mean_of(known)
    least = 0.0 if min(known) >= 0.0 else -math.inf  # of what is never negative
    return max(least, mean.mean - half_width(mean)), mean.mean + half_width(mean)


OVER: Mapping[str, tuple[str, Callable[[Sequence[float]], float], Callable[[Sequence[float]], Any]]] = {
    "mean": ("mean", statistics.fmean, _span_of_mean),
    "median": ("median", statistics.median, lambda known: median_within(np.sort(known))),
    "worst": ("largest", lambda known: max(map(abs, known)), lambda known: (math.nan, math.nan)),
}
"""How one number is made of those of the trials: its name, it, and its 95 % interval."""


def _number(own: Sequence[Row], line: Row) -> Headline | None:
    """One figure over some trials, with its 95 % interval, beside the paper's."""
    name, over, paper = str(line["column"]), str(line["over"]), line["paper"]
    known = [float(row[name]) for row in own if is_number(row.get(name))]
    source = f"the paper's ({line['source']})" if paper is not None else ""
    rows = "" if len(known) == len(own) else f"{name}>-1e300"
    if not known:
        return None
    if over in ("ratio", "share"):
        of = sum(int(row.get(line["of"]) or 0) for row in own) if over == "ratio" else len(known)
        return rated(line["what"], int(sum(known)), of, paper, source, rows, name) if of else None
    scale = scale_of(name)

    def said(*values: float) -> str:
        ends = dict.fromkeys(three(value * scale.factor) for value in values)  # they may read alike
        return f"{' to '.join(ends)} {scale.unit}".rstrip()

    made, value_of, span_of = OVER[over]
    value, n = value_of(known), len(known)
    low, high = span_of(known) if n > 1 else (math.nan, math.nan)
    interval = said(low, high) if math.isfinite(high - low) else within_all(n) if over == "worst" else ""
    beside = f"{line['what']} {said(value)}"
    if paper is not None:
        if low <= paper <= high and abs(value / paper - 1.0) >= 0.005:
            beside += f"; the paper's {said(paper)} is inside its 95 % interval"
        else:
            beside += f", {_against(value, paper)} the paper's {said(paper)}"
    of_all = f"{made} of {n}{'; less is better' if line.get('less') else ''}" if n > 1 else "one trial"
    theirs = said(paper) if paper is not None else ""
    return Headline(line["what"], said(value), of_all, theirs, source, interval, beside, rows, name)


def _against(ours: float, paper: float) -> str:
    beside, off = Comparison(ours, paper), abs(ours / paper - 1.0)
    return beside.times if off >= 0.5 else f"{100.0 * off:.2g} % {beside.side}" if off >= 0.005 else "as"


def _measured(runs: Sequence[Run], rows: Sequence[Row]) -> Headline | None:
    """The first number that an experiment of no paper measured: no factor, no instant of the trial."""
    name = first_measured(runs, rows)
    line = {"column": name, "over": "mean", "paper": None, "what": scale_of(name).label, "source": ""}
    return _number(rows, line) if name else None


def first_measured(runs: Sequence[Run], rows: Sequence[Row]) -> str:
    """Its column; "" for none."""
    factors = {"trial", "outcome", *(name for run in runs for name in run.factors)}
    names = (name for row in rows for name, cell in row.items() if name not in factors and is_number(cell))
    known = {*names}
    ordered = dict.fromkeys(name for row in rows for name in row)
    return next((name for name in ordered if name in known and not is_instant(name)), "")


def again(run: Run) -> str:
    """The command that makes a run again."""
    profile = run.manifest.get("profile") or {}
    asked = profile.get("asked") or {}
    words = ["run.py", "run", str(asked.get("profile") or profile.get("name", "?"))]
    for path, value in (asked.get("set") or {}).items():
        words += ["--set", f"{path}={value}"]
    for trial in asked.get("only") or ():
        words += ["--only", str(trial)]
    seed = run.manifest.get("seed")
    return shlex.join([*words, *(["--seed", str(seed)] if seed else [])])
