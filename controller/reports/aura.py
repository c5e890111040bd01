"""The part of the page on C2, C4 and C5: approaches, touches and nothing at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from behaviors.aura import AuraFactors
from controller.measures.aura import METHODS
from controller.recording.reader import Run
from controller.reports.counts import percent, rate, total, values
from controller.reports.figures import FAINT, FALSE, GOOD, OURS, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Kind, Result, Section
from controller.reports.sonicfinger import (
    ASSUMED,
    BEST_HZ,
    CITATION,
    CONTACT,
    METHOD_NAMES,
    PRE_TOUCH,
    printed_of,
    rows_of,
)
from controller.reports.text import number, title

SIDES = ("normal", "back", "front", "top", "bottom")
DEAF = "top"
"""The side with which the paper's finger feels nothing (IV.A.3)."""

SOUND_M_S = 343.2
"""Speed of sound in air of 20 °C, where no detector says what it takes it to be."""

PIPE = "pipe"
"""What C2 and C4 approach; the paper's rates are those of its six objects."""

SOFT = ("sponge", "cloth")
"""Objects that are no paper's: soft ones, counted by themselves."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Everything that was said of every approach."""
    rows = rows_of(runs)
    there = [row for row in rows if factor(row, "object") != "none"]
    nothing = [row for row in rows if factor(row, "object") == "none"]
    objects = sorted({factor(row, "object") for row in there})
    hard = _hard(there) or there
    touching = rows if setting_of(runs[0], "behavior", "touch") else []
    told = [row for row in touching if not _known(row)]
    tables = [_sides_table(hard, bool(told), _half_wave_m(runs[0]))]
    if len(objects) > 1 or nothing:
        tables += [_pre_touch_table(there, nothing, objects), *_contact_table(there, nothing, objects)]
    felt = [row for row in touching if _known(row) and factor(row, "object") != "none"]
    if felt:
        tables += [_touch_table(_hard(felt) or felt)]
    if told:
        tables += [_said_table(told)]
    return Section(
        title=_title(runs, objects),
        template="plain.html.j2",
        citation=CITATION,
        summary=_summary(hard, nothing, told, runs[0].simulated),
        not_the_papers=[*(ASSUMED if runs[0].simulated else ()), *_whence(rows)],
        printed=printed_of(runs[0]),
        context={
            "paragraphs": [
                "One finger approaches an object with one of its sides, stays at the end of its way or "
                "touches, and comes back. "
                "Both methods hear the same samples."
            ],
            "tables": tables,
            "figures": _draw(runs, figures),
            "notes": _notes(hard),
        },
    )


def _title(runs: Sequence[Run], objects: Sequence[str]) -> str:
    if len(objects) > 1:
        return "Objects (C5)"
    return "Contact (C4)" if setting_of(runs[0], "behavior", "touch") else "Pre-touch (C2)"


def _hard(rows: Sequence[Any]) -> list[Any]:
    return [row for row in rows if factor(row, "object") not in SOFT]


def _known(row: Mapping[str, Any]) -> bool:
    """Whether it is known what touched when: where that is simulated in the program's own process."""
    return row.get("touches") is not None


def _whence(rows: Sequence[Any]) -> list[str]:
    """How it is known what stood there and what touched."""
    if not any(row.get("approaches") for row in rows):
        return []
    if any(_known(row) for row in rows):
        return [
            "“Object”, “nothing” and what touched when are known because they are simulated: no detector is told."
        ]
    return [
        "“Object” and “nothing” are what the trials say; what touched when is not known on this bench, so "
        "contact is reported as it was said."
    ]


def factor(row: Mapping[str, Any], name: str) -> str:
    """A trial's factor as a word; the behavior's default where the trials do not vary it."""
    value = row.get(name)
    return str(AuraFactors.model_fields[name].default if value is None else value)


def _groups(rows: Sequence[Any], *names: str) -> Mapping[tuple[str, ...], list[Any]]:
    """Trials by the values of some factors, sides in the paper's order, soft objects last."""
    groups: dict[tuple[str, ...], list[Any]] = {}
    for row in rows:
        groups.setdefault(tuple(factor(row, name) for name in names), []).append(row)

    def order(key: tuple[str, ...]) -> tuple[tuple[int, str], ...]:
        return tuple((SIDES.index(part) if part in SIDES else int(part in SOFT), part) for part in key)

    return {key: groups[key] for key in sorted(groups, key=order)}


def _median(numbers: Sequence[float], digits: int, scale: float = 1.0) -> str:
    return number(float(np.median(numbers)) if numbers else None, digits, scale)


# --- tables ------------------------------------------------------------------------------------------


def _half_wave_m(run: Run) -> float:
    """Half a wavelength of the drive: what the envelope undulates by, straight towards the object."""
    drive_hz = float(setting_of(run, "behavior", "drive_hz") or BEST_HZ)
    detectors = (setting_of(run, "detectors") or {}).values()
    sound_m_s = next((table["sound_m_s"] for table in detectors if "sound_m_s" in table), SOUND_M_S)
    return float(sound_m_s) / drive_hz / 2.0


def _sides_table(rows: Sequence[Any], told: bool, half_wave_m: float) -> Mapping[str, Any]:
    body = []
    for (side, axis, speed), members in _groups(rows, "side", "axis", "speed_m_s").items():
        approaches = total(members, "approaches")
        cells = [side, axis, speed, str(approaches)]
        cells.append(_median(values(members, "undulations_per_cm"), 2))
        for method in METHODS:
            cells.append(f"{total(members, f'seen_{method}')} of {approaches}")
            cells.append(_median(values(members, f"distance_m_{method}"), 1, 100.0))
        body.append(cells)
    caption = (
        "Pre-touch by side, axis and speed. Undulations are those of the whole approach, per cm of way; "
        f"half a wave is {number(half_wave_m, 2, 100.0)} cm, so {number(0.01 / half_wave_m, 2)} are expected where the "
        "finger goes straight at the object. “From” is "
        "the way left to go (median): along x the distance to the object."
    )
    if any(factor(row, "object") != PIPE for row in rows):
        caption += " All objects together, but for the soft ones."
    if told:
        caption += (
            " Where what touched is not known, the way ends where the arm was told to stop, and what was said "
            "until then counts as seen."
        )
    return {
        "caption": caption,
        "head": ["side", "axis", "speed, m/s", "approaches", "undulations/cm"]
        + [f"{what}, {METHOD_NAMES[method]}" for method in METHODS for what in ("seen", "from, cm")],
        "rows": body,
        "left": 2,
    }


def _named(there: Sequence[Any], objects: Sequence[str]) -> list[tuple[str, list[Any]]]:
    """Trials by object, soft ones last, then those to which the paper's rates are held."""
    named = [
        (title(name) + (" (soft)" if name in SOFT else ""), members)
        for (name,), members in _groups(there, "object").items()
    ]
    others = [
        *(["the soft ones"] if set(objects) & set(SOFT) else []),
        *(["the pipe"] if PIPE in objects else []),
    ]
    counted = _papers(there)
    return [*named, (f"all but {' and '.join(others)}" if others else "all", counted)] if counted else named


def _papers(there: Sequence[Any]) -> list[Any]:
    """Trials that are held against the paper's rates: those of the pipe try sides and axes, soft objects are ours."""
    return [row for row in _hard(there) if factor(row, "object") != PIPE]


def _pre_touch_table(
    there: Sequence[Any], nothing: Sequence[Any], objects: Sequence[str]
) -> Mapping[str, Any]:
    body = []
    for name, members in _named(there, objects):
        approaches = total(members, "approaches")
        seen = [rate(total(members, f"seen_{method}"), approaches) for method in METHODS]
        body.append([name, str(approaches), *seen])
    if nothing:
        empty = total(nothing, "approaches")
        quiet = [rate(empty - total(nothing, f"alarms_{method}"), empty) for method in METHODS]
        body.append(["nothing: not said", str(empty), *quiet])
    return {
        "caption": "Pre-touch: in how many approaches to an object it was said in time (true positives), and in how "
        "many to nothing it was not said (true negatives), with 95 % intervals (Wilson). The paper: "
        f"{percent(PRE_TOUCH[0])} and {percent(PRE_TOUCH[1])}.",
        "head": ["object", "approaches", *(METHOD_NAMES[method] for method in METHODS)],
        "rows": body,
        "left": 1,
    }


def _contact_table(
    there: Sequence[Any], nothing: Sequence[Any], objects: Sequence[str]
) -> list[Mapping[str, Any]]:
    """Rates of contact by object, where it is known what touched."""
    if not total(there, "touches"):
        return []
    body = []
    for name, members in [*_named(there, objects), *([("nothing", nothing)] if nothing else [])]:
        touches, approaches = total(members, "touches"), total(members, "approaches")
        for method in METHODS:
            felt = rate(total(members, f"felt_{method}"), touches)
            true = rate(approaches - total(members, f"false_{method}"), approaches)
            body.append([name, METHOD_NAMES[method], str(touches), felt, str(approaches), true])
    return [
        {
            "caption": "Contact: touches that were felt (true positives), and approaches in which no contact was said "
            "that was none (true negatives), with 95 % intervals (Wilson). The paper: "
            f"{percent(CONTACT[0])} and {percent(CONTACT[1])}.",
            "head": ["object", "detector", "touches", "felt", "approaches", "without a false one"],
            "rows": body,
            "left": 2,
        }
    ]


def _touch_table(rows: Sequence[Any]) -> Mapping[str, Any]:
    body = []
    for (side,), members in _groups(rows, "side").items():
        touches, approaches = total(members, "touches"), total(members, "approaches")
        for method in METHODS:
            body.append(
                [
                    side,
                    METHOD_NAMES[method],
                    str(touches),
                    rate(total(members, f"felt_{method}"), touches),
                    _median(values(members, f"delay_s_{method}"), 0, 1e3),
                    str(total(members, f"held_{method}")),
                    str(total(members, f"ended_{method}")),
                    f"{total(members, f'false_{method}')} of {approaches}",
                ]
            )
    return {
        "caption": "Contact by side: touches that were felt, with 95 % intervals (Wilson); median delay; of how "
        "many persistence and end were told; and in how many approaches contact was said that was none. "
        f"The paper: all felt, but for the {DEAF}.",
        "head": ["side", "detector", "touches", "felt", "delay, ms", "persistence", "end", "false"],
        "rows": body,
        "left": 2,
    }


def _said_table(rows: Sequence[Any]) -> Mapping[str, Any]:
    by = "object" if len({factor(row, "object") for row in rows}) > 1 else "side"
    body = []
    for (name,), members in _groups(rows, by).items():
        for method in METHODS:
            counts = [
                total(members, f"{what}_{method}")
                for what in ("said", "words", "said_held", "said_ended", "said_of_nothing")
            ]
            approaches = str(total(members, "approaches"))
            body.append([title(name), METHOD_NAMES[method], approaches, *map(str, counts)])
    return {
        "caption": f"Contact by {by} as it was said. What touched when is not known on this bench, so nothing here is "
        "called true or false: in how many approaches contact was said, and how often in all of them; in how many its "
        "persistence and its end were said after that; and in how many contact was said where nothing can touch, in "
        "the rest before or before nothing.",
        "head": [by, "detector", "approaches", "said", "times", "persistence", "end", "where nothing can"],
        "rows": body,
        "left": 2,
    }


# --- sentences ---------------------------------------------------------------------------------------


def _summary(
    there: Sequence[Any], nothing: Sequence[Any], told: Sequence[Any], simulated: bool
) -> list[Result]:
    # sides, coupling and echo of the simulated finger are such that the paper's figures come out: no prediction
    kind = Kind.ASSUMED if simulated else Kind.MEASURED
    said = [*_of_sides(there, kind), *_of_objects(_papers(there), kind), *_of_touches(there, kind)]
    for method in METHODS if told else ():
        found, approaches = total(told, f"said_{method}"), total(told, "approaches")
        said.append(
            Result(
                None,
                f"Contact, {METHOD_NAMES[method]}: said in {found} of {approaches} approaches; what touched "
                "is not known on this bench.",
            )
        )
    for method in METHODS if nothing else ():
        alarms, empty = total(nothing, f"alarms_{method}"), total(nothing, "approaches")
        words = f"{alarms} alarms in {empty} approaches to nothing"
        said.append(
            Result(
                Kind.FITTED if simulated and method == "paper" else None,
                f"Pre-touch, {METHOD_NAMES[method]}: {words}; the paper {percent(1.0 - PRE_TOUCH[1])}"
                + (", at which its threshold was set." if simulated and method == "paper" else "."),
            )
        )
    return said


def _of_sides(there: Sequence[Any], kind: Kind) -> list[Result]:
    """From which sides an object is seen at all (C2)."""
    sides = _groups(there, "side")
    said = []
    for method in METHODS if len(sides) > 1 else ():
        blind = [side for (side,), members in sides.items() if not total(members, f"seen_{method}")]
        words = f"sees from {len(sides) - len(blind)} of {len(sides)} sides; the paper from all {len(SIDES)}"
        if blind:
            words += f"; nothing from {', '.join(blind)}"
        said.append(Result(kind, f"Pre-touch, {METHOD_NAMES[method]}: {words}.", not blind))
    return said


def _of_objects(rows: Sequence[Any], kind: Kind) -> list[Result]:
    """Rates over objects beside the paper's over its six (C5)."""
    said = []
    for what, hits, of, bound in (
        ("Pre-touch", "seen", "approaches", PRE_TOUCH[0]),
        ("Contact", "felt", "touches", CONTACT[0]),
    ):
        count = total(rows, of)
        for method in METHODS if count else ():
            found = total(rows, f"{hits}_{method}")
            off = 100.0 * (found / count - bound)
            words = f"{number(abs(off), 1)} points {'below' if off < 0.0 else 'above'} the paper's {percent(bound)}"
            words += f" of its own objects: {found} of {count} {of}, {rate(found, count)}"
            said.append(Result(kind, f"{what}, {METHOD_NAMES[method]}: {words}.", off >= 0.0))
    return said


def _of_touches(there: Sequence[Any], kind: Kind) -> list[Result]:
    """Whether every side but the deaf one feels the pipe each time (C4)."""
    pipe = [row for row in there if factor(row, "object") == PIPE]
    hearing = [row for row in pipe if factor(row, "side") != DEAF]
    deaf = [row for row in pipe if factor(row, "side") == DEAF]
    touches, others = total(hearing, "touches"), total(deaf, "touches")
    said = []
    for method in METHODS if touches else ():
        felt = total(hearing, f"felt_{method}")
        words = f"{felt} of {touches} touches felt with the other sides than the {DEAF}"
        if others:
            words += f", {total(deaf, f'felt_{method}')} of {others} with the {DEAF}"
        words = f"Contact, {METHOD_NAMES[method]}: {words}; the paper felt all of the former."
        said.append(Result(kind, words, felt == touches))
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


# --- figures -----------------------------------------------------------------------------------------


def _draw(runs: Sequence[Run], figures: Figures) -> list[Mapping[str, Any]]:
    """The envelope along the approach: one panel for each side and speed of which there is a recording."""
    panels: dict[tuple[str, str], tuple[Run, int]] = {}
    for run in runs:
        recorded = set(run.recorded_trials)
        for row in run.trials:
            trial = int(row["trial"] or 0)
            if factor(row, "object") == PIPE and factor(row, "axis") == "x" and trial in recorded:
                key = (factor(row, "side"), factor(row, "speed_m_s"))
                panels.setdefault(key, (run, trial))
    keys = sorted(panels, key=lambda key: (SIDES.index(key[0]), float(key[1])))[:10]
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
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2)
        svg = Markup(drawing.save("approaches"))
    caption = (
        "Fig. 4d, 6, 7. Envelope of the finger in trials with the pipe, less what it is at rest, from the rest "
        "before the approach on: in-phase and quadrature. Circles mark our detectors' words, crosses the paper's; "
        "green is pre-touch, orange contact."
    )
    return [{"svg": svg, "caption": caption}]


def _draw_panel(axes: Any, key: tuple[str, str], run: Run, trial: int) -> None:
    stream = str(setting_of(run, "behavior", "finger_stream") or "signals.right")
    recording = run.readable(trial)
    if recording is None or not len(series := recording.stream(stream)):
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
    axes.set_title(f"{key[0]}, {key[1]} m/s")
    axes.set_ylabel("$10^{-3}$ FS")
