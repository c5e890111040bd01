"""The part of the page on A3: contact while the tendon moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from controller.measures.flexion import LISTENERS, curve
from controller.recording.reader import Run
from controller.reports.approaches import mean_of
from controller.reports.counts import rate, values
from controller.reports.figures import FAINT, FALSE, OURS, Figures
from controller.reports.paper import CITATION, SETTLE
from controller.reports.run_account import entered_s, setting_of
from controller.reports.section import Block, Figure, Kind, Result, Section
from controller.reports.section_texts import SectionTexts
from controller.reports.text import number, quantity, spread
from controller.scales import scale_of

TEXTS = SectionTexts("flexion")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """False contacts of each detector by the tendon's speed, and the free resonance against its position."""
    rows = [dict(row) for run in runs for row in run.trials if row.get("flexed_s") is not None]
    simulated = runs[0].simulated
    kind = Kind.PREDICTED if simulated else Kind.MEASURED
    summary = [Result(None, TEXTS.sentence("none"))] if not rows else []
    if rows:
        rise = mean_of(values(rows, "free_rise_hz"))
        flexed_m = setting_of(runs[0], "behavior", "flexed_m")
        text = TEXTS.sentence("rise", rise=spread(rise), over=quantity("flexed_m", flexed_m, 0), n=rise.n)
        summary.append(Result(Kind.ASSUMED if simulated else Kind.MEASURED, text, rise.mean > 0.0))
    for name in LISTENERS if rows else ():
        blind = values(rows, f"{name}_blind")
        if blind:
            text = TEXTS.sentence(
                f"{name}_blind",
                blind=rate(int(sum(blind)), len(blind)),
                share=_percent(rows, f"{name}_share"),
            )
            met = None if name == "ours" else (sum(blind) > 0.5 * len(blind)) == (name == "contact")
            summary.append(Result(kind, text, met))
    return Section(
        title="Contact while the finger is flexed (A3)",
        body=list(_body(runs, figures, rows)),
        citation=CITATION,
        summary=summary,
        not_the_papers=TEXTS.each("ours") if simulated else [],
        printed=SETTLE,
    )


def _body(runs: Sequence[Run], figures: Figures, rows: Sequence[dict[str, Any]]) -> Iterator[Block]:
    yield TEXTS.text("intro")
    if not rows:
        return
    yield TEXTS.table("by_speed", _by_speed(rows))
    svg = _draw(runs, figures)
    if svg:
        yield Figure(svg, TEXTS.sentence("figure"))


def _percent(rows: Sequence[dict[str, Any]], column: str) -> str:
    return f"{number(mean_of(values(rows, column)).mean, 0, 100.0)} %"


def _by_speed(rows: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for speed_m_s in sorted(set(values(rows, "tendon_m_s"))):
        own = [row for row in rows if row["tendon_m_s"] == speed_m_s]
        minutes = sum(values(own, "flexed_s")) / 60.0
        for name in LISTENERS:
            detected = mean_of(values(own, f"{name}_event_s"))
            blind = values(own, f"{name}_blind")
            yield {
                "tendon_m_s": speed_m_s,
                "detector": TEXTS.named("names")[name],
                "n": len(own),
                "false": sum(values(own, f"{name}_false")) / minutes,
                "share": _percent(own, f"{name}_share"),
                "blind": f"{sum(blind):.0f} of {len(blind)}",
                "detected": f"{detected.n}",
                "detected_s": detected.mean,
            }


def _draw(runs: Sequence[Run], figures: Figures) -> Markup | None:
    """The first trial's sweep: each period's frequency where the tendon was, the curve, the fixed threshold."""
    for run in runs:
        behavior = setting_of(run, "behavior") or {}
        for row in run.trials:
            recording = run.readable(int(row["trial"] or 0))
            entered = entered_s(run, row["trial"])
            if recording is None or not {"BASELINE", "FLEXING"} <= set(entered):
                continue
            streams = (
                behavior.get("period_stream", "board.period"),
                behavior.get("tendon_stream", "board.tendon"),
            )
            swept = [
                recording.stream(name).between(entered["BASELINE"], entered["FLEXING"]) for name in streams
            ]
            if not all(len(each) for each in swept):
                continue
            found = curve(*((each.times_s, each.values[:, 0]) for each in swept))
            with figures.figure(2.6) as drawing:
                axes, scale = drawing.axes[0], scale_of("tendon_m")
                axes.plot(
                    scale.factor * found["at_m"], found["hz"], ".", ms=2.0, color=FAINT, label="each period"
                )
                at_m = np.linspace(0.0, found["at_m"].max(), 50)
                shown = np.polynomial.polynomial.polyval(at_m, found["terms"])
                axes.plot(scale.factor * at_m, shown, color=OURS, label="free resonance")
                fixed = [
                    float(e["threshold"])
                    for e in run.events
                    if e.get("trial") == row["trial"]
                    and (e.get("event"), e.get("detector")) == ("BaselineReady", "contact")
                ]
                if fixed:
                    axes.axhline(fixed[-1], color=FALSE, lw=0.9, ls=(0, (5, 2)), label="fixed threshold")
                axes.set_xlabel(scale.heading)
                axes.set_ylabel("frequency (Hz)")
                axes.legend(loc="upper left")
                return Markup(drawing.save("flexion"))
    return None
