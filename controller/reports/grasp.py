"""The part of the page on D1: how an object was held, in the words of NIST's measures of hands, and one grasp drawn."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from behaviors.lift import LIFTING
from controller.recording.reader import Run
from controller.recording.series import TrialRecording
from controller.reports.counts import (
    Row,
    Trials,
    decided,
    every,
    median_within,
    missing,
    percent,
    quantity,
    three,
    wilson,
)
from controller.reports.figures import FALSE, GOOD, INK, OURS, PAPER, Figures
from controller.reports.run_account import entered_s, recorded, setting_of
from controller.reports.section import Headline, Section, told
from controller.reports.trial_signals import key_of, said_of
from controller.scales import NOTHING
from drivers.core.messages import Floats

UP = tuple(dict.fromkeys(state for row in LIFTING for state in row.sources if state != "LOWERING"))
"""States in which the object is held, in order."""

WANTED = {
    "grip over least force, median": ("grip_over_least", 0.5, 1.2),
    "grip over least force, 95 of 100": ("grip_over_least", 0.95, 1.4),
    "slip in the air until held, median": ("arrested_m", 0.5, 1e-3),
    "slip in the air until held, 95 of 100": ("arrested_m", 0.95, 2e-3),
    "side push at first touch, largest": ("push_n", 1.0, 0.1),
}
"""What is aimed at: column, quantile, bound. Ours."""

MET = {True: "✓ met", False: "✗ missed", None: "not judged"}

GRIP = re.compile(r"Grip\(.*, ([0-9.e+-]+)\)")
"""A grip among an event's commands, and its force, N."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Outcomes, NIST's measures, told against true slips, and the timeline of one grasp."""
    rows = Trials.of(runs)
    over = rows.values("grip_over_least")
    content: dict[str, Any] = {
        "rows": rows,
        "over": over,
        "met": decided(sum(each <= 1.2 for each in over), len(over), 0.5),
        "measures": [_measures(rows)],
        "told": _told(rows),
        "goals": [{**goal, "met": MET[None if missing(runs) else goal["met"]]} for goal in _goals(rows)],
        "timeline": "",
    }
    slipped = (each for each in recorded(runs) if each[1].get("slips"))
    if found := next(((svg, each) for each in slipped if (svg := _draw(figures, *each))), None):
        content["timeline"], (run, row, _) = found
        key = key_of(figures.page or runs, run, int(row["trial"]))
        content |= {"key": key, "trial": row["trial"], "said": said_of(run, row)}
    more: dict[str, Any] = {"shows_trials": not found, "headline": _headline(runs)}
    return told(runs, "A grasp with little more than the least force (D1)", "grasp", content, **more)


def _headline(runs: Sequence[Run]) -> Headline | None:
    """How hard the jaws press where they may: what takes less than the grip that it begins with is
    pressed by that anyway."""
    known = [
        (row, setting_of(run, "behavior", "grip_force_n") or 0.0)
        for run in runs
        for row in Trials.of([run]).known("grip_over_least", "grip_n")
    ]
    over = np.sort([float(row["grip_over_least"]) for row, least_n in known if row["grip_n"] > least_n])
    if not len(over):
        return None
    low, high = median_within(over)
    value, light = three(float(np.median(over))), len(known) - len(over)
    of = f"median of {len(over)} lifts" if len(over) > 1 else "one lift"
    of += f" that need more than the first grip ({light} not)" if light else ""
    of += "; 1 would be the least"
    return Headline(
        "grip over the least force that holds the object",
        value,
        of,
        interval=f"{three(low)} to {three(high)}" if math.isfinite(high) else "",
        verdict=f"the jaws press {value} times the least force that holds the object",
        column="grip_over_least",
    )


def _measures(rows: Trials) -> Row:
    """One line in NIST's words."""
    known = rows.known("friction_true", "felt_n")
    resisted = Trials({"most_n": row["friction_true"] * row["felt_n"]} for row in known)
    shown = {
        "touch sensitivity, N": rows.median("felt_n"),
        "slip resistance of a finger then, N": resisted.median("most_n"),
        "grasp efficiency: grip over least": rows.median("grip_over_least"),
        "cycle time, s": rows.median("cycle_s"),
    }
    both = rows.known("friction", "friction_true")
    inside = both.where(lambda row: row["friction_low"] <= row["friction_true"] <= row["friction_high"])
    line: dict[str, Any] = {"lifts": len(rows.known("slips"))}
    line |= {name: NOTHING if value is None else three(value) for name, value in shown.items()}
    said = f"{len(inside)} of {len(both)}" if both else "not known"
    return line | {"friction within its 90 % interval": said}


def _told(rows: Trials) -> list[Row]:
    """Slips that the jaws acted on against slips that were."""
    known = rows.known("told_true")
    acted = {"": "acted on", "a slip": known.total("told_true"), "none": known.total("told_false")}
    return [acted, {"": "not acted on", "a slip": known.total("untold"), "none": ""}] if known else []


def _goals(rows: Trials) -> Iterator[Row]:
    """Each goal, the figure, and whether it is met; None where so many trials do not decide it (95 % interval)."""
    # a trial that found or gripped nothing shows neither that it lifts nor that it does not
    lifts = rows.known("slips")
    n = len(lifts)
    for name, outcomes in (
        ("dropped, or never lifted", ("dropped", "not_lifted")),
        ("crushed", ("crushed",)),
    ):
        hits = sum(row["outcome"] in outcomes for row in lifts)
        low, high = wilson(hits, n)
        text = f"{hits} of {n}: {three(100 * low)} to {three(100 * high)} %" if n else "no lift"
        yield {"goal": name, "aimed at": "1 %", "found": text, "met": decided(n - hits, n, 0.99)}
    for name, (column, part, bound) in WANTED.items():
        known = [value for value in rows.values(column) if value or column != "arrested_m"]
        if known:
            value, of = float(np.quantile(known, part)), len(known)
            shown, aim = f"{quantity(column, value)} of {of}", quantity(column, bound)
            if column == "grip_over_least":
                shown, aim = three(value), three(bound)
            within = sum(each <= bound for each in known)
            met = every(of - within, of) if part == 1.0 else decided(within, of, part)
            yield {"goal": name, "aimed at": aim, "found": shown, "met": met}
    if known := rows.values("told_false"):
        hits, of = sum(map(bool, known)), len(known)
        line = {"goal": "lifts with a slip acted on that was none", "aimed at": "2 %"}
        yield line | {"found": f"{hits} of {of}, {percent(hits / of)}", "met": decided(of - hits, of, 0.98)}


def _draw(figures: Figures, run: Run, row: Row, recording: TrialRecording) -> str:
    """The timeline of one grasp; "" where it was not lifted."""
    own = run.events_of(row["trial"])
    entered = entered_s(run, row["trial"])
    if "CLOSING" not in entered or "LOWERING" not in entered:
        return ""
    first_s, last_s = entered["CLOSING"], entered["LOWERING"]
    felt = recording.stream("signals.pad").between(first_s, last_s)
    if len(felt) < 2:
        return ""
    friction = row.get("friction_true")
    with figures.figure(3.6, rows=2, sharex=True, height_ratios=(3, 2)) as drawing:
        top, below = drawing.axes
        step = max(1, len(felt) // 2000)
        times_s, load_n = felt.times_s[::step], _smooth(felt.values[:, 2])[::step]
        forces = list(_commanded(own, first_s, last_s))
        top.plot(times_s, _smooth(felt.values[:, 3])[::step], color=PAPER, lw=0.8, label="felt by the pad")
        top.step(*zip(*forces, strict=True), where="post", color=OURS, label="commanded grip")
        if friction:
            top.plot(times_s, load_n / float(friction), color=GOOD, lw=0.9, label="least force")
        below.plot(times_s, load_n, color=INK, lw=0.8)
        slips_s = list(_acted_s(own, first_s, last_s))
        below.plot(slips_s, np.interp(slips_s, times_s, load_n), "v", color=FALSE, label="slip, acted on")
        _shade(drawing.axes, entered, last_s)
        _say_where(top, row, entered, last_s)
        top.set_ylabel("N")
        top.set_ylim(0.0, 1.15 * max(force for _, force in forces))
        below.set_ylabel("load, N")
        below.set_xlabel(f"time in trial {row['trial']} (s)")
        top.legend(loc="upper left", ncols=3)
        below.legend(loc="upper left")
        return drawing.save("grasp")


def _smooth(values_n: Floats) -> Floats:
    return np.convolve(values_n, np.full(10, 0.1), "same")


def _shade(axes: Sequence[Any], entered_s: Mapping[str, float], last_s: float) -> None:
    """Every other state, and their names above."""
    states = [state for state in ("CLOSING", *UP) if state in entered_s]
    spans_s = pairwise([*(entered_s[state] for state in states), last_s])
    for place, (state, span_s) in enumerate(zip(states, spans_s, strict=True)):
        for each in axes if place % 2 else ():
            each.axvspan(*span_s, color=PAPER, alpha=0.08, lw=0)
        look: Any = {"ha": "center", "va": "bottom", "fontsize": 7.5, "xycoords": ("data", "axes fraction")}
        axes[0].annotate(state.lower(), (0.5 * sum(span_s), 1.0), **look)


def _say_where(axes: Any, row: Row, entered_s: Mapping[str, float], last_s: float) -> None:
    """Over which span grip over least is taken."""
    held_s = entered_s.get("HOLDING")
    if held_s is None or (over := row.get("grip_over_least")) is None:
        return
    ends: Any = {"xycoords": ("data", "axes fraction"), "arrowprops": {"arrowstyle": "<->", "lw": 0.8}}
    axes.annotate("", (held_s, 0.08), (last_s, 0.08), textcoords=("data", "axes fraction"), **ends)
    said = f"grip over least: {three(float(over))},\nmedian of this span"
    look: Any = {"xycoords": ("data", "axes fraction"), "va": "bottom", "fontsize": 7.5, "ha": "center"}
    axes.annotate(said, (0.5 * (held_s + last_s), 0.12), **look)


def _commanded(
    events: Sequence[Mapping[str, Any]], first_s: float, last_s: float
) -> list[tuple[float, float]]:
    """When the grip's force was commanded, and how much."""
    found = [
        (float(event["t_s"]), float(said[1]))
        for event in events
        for command in event.get("commands") or ()
        if (said := GRIP.fullmatch(str(command))) and first_s <= float(event["t_s"]) <= last_s
    ]
    return [*found, (last_s, found[-1][1])] if found else [(first_s, 0.0), (last_s, 0.0)]


def _acted_s(events: Sequence[Mapping[str, Any]], first_s: float, last_s: float) -> Iterator[float]:
    """When the jaws were made to press harder by what is no load: at once, or when a slip had lasted."""
    before_n = math.inf
    for event in events:
        for t_s, force_n in _commanded([event], first_s, last_s)[:1]:
            if force_n > before_n and event.get("event") in ("SlipStarted", "Tick"):
                yield t_s
            before_n = force_n or before_n
