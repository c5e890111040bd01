"""The part of the page on C2, C4 and C5: approaches, touches and nothing at all."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from behaviors.aura import AuraFactors
from controller.measures.aura import OURS_AND_PAPERS
from controller.recording.reader import Run
from controller.reports.counts import (
    METHODS,
    Comparison,
    Row,
    all_of,
    decided,
    every,
    grouped,
    median,
    number,
    percent,
    quantity,
    rate,
    rows_of,
    title,
    total,
    under,
    values,
)
from controller.reports.figures import FAINT, FALSE, GOOD, INK, OURS, Figures
from controller.reports.papers import BEST_HZ, CONTACT, PRE_TOUCH
from controller.reports.run_account import setting_of
from controller.reports.section import Headline, Kind, Result, Section, judged, rated

SIDES = ("normal", "back", "front", "top", "bottom")
DEAF = "top"
"""The side with which the paper's finger detects nothing (IV.A.3)."""

SOUND_M_S = 343.2
"""Speed of sound in air of 20 °C, where no detector has a setting for it."""

PIPE = "pipe"
"""What C2 and C4 approach; the paper's rates are those of its six objects."""

SOFT = ("sponge", "cloth")
"""Objects that are no paper's: soft ones, counted by themselves."""

PANELS = 10
"""Most approaches that are drawn."""

Rows = Sequence[Row]


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """What every detector reported in every approach."""
    run, rows = runs[0], rows_of(runs, AuraFactors)
    there = [row for row in rows if row["object"] != "none"]
    nothing = [row for row in rows if row["object"] == "none"]
    objects = {row["object"] for row in there}
    hard = [row for row in there if row["object"] not in SOFT] or there
    touching = rows if setting_of(run, "behavior", "touch") else []
    # what touched when is known where it is simulated in the program's own process
    unknown = [row for row in touching if row.get("touches") is None]
    felt = [row for row in touching if row.get("touches") is not None and row["object"] != "none"]
    felt = [row for row in felt if row["object"] not in SOFT] or felt
    half_wave_m = _half_wave_m(run)
    several = len(objects) > 1 or nothing
    contact = several and total(there, "touches")
    named = _named(there, objects)
    by = "object" if len({row["object"] for row in unknown}) > 1 else "side"
    what = "Contact (C4)" if setting_of(run, "behavior", "touch") else "Pre-touch (C2)"
    return Section(
        title="Objects (C5)" if len(objects) > 1 else what,
        content={
            "approached": any(row.get("approaches") for row in rows),
            "known": any(row.get("touches") is not None for row in rows),
            "sides": list(_sides(hard)),
            "half": quantity("half_wave_m", half_wave_m, 1),
            "expected": number(0.01 / half_wave_m, 2),
            "all_objects": any(row["object"] != PIPE for row in hard),
            "way_ends": bool(unknown),
            "pre_touch": list(_pre_touch(named, nothing)) if several else [],
            "contact": _of_each(named | {"nothing": nothing}, "object", _contact) if contact else [],
            "touches": list(_touches(felt)),
            "by": by,
            "reported": _of_each(_by(unknown, by), by, _reported),
            "papers": {"pre_touch": [*map(percent, PRE_TOUCH)], "contact": [*map(percent, CONTACT)]},
            "deaf": DEAF,
            "figure": _draw(runs, figures),
            "undulations": list(_undulations(hard)),
        },
        template="aura",
        paper="rupavatharam",
        summary=_summary(hard, nothing, unknown, run.simulated),
        headline=_headline(_papers(there) or there, bool(setting_of(run, "behavior", "touch"))),
    )


def _headline(there: Rows, touching: bool) -> Headline | None:
    """What our detector tells, beside the paper's on the same samples; of trials along x, as printed; None where ours
    was not armed, or nothing is known of touches."""
    own = [row for row in there if row.get("axis", "x") == "x"] or there
    column, of, what = (
        ("felt", "touches", "touches detected")
        if touching
        else ("seen", "approaches", "objects seen in time")
    )
    printed = f"IV.B.3 prints {percent(CONTACT[0])}" if touching else f"IV.B.1 prints {percent(PRE_TOUCH[0])}"
    if touching and {row["object"] for row in own} == {PIPE}:  # of which the paper tells all but one side's
        own = [row for row in own if row["side"] != DEAF] or own
        what, printed = f"{what} with the sides other than the {DEAF}", "IV.A.3 prints all"
    n, (ours, theirs) = total(own, of), ([values(own, f"{column}_{method}") for method in ("ours", "paper")])
    if not n or not ours:
        return None
    paper = sum(theirs) / n if theirs else None
    source = f"the paper's detector (same samples; {printed})" if theirs else ""
    found = rated(f"{what} by our detector", int(sum(ours)), n, paper, source, column=f"{column}_ours")
    return found._replace(rows=f"{column}_ours>-1e300")


def _by(rows: Rows, *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Trials by some factors: sides in the paper's order, soft objects last."""

    def order(cell: Any) -> tuple[int, str]:
        return SIDES.index(cell) if cell in SIDES else int(cell in SOFT), str(cell)

    return grouped(rows, *names, order=order)


def _half_wave_m(run: Run) -> float:
    """Half a wavelength of the drive: what the envelope undulates by, straight towards the object."""
    drive_hz = float(setting_of(run, "behavior", "drive_hz") or BEST_HZ)
    detectors = (setting_of(run, "detectors") or {}).values()
    sound_m_s = next((table["sound_m_s"] for table in detectors if "sound_m_s" in table), SOUND_M_S)
    return float(sound_m_s) / drive_hz / 2.0


# --- tables ------------------------------------------------------------------------------------------


def _sides(rows: Rows) -> Iterator[Row]:
    for (side, axis, speed_m_s), own in _by(rows, "side", "axis", "speed_m_s").items():
        n = total(own, "approaches")
        line = {"side": side, "axis": axis, **under("speed_m_s", speed_m_s), "approaches": n}
        line |= under("undulations", median(own, "undulations_per_cm"), "undulations/cm", 2)
        for method, whose in METHODS.items():
            line[f"seen, {whose}"] = f"{total(own, f'seen_{method}')} of {n}"
            line |= under("distance_m", median(own, f"distance_m_{method}"), f"from, {whose}", 0)
        yield line


def _named(there: Rows, objects: set[str]) -> dict[str, Rows]:
    """Trials by object, soft ones last, then those that are compared with the paper's rates."""
    named: dict[str, Rows] = {
        title(name) + " (soft)" * (name in SOFT): own for (name,), own in _by(there, "object").items()
    }
    others = ["the soft ones"] * bool(objects & set(SOFT)) + ["the pipe"] * (PIPE in objects)
    counted = _papers(there)
    return named | ({f"all but {' and '.join(others)}" if others else "all": counted} if counted else {})


def _papers(there: Rows) -> list[Row]:
    """Trials that are compared with the paper's rates: those of the pipe try sides and axes, soft objects are ours."""
    return [row for row in there if row["object"] not in (*SOFT, PIPE)]


def _pre_touch(named: Mapping[str, Rows], nothing: Rows) -> Iterator[Row]:
    for name, own in named.items():
        n = total(own, "approaches")
        rates = {whose: rate(total(own, f"seen_{method}"), n) for method, whose in METHODS.items()}
        yield {"object": name, "approaches": n, **rates}
    if nothing:
        n = total(nothing, "approaches")
        rates = {whose: rate(n - total(nothing, f"alarms_{method}"), n) for method, whose in METHODS.items()}
        yield {"object": "nothing: not reported", "approaches": n, **rates}


def _counts(own: Rows) -> Iterator[tuple[str, dict[str, int], float | None]]:
    """Of each detector: whose it is, sums of its columns over some trials, and its median delay."""
    for method, whose in METHODS.items():
        sums = {name: total(own, f"{name}_{method}") for name in OURS_AND_PAPERS}
        sums |= {name: total(own, name) for name in ("touches", "approaches")}
        yield whose, sums, median(own, f"delay_s_{method}")


def _of_each(groups: Mapping[Any, Rows], head: str, cells: Callable[[dict[str, int]], Row]) -> list[Row]:
    """A line for each group of trials and detector, with the cells that are made of its counts."""
    return [
        {head: name if isinstance(name, str) else title(name[0]), "detector": whose, **cells(n)}
        for name, own in groups.items()
        for whose, n, _ in (_counts(own) if own else ())
    ]


def _contact(n: dict[str, int]) -> Row:
    return {
        "touches": n["touches"],
        "detected": rate(n["felt"], n["touches"]),
        "approaches": n["approaches"],
        "without a false one": rate(n["approaches"] - n["false"], n["approaches"]),
    }


def _touches(rows: Rows) -> Iterator[Row]:
    for (side,), own in _by(rows, "side").items():
        for whose, n, delay_s in _counts(own):
            yield {
                "side": side,
                "detector": whose,
                "touches": n["touches"],
                "detected": rate(n["felt"], n["touches"]),
                **under("delay_s", delay_s, digits=OURS_AND_PAPERS["delay_s"].digits),
                "persistence": n["held"],
                "end": n["ended"],
                "false": f"{n['false']} of {n['approaches']}",
            }


def _reported(n: dict[str, int]) -> Row:
    return {
        "approaches": n["approaches"],
        "reported": n["reported"],
        "times": n["reports"],
        "persistence": n["reported_held"],
        "end": n["reported_ended"],
        "where nothing can": n["reported_of_nothing"],
    }


def _undulations(rows: Rows) -> Iterator[str]:
    for (side,), own in _by([row for row in rows if row["axis"] == "x"], "side").items():
        medians = {
            speed_m_s: count
            for (speed_m_s,), each in _by(own, "speed_m_s").items()
            if (count := median(each, "undulations_per_cm")) is not None
        }
        if len(medians) > 1:
            shown = (f"{number(n, 2)} at {quantity('speed_m_s', at, 0)}" for at, n in medians.items())
            yield f"Undulations per cm of the {side} side: {', '.join(shown)}."


# --- sentences ---------------------------------------------------------------------------------------


def _summary(there: Rows, nothing: Rows, unknown: Rows, simulated: bool) -> list[Result]:
    # sides, coupling and echo of the simulated finger are such that the paper's figures come out: no prediction
    kind = Kind.ASSUMED if simulated else Kind.MEASURED
    results = [*_of_sides(there, kind), *_of_objects(_papers(there), kind), *_of_touches(there, kind)]
    results = results or list(_of_passages(there))
    for whose, n, _ in _counts(unknown) if unknown else ():
        text = f"Contact, {whose}: reported in {n['reported']} of {n['approaches']} approaches; "
        results.append(Result(None, f"{text}what touched is not known on this bench."))
    for whose, n, _ in _counts(nothing) if total(nothing, "approaches") else ():
        fitted = simulated and whose == METHODS["paper"]
        text = f"Pre-touch, {whose}: {n['alarms']} alarms in {n['approaches']} approaches to nothing, "
        text += f"{rate(n['alarms'], n['approaches'])}; the paper {percent(1.0 - PRE_TOUCH[1])}"
        text += ", to which its threshold was set at 10 and 30 mm/s together." if fitted else "."
        results.append(Result(Kind.FITTED if fitted else None, text))
    return results


def _of_sides(there: Rows, kind: Kind) -> Iterator[Result]:
    """From which sides an object is seen at all (C2)."""
    sides = _by(there, "side")
    for method, whose in METHODS.items() if len(sides) > 1 else ():
        seen = {
            side: (total(own, f"seen_{method}"), total(own, "approaches")) for (side,), own in sides.items()
        }
        blind = [side for side, (hits, _) in seen.items() if not hits]
        text = f"Pre-touch, {whose}: sees from {len(sides) - len(blind)} of {len(sides)} sides; the paper from all "
        text += f"{len(SIDES)}{'; nothing from ' * bool(blind)}{', '.join(blind)}"
        # a side that sees nothing alarms as seldom as one before nothing does
        met = all_of(decided(hits, n, 1.0 - PRE_TOUCH[1]) for hits, n in seen.values())
        yield judged(kind, text, met, min(n for _, n in seen.values()), method == "ours", better=False)


def _of_passages(there: Rows) -> Iterator[Result]:
    """How often the object was seen, where the paper prints nothing to stand beside it: along y and z."""
    n = total(there, "approaches")
    for method, whose in METHODS.items() if n else ():
        left_m = median(there, f"distance_m_{method}")
        far = f"; {quantity('left_m', left_m, 0)} of the way left (median)" if left_m is not None else ""
        text = f"Pre-touch, {whose}: the object is seen in {total(there, f'seen_{method}')} of {n} approaches{far}; "
        yield Result(None, f"{text}the paper prints no rate for this axis.")


def _of_objects(rows: Rows, kind: Kind) -> Iterator[Result]:
    """Rates over objects beside the paper's over its six (C5)."""
    for what, column, of, paper in (
        ("Pre-touch", "seen", "approaches", PRE_TOUCH[0]),
        ("Contact", "felt", "touches", CONTACT[0]),
        *([("No false contact", "false", "approaches", CONTACT[1])] if total(rows, "touches") else []),
    ):
        for whose, n, _ in _counts(rows) if total(rows, of) else ():
            hits = n[of] - n[column] if column == "false" else n[column]
            beside = Comparison(hits / n[of], paper)
            points = number(100.0 * abs(beside.ours - paper), 1)
            text = f"{what}, {whose}: {points} points {beside.side} the paper's {percent(paper)} of its own objects: "
            text += f"{hits} of {n[of]} {of}, {rate(hits, n[of])}"
            met = decided(hits, n[of], paper)
            yield _judged(kind, text, met, n[of], column, whose == METHODS["paper"])


def _of_touches(there: Rows, kind: Kind) -> Iterator[Result]:
    """Whether every side but the deaf one detects the pipe each time (C4)."""
    pipe = [row for row in there if row["object"] == PIPE]
    sensing = [row for row in pipe if row["side"] != DEAF]
    deaf = [row for row in pipe if row["side"] == DEAF]
    touches, others = total(sensing, "touches"), total(deaf, "touches")
    for method, whose in METHODS.items() if touches else ():
        felt = total(sensing, f"felt_{method}")
        text = f"Contact, {whose}: {felt} of {touches} touches detected with the other sides than the {DEAF}"
        text += f", {total(deaf, f'felt_{method}')} of {others} with the {DEAF}" if others else ""
        text += "; the paper detected all of the former"
        yield _judged(kind, text, every(touches - felt, touches), touches, "felt", method == "paper")


def _judged(kind: Kind, text: str, met: bool | None, n: int, column: str, papers: bool) -> Result:
    """What the paper's detector does here is as printed or not, which is no goal. The plant's touch was assumed in
    favour of its contact: that it comes out shows nothing, that it does not is told."""
    kind = Kind.PREDICTED if kind == Kind.ASSUMED and papers and column != "seen" and met is False else kind
    return judged(kind, text, met, n, goal=not papers, better=False)


# --- figure ------------------------------------------------------------------------------------------


def _draw(runs: Sequence[Run], figures: Figures) -> str:
    """The envelope along the approach: one panel for each side and speed of which there is a recording."""
    panels: dict[tuple[int, float], tuple[Run, int]] = {}
    for run in runs:
        for row in rows_of([run], AuraFactors):
            if row["object"] == PIPE and row["axis"] == "x" and int(row["trial"] or 0) in run.recorded_trials:
                key = SIDES.index(row["side"]), float(row["speed_m_s"])
                panels.setdefault(key, (run, int(row["trial"])))
    if not panels:
        return ""
    keys = sorted(panels)[:PANELS]
    with figures.panels(len(keys), 2 if len(keys) > 1 else 1, 1.35) as drawing:
        for axes, key in zip(drawing.axes, keys, strict=True):
            _draw_panel(axes, f"{SIDES[key[0]]}, {quantity('speed_m_s', key[1], 0)}", *panels[key])
        drawing.label_outside("time (s)", "envelope (FS)")
        # a trial that was refused at once has a recording without the finger
        for axes in [axes for axes in drawing.axes if axes.get_legend_handles_labels()[0]][:1]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2)
        for axes in drawing.axes[1:2]:
            for mark, whose in (("o", "ours"), ("x", "the paper's")):
                axes.plot([], [], mark, mfc="none", color=INK, ms=4.0, label=whose)
            narrow: Any = {"handlelength": 0.8, "columnspacing": 0.8, "handletextpad": 0.4}
            handles = axes.get_lines()[-2:]
            axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2, **narrow)
        return drawing.save("approaches")


def _draw_panel(axes: Any, name: str, run: Run, trial: int) -> None:
    stream = str(setting_of(run, "behavior", "finger_stream") or "signals.right")
    recording = run.readable(trial)
    if recording is None or not len(series := recording.stream(stream)):
        return
    start_s = float(series.times_s[0])
    thin = max(1, len(series) // 4000)
    envelope = series.values - np.median(series.values[: max(1, len(series) // 20)], axis=0)
    for column, part, color in zip(envelope[::thin].T, ("I", "Q"), (OURS, FAINT), strict=False):
        over = 3 if part == "I" else 2
        axes.plot(series.times_s[::thin] - start_s, column, color=color, lw=0.7, label=part, zorder=over)
    top = float(np.abs(envelope).max())
    for event in run.events_of(trial):
        if event["event"] in ("PreTouch", "Contact"):
            ours = str(event.get("detector", "")).endswith("_ours")
            look: Mapping[str, Any] = {"marker": "o", "mfc": "none"} if ours else {"marker": "x"}
            color = GOOD if event["event"] == "PreTouch" else FALSE
            at_s, height = float(event["t_s"]) - start_s, top * (1.05 if ours else 1.25)
            axes.plot(at_s, height, color=color, ms=4.0, ls="none", zorder=4, **look)
    axes.set_title(name)
