"""The part of the page on C2, C4 and C5: approaches, touches and nothing at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from behaviors.aura import AuraFactors
from controller.measures.aura import METHODS
from controller.recording.reader import Run
from controller.reports.counts import rate, total, values
from controller.reports.figures import FAINT, FALSE, GOOD, OURS, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Section
from controller.reports.sonicfinger import (
    CITATION,
    CONTACT,
    METHOD_NAMES,
    NOT_THE_PAPERS,
    PRE_TOUCH,
    rows_of,
)
from controller.reports.text import number

SIDES = ("normal", "back", "front", "top", "bottom")
SOFT = ("sponge", "cloth")
"""Objects that are no paper's: soft ones, counted by themselves."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Everything that was said of every approach."""
    rows = rows_of(runs)
    there = [row for row in rows if factor(row, "object") != "none"]
    nothing = [row for row in rows if factor(row, "object") == "none"]
    objects = sorted({factor(row, "object") for row in there})
    tables = [_sides_table(there)]
    if len(objects) > 1 or nothing:
        tables += [_objects_table(there, nothing, objects)]
    if total(there, "touches"):
        tables += [_touch_table(there)]
    drawn = _draw(runs, figures)
    return Section(
        title=_title(rows, objects),
        template="plain.html.j2",
        citation=CITATION,
        summary=_summary(there, nothing),
        not_the_papers=[
            *NOT_THE_PAPERS,
            "“Object”, “nothing” and what touched when are known because they are simulated: no detector is told.",
        ],
        context={
            "paragraphs": [
                "One finger approaches an object with one of its sides, stays at the end of its way or "
                "touches, and comes back. "
                "Both methods hear the same samples."
            ],
            "tables": tables,
            "figures": drawn,
            "notes": _notes(there),
        },
    )


def _title(rows: Sequence[Any], objects: Sequence[str]) -> str:
    if len(objects) > 1:
        return "Objects (C5)"
    return "Contact (C4)" if total(rows, "touches") else "Pre-touch (C2)"


def factor(row: Mapping[str, Any], name: str) -> str:
    """A trial's factor as a word; the behavior's default where the trials do not vary it."""
    value = row.get(name)
    return str(AuraFactors.model_fields[name].default if value is None else value)


def _groups(rows: Sequence[Any], *names: str) -> Mapping[tuple[str, ...], list[Any]]:
    """Trials by the values of some factors, sides in the paper's order."""
    groups: dict[tuple[str, ...], list[Any]] = {}
    for row in rows:
        groups.setdefault(tuple(factor(row, name) for name in names), []).append(row)

    def order(key: tuple[str, ...]) -> tuple[tuple[int, str], ...]:
        return tuple((SIDES.index(part) if part in SIDES else 0, part) for part in key)

    return {key: groups[key] for key in sorted(groups, key=order)}


def _median(numbers: Sequence[float], digits: int, scale: float = 1.0) -> str:
    return number(float(np.median(numbers)) if numbers else None, digits, scale)


def _sides_table(rows: Sequence[Any]) -> Mapping[str, Any]:
    body = []
    for (side, axis, speed), members in _groups(rows, "side", "axis", "speed_m_s").items():
        approaches = total(members, "approaches")
        cells = [side, axis, speed, str(approaches)]
        cells.append(_median(values(members, "undulations_per_cm"), 2))
        for method in METHODS:
            cells.append(f"{total(members, f'seen_{method}')} of {approaches}")
            cells.append(_median(values(members, f"distance_m_{method}"), 1, 100.0))
        body.append(cells)
    return {
        "caption": "Pre-touch by side, axis and speed. Undulations are those of the whole approach, per cm of way; "
        "half a wave is 0.43 cm, so 2.33 are expected where the finger goes straight at the object. “From” is "
        "the way left to go: along x the distance to the object.",
        "head": ["side", "axis", "speed, m/s", "approaches", "undulations/cm"]
        + [f"{what}, {METHOD_NAMES[method]}" for method in METHODS for what in ("seen", "from, cm")],
        "rows": body,
        "left": 2,
    }


def _objects_table(there: Sequence[Any], nothing: Sequence[Any], objects: Sequence[str]) -> Mapping[str, Any]:
    body = []
    for name in sorted(objects, key=lambda each: (each in SOFT, each)):
        members = [row for row in there if factor(row, "object") == name]
        body.append([name + (" (soft)" if name in SOFT else ""), *_rates(members, ())])
    hard = [row for row in there if factor(row, "object") not in SOFT]
    body.append(["all but the soft ones", *_rates(hard, nothing)])
    return {
        "caption": "True positives of pre-touch and contact, and true negatives over approaches to nothing "
        "(pre-touch) and over all "
        "approaches (contact), with 95 % intervals (Wilson). The paper: "
        f"{PRE_TOUCH[0]:.1%} and {PRE_TOUCH[1]:.1%}; {CONTACT[0]:.1%} and {CONTACT[1]:.1%}.",
        "head": ["object", "events"]
        + [
            f"{what}, {METHOD_NAMES[method]}"
            for what in ("pre-touch TPR", "pre-touch TNR", "contact TPR", "contact TNR")
            for method in METHODS
        ],
        "rows": body,
        "left": 1,
    }


def _rates(there: Sequence[Any], nothing: Sequence[Any]) -> list[str]:
    approaches, empty = total(there, "approaches"), total(nothing, "approaches")
    touches = total(there, "touches")
    cells = [str(approaches + empty + touches + approaches + empty)]
    for method in METHODS:
        cells.append(rate(total(there, f"seen_{method}"), approaches))
    for method in METHODS:
        cells.append(rate(empty - total(nothing, f"alarms_{method}"), empty))
    for method in METHODS:
        cells.append(rate(total(there, f"felt_{method}"), touches))
    for method in METHODS:
        false = total(there, f"false_{method}") + total(nothing, f"false_{method}")
        cells.append(rate(approaches + empty - false, approaches + empty))
    return cells


def _touch_table(rows: Sequence[Any]) -> Mapping[str, Any]:
    body = []
    for (side,), members in _groups(rows, "side").items():
        touches = total(members, "touches")
        cells = [side, str(touches)]
        for method in METHODS:
            cells.append(rate(total(members, f"felt_{method}"), touches))
            cells.append(_median(values(members, f"delay_s_{method}"), 0, 1e3))
            cells.append(f"{total(members, f'held_{method}')}, {total(members, f'ended_{method}')}")
        body.append(cells)
    return {
        "caption": "Contact by side: touches that were felt, median delay, and of how many persistence and "
        "end were told. "
        "The paper: all, but for the top.",
        "head": ["side", "touches"]
        + [
            f"{what}, {METHOD_NAMES[method]}"
            for method in METHODS
            for what in ("felt", "delay, ms", "persistence, end")
        ],
        "rows": body,
        "left": 1,
    }


def _summary(there: Sequence[Any], nothing: Sequence[Any]) -> list[tuple[bool | None, str]]:
    said: list[tuple[bool | None, str]] = []
    sides = sorted({factor(row, "side") for row in there}, key=SIDES.index)
    if len(sides) > 1:
        for method in METHODS:
            seen = [
                side
                for side in sides
                if total([row for row in there if factor(row, "side") == side], f"seen_{method}")
            ]
            blind = [side for side in sides if side not in seen]
            words = "sees from every side" if not blind else f"sees nothing from {', '.join(blind)}"
            said.append((not blind, f"Pre-touch, {METHOD_NAMES[method]}: {words}."))
    for what, hits, of, bound in (
        ("Pre-touch", "seen", "approaches", PRE_TOUCH[0]),
        ("Contact", "felt", "touches", CONTACT[0]),
    ):
        count = total(there, of)
        # The paper's pre-touch rate is over its objects, not over the pipe and its axes.
        of_objects = len({factor(row, "object") for row in there}) > 1
        for method in METHODS if count and (of_objects or what == "Contact") else ():
            found = total(there, f"{hits}_{method}")
            said.append(
                (
                    found / count >= bound,
                    f"{what}, {METHOD_NAMES[method]}: {found} of {count} {of}, {rate(found, count)}; "
                    f"the paper {bound:.1%} of its own.",
                )
            )
    if nothing:
        empty = total(nothing, "approaches")
        for method in METHODS:
            alarms = total(nothing, f"alarms_{method}")
            words = f"{alarms} alarms in {empty} approaches to nothing"
            said.append(
                (None, f"Pre-touch, {METHOD_NAMES[method]}: {words}; the paper {1.0 - PRE_TOUCH[1]:.1%}.")
            )
    return said


def _notes(rows: Sequence[Any]) -> list[str]:
    by_speed = _groups([row for row in rows if factor(row, "axis") == "x"], "side", "speed_m_s")
    counts: dict[str, dict[str, float]] = {}
    for (side, speed), members in by_speed.items():
        found = values(members, "undulations_per_cm")
        if found:
            counts.setdefault(side, {})[speed] = float(np.median(found))
    notes = []
    for side, medians in counts.items():
        if len(medians) > 1:
            said = ", ".join(f"{number(count, 2)} at {speed} m/s" for speed, count in medians.items())
            notes.append(f"Undulations per cm of the {side} side: {said}.")
    return notes


def _draw(runs: Sequence[Run], figures: Figures) -> list[Mapping[str, Any]]:
    """The envelope along the approach: one panel for each side and speed of which there is a recording (Fig. "
    "4d, 6, 7)."""
    panels: dict[tuple[str, str, str], tuple[Run, int]] = {}
    for run in runs:
        recorded = set(run.recorded_trials)
        for row in run.trials:
            trial = int(row["trial"] or 0)
            if factor(row, "object") == "pipe" and factor(row, "axis") == "x" and trial in recorded:
                key = (factor(row, "side"), factor(row, "speed_m_s"), "")
                panels.setdefault(key, (run, trial))
    keys = sorted(panels, key=lambda key: (SIDES.index(key[0]), key[1]))[:10]
    if not keys:
        return []
    columns = 2 if len(keys) > 1 else 1
    rows = -(-len(keys) // columns)
    with figures.figure(1.35 * rows + 0.5, rows=rows, columns=columns) as drawing:
        for axes, key in zip(drawing.axes, keys, strict=False):
            _draw_panel(axes, key, *panels[key])
        for axes in drawing.axes[len(keys) :]:
            axes.set_visible(False)
        for axes in drawing.axes[max(0, len(keys) - columns) : len(keys)]:
            axes.set_xlabel("time (s)")
        # a trial that was refused at once has a recording without the finger
        told = [axes for axes in drawing.axes if axes.get_legend_handles_labels()[0]]
        for axes in told[:1]:
            axes.legend(loc="upper left", ncols=2)
        svg = Markup(drawing.save("approaches"))
    caption = (
        "Fig. 4d, 6, 7. Envelope of the finger in trials with the pipe, less its mean, from the rest before "
        "the approach on: "
        "in-phase and quadrature. Circles mark our detectors' words, crosses the paper's."
    )
    return [{"svg": svg, "caption": caption}]


def _draw_panel(axes: Any, key: tuple[str, str, str], run: Run, trial: int) -> None:
    stream = str(setting_of(run, "behavior", "finger_stream") or "signals.right")
    series = run.recording(trial).stream(stream)
    if not len(series):
        return
    start_s = float(series.times_s[0])
    thin = max(1, len(series) // 4000)
    envelope = series.values - np.median(series.values[: max(1, len(series) // 20)], axis=0)
    times_s = series.times_s[::thin] - start_s
    for column, name, color in zip(envelope[::thin].T, ("I", "Q"), (OURS, FAINT), strict=False):
        axes.plot(times_s, 1e3 * column, color=color, lw=0.7, label=name, zorder=3 if name == "I" else 2)
    top = 1e3 * float(np.abs(envelope).max())
    for event in run.events:
        if event.get("trial") != trial or event.get("event") not in ("PreTouch", "Contact"):
            continue
        ours = str(event.get("detector", "")).endswith("_ours")
        color = GOOD if event["event"] == "PreTouch" else FALSE
        height = top * (1.05 if ours else 1.25)
        marker = {"marker": "o", "mfc": "none"} if ours else {"marker": "x"}
        axes.plot(float(event["t_s"]) - start_s, height, color=color, ms=4.0, ls="none", zorder=4, **marker)
    axes.set_title(f"{key[0]}, {key[1]} m/s" if key[1] else key[0])
    axes.set_ylabel("$10^{-3}$ FS")
