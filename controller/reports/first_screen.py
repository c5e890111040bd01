"""What a report opens with: a sentence of verdict and three numbers, by papers/headlines.csv."""

import math
import re
import shlex
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from controller.recording.reader import Run
from controller.reports.approaches import unjudged
from controller.reports.counts import (
    Mean,
    Row,
    Trials,
    decided,
    every,
    half_width,
    is_number,
    larger,
    mean_of,
    median_within,
    pairs_of,
    sized,
    sure,
    three,
    title,
    within_all,
)
from controller.reports.papers import RECORDED, came_to, headlines
from controller.reports.run_account import acting_of, experiment_in, setting_of
from controller.reports.section import UNTOLD, Headline, Result, rated
from controller.reports.trial_signals import is_instant, shown_as
from controller.scales import scale_of

WENT = {
    "well": "Went well",
    "partly": "Went partly well",
    "badly": "Went badly",
    "broken": "Broken off",
    "": "Recorded",
}
"""The verdict in words, by its state; where nothing says how well it went, that it was recorded."""

MOSTLY = 0.95
"""Share of trials that end as meant in a run that went well (assumption)."""


NEAR = 0.3
"""How near the paper's number the whole 95 % interval of ours must lie to be about it, relative (assumption)."""

MOST_SAID = 60
"""Characters of a missed goal's numbers that a sentence of verdict bears (assumption)."""


def went(state: str, runs: Iterable[Run]) -> str:
    """`Went well in simulation`: on a simulated bench nobody may take it for a measurement."""
    return WENT[state] + " in simulation" * all(run.simulated and not run.measured_by for run in runs)


def headline_of(
    experiment: str,
    runs: Sequence[Run],
    results: Sequence[Result],
    given: Headline | None,
    lost: bool = False,
) -> Headline:
    """The sentence and the numbers: what a section gives, else what papers/headlines.csv names, else, of an experiment
    of no paper, the first column that was measured. Where trials were `lost`, nothing stands beside the paper's."""
    rows, lines, done = Trials.of(runs), headlines(experiment), did(experiment, runs)
    outcomes = [(title(str(row["outcome"])), run.succeeded(row)) for run in runs for row in run.trials]
    n = max(len(outcomes), sum(int(run.manifest.get("trials") or 0) for run in runs))
    good = [name for name, succeeded in outcomes if succeeded]
    bad = Counter(name for name, succeeded in outcomes if not succeeded)
    bad += Counter({"not run": n - len(outcomes)})
    count = f"{len(good)} of {n} {'trial' if n == 1 else 'trials'} {done}"
    # of an experiment that nobody knows
    count += f" ({good[0]})" if len({*good}) == 1 and not lines else ""
    count += f" ({', '.join(f'{name}: {n}' for name, n in bad.most_common())})" if bad else ""
    found = given or listed(lines, rows, kinds_in(runs)) or (None if lines else _measured(runs, rows))
    if found is None and rows:
        found = rated("trials that ended as meant", len(good), len(rows))._replace(verdict="")
    found = found or Headline("trials that ended as meant", "none", "0 of 0")
    if lost:
        verdict = f"{found.what}: {found.ours}" if found.verdict else ""
        found = found._replace(paper="", source="", side="", state="", verdict=verdict)
    # where the trials only record, how many did says nothing
    said = [] if done == RECORDED and found.verdict and not bad else [count]
    said += [found.verdict] if found.verdict else []
    if not found.paper and not lost and (found.verdict or not lines):
        said.append("no paper prints this number" if lines else "there is no paper to compare with")
    if found.column == "delay_s" and any(setting_of(run, "behavior", "detector") for run in runs):
        found = found._replace(what=f"{found.what}, {_deciding(runs)}")
    marks = {result.mark for result in results}
    # by trials, goals, and the number beside the paper's together
    if lost or n > len(outcomes):
        state = "broken"
    elif 2 * len(good) < n or not good or found.state == "badly":
        state = "badly"
    elif (
        len(good) < MOSTLY * n
        or marks & {"missed", "apart"}
        or found.side == "worse"
        or found.state == "partly"
    ):
        state = "partly"
    else:
        judged = (
            done not in (RECORDED, UNJUDGED)
            or found.side in ("as", "better")
            or found.state
            or "met" in marks
        )
        state = "well" if judged else ""
    return found._replace(verdict=f"{went(state, runs)}: {'; '.join(said)}{goals_of(results)}.", state=state)


def _deciding(runs: Sequence[Run]) -> str:
    """By which detector the trials were decided; where a factor or a run chooses it, by several."""
    acting, kinds = {acting_of(run) for run in runs}, kinds_in(runs)
    chosen = any("behavior.detector" in row for run in runs for row in run.trials)
    if chosen or len(acting) > 1 or len(kinds) > 1:
        return "by several detectors"
    return "by the paper's detector" if kinds.pop().endswith(".paper") else f"by the detector {acting.pop()}"


def goals_of(results: Iterable[Result]) -> str:
    """`; 1 of 2 goals missed: force at detection (largest 0.4 N, the paper's 0.15 N)`; "" where none is missed."""
    judged = [result for result in results if result.mark in ("met", "missed")]
    missed = [_missed(result.text) for result in judged if result.mark == "missed"]
    if not missed:
        return ""
    named = f": {', '.join(missed)}" if len(missed) <= 2 else ""
    return f"; {len(missed)} of {len(judged)} {'goal' if len(judged) == 1 else 'goals'} missed{named}"


def _missed(text: str) -> str:
    """A missed goal by its name, and by its numbers where they stand before the first bracket."""
    name, _, rest = text.partition(": ")
    numbers = rest.partition(" (")[0].rstrip(".")
    return f"{name[:1].lower()}{name[1:]}" + (f" ({numbers})" if 0 < len(numbers) <= MOST_SAID else "")


def agreement_of(results: Iterable[Result]) -> str:
    """`2 as the paper, 1 better, 1 worse`: the paper's results that are judged here; "" where none is."""
    marks = Counter(result.mark for result in results)
    words = {"same": "as the paper", "better": "better", "worse": "worse", "apart": "otherwise"}
    return ", ".join(f"{marks[mark]} {word}" for mark, word in words.items() if marks[mark])


def kinds_in(runs: Iterable[Run]) -> set[str]:
    """Kinds of the detectors that decided."""
    return {str(setting_of(run, "detectors", acting_of(run), "kind") or "") for run in runs}


UNJUDGED = "ended at a detection"
"""What trials did of which nothing on their bench tells a true contact from a false one."""


def did(experiment: str, runs: Iterable[Run]) -> str:
    """What trials of one experiment did that came out as they should."""
    unknown = any(unjudged(row) for run in runs for row in run.trials if "false_contacts" in row)
    return UNJUDGED if unknown else came_to(experiment)


def listed(lines: Sequence[Row], rows: Sequence[Row], kinds: Iterable[str] = ()) -> Headline | None:
    """What the first line says that has a number of its own trials; the paper's figure stands beside that of detectors
    of the kind that it is of alone."""
    for line in lines:
        own = Trials(row for row in rows if holds(line, row))
        foreign = line["detector"] and any(kind and not kind.startswith(line["detector"]) for kind in kinds)
        if line["column"] and (found := _number(own, {**line, "paper": None} if foreign else line)):
            return found
    return None


def holds(line: Row, row: Row) -> bool:
    """Whether a line is of a trial, by all its conditions (`object!=none`, `axis=x`)."""
    for name, sign, value in re.findall(r"([\w.]+)(!?=)([\w.]+)", line["where"] or ""):
        cell = row.get(name)
        same = float(cell) == float(value) if is_number(cell) else str(cell) == value
        if name in row and same != (sign == "="):
            return False
    return True


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


def _number(own: Trials, line: Row) -> Headline | None:
    """One figure over some trials, with its 95 % interval, beside the paper's."""
    name, over, paper = str(line["column"]), str(line["over"]), line["paper"]
    known = own.values(name)
    source = f"the paper's ({line['source']})" if paper is not None else ""
    rows = "" if len(known) == len(own) else f"{name}>-1e300"
    if not known:
        return None
    if over in ("ratio", "share"):
        of = own.total(line["of"]) if over == "ratio" else len(known)
        hits = int(sum(known))
        above = None if paper is None or not of else decided(hits, of, paper)
        return rated(line["what"], hits, of, paper, source, rows, name, above) if of else None
    made, value_of, span_of = OVER[over]
    value, n = value_of(known), len(known)
    low, high = span_of(known) if n > 1 else (math.nan, math.nan)
    scale = shown_as(name, [value, paper or 0.0])

    def said(*values: float) -> str:
        ends = dict.fromkeys(three(value * scale.factor) for value in values)  # they may read alike
        return f"{' to '.join(ends)} {scale.unit}".rstrip()

    interval = said(low, high) if math.isfinite(high - low) else within_all(n) if over == "worst" else ""
    less = bool(line.get("less"))
    of_all = f"{made} of {n}{'; less is better' if less and paper is None else ''}" if n > 1 else "one trial"
    beside, side, theirs = f"{line['what']} {said(value)}", "", ""
    if paper is not None:
        theirs = said(paper)
        # one trial alone decides nothing
        below = sure(high < paper, low > paper)
        if over == "worst":
            below = every(sum(abs(each) > paper for each in known), n)
        held = low <= paper <= high
        if abs(value / paper - 1.0) < 0.005 or (held and max(paper - low, high - paper) <= NEAR * paper):
            side = "as"
        elif below is not None:
            side = ("better" if below else "worse") if less else "apart"
        how = {"as": "about", "apart": "beside", "": "beside"}.get(side, f"{side} than")
        beside += f", {how} the paper's {theirs}"
        if side != "as" and (how := UNTOLD if held else sized(value, paper, scale.unit)):
            beside += f" ({how})"
    spread = said(min(known), max(known)) if n > 1 and over != "worst" else ""
    spread = "" if spread == interval else spread  # of few, both may read alike
    return Headline(
        line["what"], said(value), of_all, theirs, source, interval, beside, rows, name, "", side, spread
    )


def beside_each_other(before: Sequence[Run], after: Sequence[Run]) -> str:
    """Which of two is better, by the mean that both open with, or that no difference is told; "" where that is no mean
    of which less is better. Where trials of the two are pairs, these alone decide."""
    lines = headlines(experiment_in(before[-1]))
    line = next((each for each in lines if each["column"] and each["over"] == "mean" and each["less"]), None)
    if line is None:
        return ""
    name, what = str(line["column"]), line["what"]
    all_ = [Trials.of(each).known(name).where(lambda row: holds(line, row)) for each in (before, after)]
    if pairs := pairs_of(before[-1], after[-1], *all_):
        all_ = list(map(Trials, zip(*pairs, strict=True)))
    one, other = (each.mean(name) for each in all_)
    if not one.n or not other.n:
        return ""
    off = mean_of(mine[name] - theirs[name] for mine, theirs in pairs)
    better = larger(off, Mean(0.0, 0.0, 2)) if pairs else larger(one, other)
    over = f", over {len(pairs)} pairs of trials" if pairs else ""
    scale = shown_as(name, [one.mean, other.mean])
    first, second = (f"{three(each.mean * scale.factor)} {scale.unit}".rstrip() for each in (one, other))
    if better is None:
        said = f"No difference told: {what} {second}, the first run's {first}{over}"
        return f"{said}; the interval of the difference holds zero."
    how = sized(other.mean, one.mean, scale_of(name).unit)
    said = f"The {'second' if better else 'first'} is better: {what} {second}"
    return f"{said}, {how} than the first run's {first}{over}."


def _measured(runs: Sequence[Run], rows: Trials) -> Headline | None:
    """The first number that an experiment of no paper measured: no factor, no instant of the trial."""
    name = first_measured(runs, rows)
    line = {"column": name, "over": "mean", "paper": None, "what": scale_of(name).label, "source": ""}
    return _number(rows, line) if name else None


def first_measured(runs: Sequence[Run], rows: Sequence[Row]) -> str:
    """Its column; "" for none."""
    factors = {"trial", "outcome", *(name for run in runs for name in run.factors)}
    known = {name for row in rows for name, cell in row.items() if is_number(cell)} - factors
    ordered = (name for row in rows for name in row)
    return next((name for name in ordered if name in known and not is_instant(name)), "")


def again(run: Run) -> str:
    """The command that makes a run again."""
    profile = run.manifest.get("profile") or {}
    asked = profile.get("asked") or {}
    words = ["run.py", "run", str(asked.get("profile") or profile.get("name", "?"))]
    options = [("set", f"{path}={value}") for path, value in (asked.get("set") or {}).items()]
    options += [("only", trial) for trial in asked.get("only") or ()]
    options += [("seed", seed)] if (seed := run.manifest.get("seed")) else []
    return shlex.join(words + [word for name, value in options for word in (f"--{name}", str(value))])
