"""The part of the page on C2, C4 and C5: approaches, touches and nothing at all."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from behaviors.aura import AuraFactors
from controller.measures.aura import METHODS
from controller.recording.reader import Run
from controller.reports.counts import factor_of, percent, rate, total, values
from controller.reports.figures import FAINT, FALSE, GOOD, OURS, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Block, Figure, Kind, Notes, ReportTable, Result, Section
from controller.reports.section_texts import SectionTexts
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
from controller.reports.text import number, quantity, title

SIDES = ("normal", "back", "front", "top", "bottom")
DEAF = "top"
"""The side with which the paper's finger detects nothing (IV.A.3)."""

SOUND_M_S = 343.2
"""Speed of sound in air of 20 °C, where no detector has a setting for it."""

PIPE = "pipe"
"""What C2 and C4 approach; the paper's rates are those of its six objects."""

SOFT = ("sponge", "cloth")
"""Objects that are no paper's: soft ones, counted by themselves."""


TEXTS = SectionTexts("aura")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """What every detector reported in every approach."""
    rows = rows_of(runs)
    there = [row for row in rows if factor(row, "object") != "none"]
    nothing = [row for row in rows if factor(row, "object") == "none"]
    objects = sorted({factor(row, "object") for row in there})
    hard = _hard(there) or there
    touching = rows if setting_of(runs[0], "behavior", "touch") else []
    unknown = [row for row in touching if not _known(row)]
    felt = [row for row in touching if _known(row) and factor(row, "object") != "none"]
    notes = _notes(hard)
    body: list[Block] = [
        TEXTS.text("intro"),
        _sides_table(hard, bool(unknown), _half_wave_m(runs[0])),
        *(_object_tables(there, nothing, objects) if len(objects) > 1 or nothing else ()),
        *([_touch_table(_hard(felt) or felt)] if felt else ()),
        *([_reported_table(unknown)] if unknown else ()),
        *_draw(runs, figures),
        *([Notes(notes)] if notes else ()),
    ]
    return Section(
        title=_title(runs, objects),
        body=body,
        citation=CITATION,
        summary=_summary(hard, nothing, unknown, runs[0].simulated),
        not_the_papers=[*(ASSUMED if runs[0].simulated else ()), *_whence(rows)],
        printed=printed_of(runs[0]),
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
    """Where the truth about object and touch comes from."""
    if not any(row.get("approaches") for row in rows):
        return []
    return [TEXTS.sentence("known" if any(_known(row) for row in rows) else "unknown")]


def factor(row: Mapping[str, Any], name: str) -> str:
    """See `factor_of`; as text."""
    return str(factor_of(row, name, AuraFactors))


def _groups(rows: Sequence[Any], *names: str) -> Mapping[tuple[str, ...], list[Any]]:
    """Trials by the values of some factors, sides in the paper's order, soft objects last."""
    groups: dict[tuple[str, ...], list[Any]] = {}
    for row in rows:
        groups.setdefault(tuple(factor(row, name) for name in names), []).append(row)

    def order(key: tuple[str, ...]) -> tuple[tuple[int, str], ...]:
        return tuple((SIDES.index(part) if part in SIDES else int(part in SOFT), part) for part in key)

    return {key: groups[key] for key in sorted(groups, key=order)}


def _median(rows: Sequence[Any], column: str) -> float | None:
    found = values(rows, column)
    return statistics.median(found) if found else None


# --- tables ------------------------------------------------------------------------------------------


def _half_wave_m(run: Run) -> float:
    """Half a wavelength of the drive: what the envelope undulates by, straight towards the object."""
    drive_hz = float(setting_of(run, "behavior", "drive_hz") or BEST_HZ)
    detectors = (setting_of(run, "detectors") or {}).values()
    sound_m_s = next((table["sound_m_s"] for table in detectors if "sound_m_s" in table), SOUND_M_S)
    return float(sound_m_s) / drive_hz / 2.0


def _sides_table(rows: Sequence[Any], unknown: bool, half_wave_m: float) -> ReportTable:
    body = []
    for (side, axis, speed), members in _groups(rows, "side", "axis", "speed_m_s").items():
        approaches = total(members, "approaches")
        row: dict[str, Any] = {
            "side": side,
            "axis": axis,
            "speed_m_s": float(speed),
            "approaches": approaches,
        }
        row["undulations_per_cm"] = _median(members, "undulations_per_cm")
        for method in METHODS:
            row[f"seen_{method}"] = f"{total(members, f'seen_{method}')} of {approaches}"
            row[f"distance_m_{method}"] = _median(members, f"distance_m_{method}")
        body.append(row)
    all_objects = any(factor(row, "object") != PIPE for row in rows)
    rest = TEXTS.sentence("all_objects") * all_objects + TEXTS.sentence("way_ends") * unknown
    half, expected = quantity("half_wave_m", half_wave_m, 1), number(0.01 / half_wave_m, 2)
    return TEXTS.table("sides", body, half=half, expected=expected, rest=rest)


def _named(there: Sequence[Any], objects: Sequence[str]) -> list[tuple[str, list[Any]]]:
    """Trials by object, soft ones last, then those that are compared with the paper's rates."""
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
    """Trials that are compared with the paper's rates: those of the pipe try sides and axes, soft objects are ours."""
    return [row for row in _hard(there) if factor(row, "object") != PIPE]


def _object_tables(
    there: Sequence[Any], nothing: Sequence[Any], objects: Sequence[str]
) -> Iterator[ReportTable]:
    """Rates of pre-touch by object; of contact where it is known what touched."""
    body: list[dict[str, Any]] = []
    named = _named(there, objects)
    for name, members in named:
        n = total(members, "approaches")
        row = {method: rate(total(members, f"seen_{method}"), n) for method in METHODS}
        body.append({"object": name, "approaches": n, **row})
    if nothing:
        n = total(nothing, "approaches")
        row = {method: rate(n - total(nothing, f"alarms_{method}"), n) for method in METHODS}
        body.append({"object": "nothing: not reported", "approaches": n, **row})
    positive, negative = map(percent, PRE_TOUCH)
    yield TEXTS.table("pre_touch", body, positive=positive, negative=negative)
    if total(there, "touches"):
        groups = [*named, *([("nothing", nothing)] if nothing else [])]
        rows = [{"object": name, **row} for name, members in groups for row in _by_method(members)]
        positive, negative = map(percent, CONTACT)
        yield TEXTS.table("contact", rows, positive=positive, negative=negative)


def _by_method(members: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """Counts of each method over some approaches; each by its column's name without the method's."""
    touches, approaches = total(members, "touches"), total(members, "approaches")
    for method in METHODS:
        false = total(members, f"false_{method}")
        names = (
            "held",
            "ended",
            "reported",
            "reports",
            "reported_held",
            "reported_ended",
            "reported_of_nothing",
        )
        yield {name: total(members, f"{name}_{method}") for name in names} | {
            "detector": METHOD_NAMES[method],
            "touches": touches,
            "approaches": approaches,
            "felt": rate(total(members, f"felt_{method}"), touches),
            "true": rate(approaches - false, approaches),
            "false": f"{false} of {approaches}",
            "delay_s": _median(members, f"delay_s_{method}"),
        }


def _touch_table(rows: Sequence[Any]) -> ReportTable:
    groups = _groups(rows, "side").items()
    return TEXTS.table(
        "touches",
        [{"side": side, **row} for (side,), members in groups for row in _by_method(members)],
        deaf=DEAF,
    )


def _reported_table(rows: Sequence[Any]) -> ReportTable:
    by = "object" if len({factor(row, "object") for row in rows}) > 1 else "side"
    groups = _groups(rows, by).items()
    body = [{"name": title(name), **row} for (name,), members in groups for row in _by_method(members)]
    return TEXTS.table("as_reported", body, by=by)


# --- sentences ---------------------------------------------------------------------------------------


def _summary(
    there: Sequence[Any], nothing: Sequence[Any], unknown: Sequence[Any], simulated: bool
) -> list[Result]:
    # sides, coupling and echo of the simulated finger are such that the paper's figures come out: no prediction
    kind = Kind.ASSUMED if simulated else Kind.MEASURED
    results = [*_of_sides(there, kind), *_of_objects(_papers(there), kind), *_of_touches(there, kind)]
    results = results or list(_of_passages(there))
    for method in METHODS if unknown else ():
        found, n = total(unknown, f"reported_{method}"), total(unknown, "approaches")
        results.append(
            Result(None, TEXTS.sentence("reported_summary", method=METHOD_NAMES[method], found=found, n=n))
        )
    n = total(nothing, "approaches")
    for method in METHODS if n else ():
        alarms, fitted = total(nothing, f"alarms_{method}"), simulated and method == "paper"
        text = TEXTS.sentence(
            "alarms",
            method=METHOD_NAMES[method],
            alarms=alarms,
            n=n,
            rate=rate(alarms, n),
            paper=percent(1.0 - PRE_TOUCH[1]),
            fitted=", to which its threshold was set at 10 and 30 mm/s together" if fitted else "",
        )
        results.append(Result(Kind.FITTED if fitted else None, text))
    return results


def _of_sides(there: Sequence[Any], kind: Kind) -> Iterator[Result]:
    """From which sides an object is seen at all (C2)."""
    sides = _groups(there, "side")
    for method in METHODS if len(sides) > 1 else ():
        blind = [side for (side,), members in sides.items() if not total(members, f"seen_{method}")]
        text = TEXTS.sentence(
            "blind",
            method=METHOD_NAMES[method],
            seen=len(sides) - len(blind),
            sides=len(sides),
            papers=len(SIDES),
            blind=f"; nothing from {', '.join(blind)}" if blind else "",
        )
        yield Result(kind, text, not blind)


def _of_passages(there: Sequence[Any]) -> Iterator[Result]:
    """How often the object was seen, where the paper prints nothing to stand beside it: along y and z."""
    n = total(there, "approaches")
    for method in METHODS if n else ():
        found, left_m = total(there, f"seen_{method}"), _median(there, f"distance_m_{method}")
        far = f"; {quantity('left_m', left_m, 0)} of the way left (median)" if left_m is not None else ""
        text = TEXTS.sentence("passages", method=METHOD_NAMES[method], found=found, n=n, far=far)
        yield Result(None, text)


def _of_objects(rows: Sequence[Any], kind: Kind) -> Iterator[Result]:
    """Rates over objects beside the paper's over its six (C5)."""
    touching = bool(total(rows, "touches"))
    for what, column, of, bound in (
        ("Pre-touch", "seen", "approaches", PRE_TOUCH[0]),
        ("Contact", "felt", "touches", CONTACT[0]),
        *([("No false contact", "false", "approaches", CONTACT[1])] if touching else []),
    ):
        count = total(rows, of)
        for method in METHODS if count else ():
            found = total(rows, f"{column}_{method}")
            found = count - found if column == "false" else found
            off = 100.0 * (found / count - bound)
            facts = {"points": number(abs(off), 1), "beside": "below" if off < 0.0 else "above"}
            facts |= {"what": what, "method": METHOD_NAMES[method], "of": of, "paper": percent(bound)}
            text = TEXTS.sentence("rates", found=found, n=count, rate=rate(found, count), **facts)
            yield _judged(kind, text, off >= 0.0, contact=method if column != "seen" else "")


def _of_touches(there: Sequence[Any], kind: Kind) -> Iterator[Result]:
    """Whether every side but the deaf one detects the pipe each time (C4)."""
    pipe = [row for row in there if factor(row, "object") == PIPE]
    sensing = [row for row in pipe if factor(row, "side") != DEAF]
    deaf = [row for row in pipe if factor(row, "side") == DEAF]
    touches, others = total(sensing, "touches"), total(deaf, "touches")
    for method in METHODS if touches else ():
        felt = total(sensing, f"felt_{method}")
        rest = f", {total(deaf, f'felt_{method}')} of {others} with the {DEAF}" if others else ""
        facts = {"method": METHOD_NAMES[method], "touches": touches, "deaf": DEAF, "others": rest}
        yield _judged(kind, TEXTS.sentence("felt", felt=felt, **facts), felt == touches, contact=method)


def _judged(kind: Kind, text: str, met: bool, contact: str) -> Result:
    """The plant's touch was assumed in favour of the paper's contact: that it comes out shows nothing, that it does not
    is a miss."""
    failed = kind == Kind.ASSUMED and contact == "paper" and not met
    return Result(Kind.PREDICTED if failed else kind, text, met)


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
            shown = ", ".join(f"{number(count, 2)} at {_speed(speed)}" for speed, count in medians.items())
            notes.append(TEXTS.sentence("undulations", side=side, shown=shown))
    return notes


def _speed(speed_m_s: str) -> str:
    return quantity("speed_m_s", float(speed_m_s), 0)


# --- figures -----------------------------------------------------------------------------------------


def _draw(runs: Sequence[Run], figures: Figures) -> list[Figure]:
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
        labelled = [axes for axes in drawing.axes if axes.get_legend_handles_labels()[0]]
        for axes in labelled[:1]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2)
        svg = Markup(drawing.save("approaches"))
    return [Figure(svg, TEXTS.sentence("figure", pretouch="green", contact="orange"))]


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
        axes.plot(times_s, column, color=color, lw=0.7, label=name, zorder=3 if name == "I" else 2)
    top = float(np.abs(envelope).max())
    for event in run.events:
        if event.get("trial") != trial or event.get("event") not in ("PreTouch", "Contact"):
            continue
        ours = str(event.get("detector", "")).endswith("_ours")
        color = GOOD if event["event"] == "PreTouch" else FALSE
        height = top * (1.05 if ours else 1.25)
        marker = {"marker": "o", "mfc": "none"} if ours else {"marker": "x"}
        axes.plot(float(event["t_s"]) - start_s, height, color=color, ms=4.0, ls="none", zorder=4, **marker)
    axes.set_title(f"{key[0]}, {_speed(key[1])}")
    axes.set_ylabel("envelope (FS)")
