"""The part of the page on C2, C4 and C5: approaches, touches and nothing at all."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from behaviors.aura import AuraFactors
from controller.measures.aura import OURS_AND_PAPERS
from controller.recording.reader import Run
from controller.reports.counts import (
    METHODS,
    Comparison,
    Row,
    Trials,
    all_of,
    decided,
    every,
    paired,
    percent,
    quantity,
    rate,
    title,
    under,
)
from controller.reports.figures import FAINT, FALSE, GOOD, INK, OURS, Figures
from controller.reports.papers import BEST_HZ, CONTACT, PRE_TOUCH
from controller.reports.run_account import setting_of
from controller.reports.section import Headline, Kind, Section, kind_of, rated, told

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


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """What every detector reported in every approach."""
    run, rows = runs[0], Trials.of(runs, AuraFactors)
    touch = bool(setting_of(run, "behavior", "touch"))
    nothing, there = rows.where(object="none"), rows.where(lambda row: row["object"] != "none")
    objects = {row["object"] for row in there}
    # those that are compared with the paper's rates: those of the pipe try sides and axes, soft objects are ours
    papers = there.where(lambda row: row["object"] not in (*SOFT, PIPE))
    hard = _hard(there)
    several = len(objects) > 1 or nothing
    named = {title(name) + " (soft)" * (name in SOFT): own for (name,), own in _by(there, "object").items()}
    if papers:
        others = ["the soft ones"] * bool(objects & set(SOFT)) + ["the pipe"] * (PIPE in objects)
        named[f"all but {' and '.join(others)}" if others else "all"] = papers
    named |= {"nothing": nothing} if nothing else {}
    what = "Contact (C4)" if touch else "Pre-touch (C2)"
    # half a wavelength of the drive: what the envelope undulates by, straight towards the object
    detectors = (setting_of(run, "detectors") or {}).values()
    sound_m_s = next((table["sound_m_s"] for table in detectors if "sound_m_s" in table), SOUND_M_S)
    # sides, coupling and echo of the simulated finger are such that the paper's figures come out: no prediction
    kind = kind_of(runs, Kind.ASSUMED)
    content = {
        "kind": kind,
        "of_sides": list(_of_sides(hard)),
        "of_objects": list(_of_objects(papers, kind)),
        "of_touches": list(_of_touches(hard, kind)),
        "hard": hard,
        "unknown": touch and bool(rows.where(touches=None)),
        "nothing": list(_counts(nothing)) if nothing.total("approaches") else [],
        "methods": METHODS,
        "approached": any(row.get("approaches") for row in rows),
        "known": any(row.get("touches") is not None for row in rows),
        "by_object": list(_counted((({"object": name}, own) for name, own in named.items()), touch))
        if several
        else [],
        "by_side": list(_counted(_sides(hard), touch)),
        "half_wave_m": float(sound_m_s) / float(setting_of(run, "behavior", "drive_hz") or BEST_HZ) / 2.0,
        "all_objects": any(row["object"] != PIPE for row in hard),
        "papers": {"pre_touch": PRE_TOUCH, "contact": CONTACT},
        "n_sides": len(SIDES),
        "deaf": DEAF,
        "figure": _draw(runs, figures),
    }
    heading, headline = "Objects (C5)" if len(objects) > 1 else what, _headline(papers or there, touch)
    return told(runs, heading, "aura", content, paper="rupavatharam", headline=headline)


def _headline(there: Trials, touching: bool) -> Headline | None:
    """What our detector tells, beside the paper's on the same samples; of trials along x, as printed; None where ours
    was not armed, or nothing is known of touches."""
    own = there.where(lambda row: row.get("axis", "x") == "x") or there
    column, of, what = (
        ("felt", "touches", "touches detected")
        if touching
        else ("seen", "approaches", "objects seen in time")
    )
    printed = f"IV.B.3 prints {percent(CONTACT[0])}" if touching else f"IV.B.1 prints {percent(PRE_TOUCH[0])}"
    if touching and {row["object"] for row in own} == {PIPE}:  # of which the paper tells all but one side's
        own = own.where(lambda row: row["side"] != DEAF) or own
        what, printed = f"{what} with the sides other than the {DEAF}", "IV.A.3 prints all"
    own = own.known(f"{column}_ours")
    both, n = own.known(f"{column}_paper"), own.total(of)
    if not n:
        return None
    beside = both.total(of)
    paper = both.total(f"{column}_paper") / beside if beside else None
    source = f"the paper's detector (same samples; {printed})" if beside else ""
    found = rated(
        f"{what} by our detector",
        own.total(f"{column}_ours"),
        n,
        paper,
        source,
        column=f"{column}_ours",
        above=paired((row[f"{column}_ours"], row[f"{column}_paper"]) for row in both),
    )
    return found._replace(rows=f"{column}_ours>-1e300")


def _hard(rows: Trials) -> Trials:
    return rows.where(lambda row: row["object"] not in SOFT) or rows


def _by(rows: Trials, *names: str) -> dict[tuple[Any, ...], Trials]:
    """Trials by some factors: sides in the paper's order, soft objects last."""
    return rows.by(
        *names, order=lambda cell: (SIDES.index(cell) if cell in SIDES else int(cell in SOFT), str(cell))
    )


# --- tables ------------------------------------------------------------------------------------------


def _sides(rows: Trials) -> Iterator[tuple[Row, Trials]]:
    for (side, axis, speed_m_s), own in _by(rows, "side", "axis", "speed_m_s").items():
        undulations = under("undulations", own.median("undulations_per_cm"), "undulations/cm", 2)
        yield {"side": side, "axis": axis, **under("speed_m_s", speed_m_s), **undulations}, own


def _counted(groups: Iterable[tuple[Row, Trials]], touch: bool) -> Iterator[Row]:
    """A line for each group of trials and detector: in how many approaches it saw the object, and what it made of the
    touches, or, where these are not known, what it reported."""
    for named, own in groups:
        for whose, n in _counts(own):
            of = n["approaches"]
            line = {**named, "detector": whose, "approaches": of}
            if any(row["object"] != "none" for row in own):
                line |= {"seen": rate(n["seen"], of), **under("distance_m", n["distance_m"], "from", 0)}
            line["alarms"] = n["alarms"]
            if touch and own.values("touches"):
                line |= {"touches": n["touches"], "detected": rate(n["felt"], n["touches"])}
                line |= under("delay_s", n["delay_s"], digits=3)
                line |= {"persistence": n["held"], "end": n["ended"], "false": n["false"]}
            elif touch:
                line |= {"reported": n["reported"], "times": n["reports"], "persistence": n["reported_held"]}
                line |= {"end": n["reported_ended"], "where nothing can": n["reported_of_nothing"]}
            yield line


def _counts(own: Trials) -> Iterator[tuple[str, dict[str, Any]]]:
    """Of each detector whose it is, sums of its columns over some trials, and its median delay and distance."""
    for method, whose in METHODS.items() if own else ():
        sums: dict[str, Any] = {name: own.total(f"{name}_{method}") for name in OURS_AND_PAPERS}
        sums |= {name: own.total(name) for name in ("touches", "approaches")}
        medians = {name: own.median(f"{name}_{method}") for name in ("delay_s", "distance_m")}
        yield whose, sums | medians


# --- what is said, by detector -----------------------------------------------------------------------


def _of_sides(there: Trials) -> Iterator[Row]:
    """From which sides an object is seen at all (C2)."""
    sides = _by(there, "side")
    for method, whose in METHODS.items() if len(sides) > 1 else ():
        seen = {
            side: (own.total(f"seen_{method}"), own.total("approaches")) for (side,), own in sides.items()
        }
        # a side that sees nothing alarms as seldom as one before nothing does
        met = all_of(decided(hits, n, 1.0 - PRE_TOUCH[1]) for hits, n in seen.values())
        yield {"whose": whose, "seen": seen, "met": met, "goal": method == "ours"}


def _of_objects(rows: Trials, kind: Kind) -> Iterator[Row]:
    """Rates over objects beside the paper's over its six (C5)."""
    for what, column, of, paper in (
        ("Pre-touch", "seen", "approaches", PRE_TOUCH[0]),
        ("Contact", "felt", "touches", CONTACT[0]),
        *([("No false contact", "false", "approaches", CONTACT[1])] if rows.total("touches") else []),
    ):
        for whose, n in _counts(rows) if rows.total(of) else ():
            hits = n[of] - n[column] if column == "false" else n[column]
            line = {"what": what, "whose": whose, "hits": hits, "n": n[of], "of": of}
            line["beside"] = Comparison(hits / n[of], paper)
            yield line | _judged(kind, decided(hits, n[of], paper), whose, column)


def _of_touches(there: Trials, kind: Kind) -> Iterator[Row]:
    """Whether every side but the deaf one detects the pipe each time (C4)."""
    pipe = there.where(object=PIPE)
    sensing, deaf = pipe.where(lambda row: row["side"] != DEAF), pipe.where(side=DEAF)
    for (whose, n), (_, other) in zip(_counts(sensing), _counts(deaf or Trials([{}])), strict=False):
        if n["touches"]:
            met = every(n["touches"] - n["felt"], n["touches"])
            yield {"whose": whose, "n": n, "deaf": other} | _judged(kind, met, whose, "felt")


def _judged(kind: Kind, met: bool | None, whose: str, column: str) -> dict[str, Any]:
    """What the paper's detector does here is as printed or not, which is no goal. The plant's touch was assumed in
    favour of its contact: that it comes out shows nothing, that it does not is told."""
    papers = whose == METHODS["paper"]
    kind = Kind.PREDICTED if kind == Kind.ASSUMED and papers and column != "seen" and met is False else kind
    return {"kind": kind, "met": met, "goal": not papers}


# --- figure ------------------------------------------------------------------------------------------


def _draw(runs: Sequence[Run], figures: Figures) -> str:
    """The envelope along the approach: one panel for each side and speed of which there is a recording."""
    panels: dict[tuple[int, float], tuple[Run, int]] = {}
    for run in runs:
        recorded = {*run.recorded_trials}
        for row in Trials.of([run], AuraFactors).where(object=PIPE, axis="x"):
            if row["trial"] in recorded:
                panels.setdefault((SIDES.index(row["side"]), row["speed_m_s"]), (run, row["trial"]))
    if not panels:
        return ""
    keys = sorted(panels)[:PANELS]
    with figures.panels(len(keys), 2 if len(keys) > 1 else 1, 1.35) as drawing:
        for axes, key in zip(drawing.axes, keys, strict=True):
            _draw_panel(axes, f"{SIDES[key[0]]}, {quantity('speed_m_s', key[1], 0)}", *panels[key])
        drawing.label_outside("time (s)", "envelope (FS)")
        # a trial that was refused at once has a recording without the finger
        axes = next((each for each in drawing.axes if each.get_legend_handles_labels()[0]), drawing.axes[0])
        for mark, whose in (("o", "ours"), ("x", "the paper's")):
            axes.plot([], [], mark, mfc="none", color=INK, ms=4.0, label=whose)
        drawing.legend(axes, 4)
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
