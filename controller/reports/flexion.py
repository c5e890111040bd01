"""The part of the page on A3: contact while the tendon moves."""

from collections.abc import Iterator, Sequence

import numpy as np

from controller.measures.flexion import LISTENERS, curve
from controller.recording.reader import Run
from controller.reports.counts import (
    Mean,
    Row,
    decided,
    grouped,
    larger,
    mean_of,
    number,
    quantity,
    rate,
    spread,
    under,
    values,
)
from controller.reports.figures import FAINT, FALSE, OURS, Figures
from controller.reports.run_account import entered_s, recorded, setting_of
from controller.reports.section import Headline, Kind, Result, Section, judged, kind_of, rated
from controller.scales import scale_of

NAMES = dict(zip(LISTENERS, ("fixed (the paper's)", "follows the tendon", "waveform"), strict=True))

SAID = {
    "contact": "The fixed threshold reports contact for {share} of the time in which the free finger is flexed, and so "
    "is blind to the touch in {blind}: as the paper says, of no use",
    "following": "The threshold that follows the tendon reports contact for {share} of that time and is blind to the "
    "touch in {blind}: as the paper expects, of use",
    "ours": "The waveform's detector, which follows slow drift by itself but not the tendon, reports contact for "
    "{share} of that time and is blind in {blind}",
}


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """False contacts of each detector by the tendon's speed, and the free resonance against its position."""
    rows = [row for run in runs for row in run.trials if row.get("flexed_s") is not None]
    summary = []
    if not rows:
        summary.append(Result(None, "In no trial did the tendon move."))
    else:
        rise = mean_of(values(rows, "free_rise_hz"))
        over = quantity("flexed_m", setting_of(runs[0], "behavior", "flexed_m"), 0)
        text = f"The free resonance rises by {spread(rise)} Hz over {over} of tendon (n = {rise.n}); "
        text += "the paper says that it rises"
        summary.append(judged(kind_of(runs, Kind.ASSUMED), text, larger(rise, Mean(0.0, 0.0, 2)), rise.n))
    for name in LISTENERS:
        if blind := values(rows, f"{name}_blind"):
            share, n, hits = _percent(rows, f"{name}_share"), len(blind), int(sum(blind))
            text = SAID[name].format(blind=rate(hits, n), share=share)
            hits = hits if name == "contact" else n - hits
            verdict = judged(kind_of(runs), text, decided(hits, n, 0.5), n)
            summary.append(verdict if name != "ours" else Result(kind_of(runs), f"{text}."))
    return Section(
        title="Contact while the finger is flexed (A3)",
        content={"by_speed": list(_by_speed(rows)), "figure": _draw(runs, figures) if rows else ""},
        template="flexion",
        paper="backus",
        summary=summary,
        headline=_headline(rows),
    )


def _headline(rows: Sequence[Row]) -> Headline | None:
    """How often each threshold was blind to the touch, having reported contact before it."""
    fixed, following = (values(rows, f"{name}_blind") for name in ("contact", "following"))
    if not fixed or not following:
        return None
    what = "touches to which a threshold that follows the tendon was blind"
    beside, n = sum(fixed) / len(fixed), len(following)
    return rated(what, int(sum(following)), n, beside, "the paper's fixed one (same approaches)", more=False)


def _percent(rows: Sequence[Row], column: str) -> str:
    return f"{number(mean_of(values(rows, column)).mean, 0, 100.0)} %"


def _by_speed(rows: Sequence[Row]) -> Iterator[Row]:
    for (speed_m_s,), own in grouped(rows, "tendon_m_s").items():
        minutes = sum(values(own, "flexed_s")) / 60.0
        for name in LISTENERS:
            detected = mean_of(values(own, f"{name}_event_s"))
            blind = values(own, f"{name}_blind")
            yield {
                **under("tendon_m_s", speed_m_s, "tendon", 1),
                "detector": NAMES[name],
                "n": len(own),
                "false contacts": {
                    "a minute": number(sum(values(own, f"{name}_false")) / minutes, 1),
                    "time in contact": _percent(own, f"{name}_share"),
                },
                "touch": {"blind": f"{sum(blind):.0f} of {len(blind)}", "detected": detected.n}
                | under("event_s", detected.mean, "after", 3),
            }


def _draw(runs: Sequence[Run], figures: Figures) -> str:
    """The first trial's sweep: each period's frequency where the tendon was, the curve, the fixed threshold."""
    for run, row, recording in recorded(runs):
        behavior, entered = setting_of(run, "behavior") or {}, entered_s(run, row["trial"])
        if not {"BASELINE", "FLEXING"} <= set(entered):
            continue
        streams = [behavior.get(f"{name}_stream", f"board.{name}") for name in ("period", "tendon")]
        swept = [recording.stream(name).between(entered["BASELINE"], entered["FLEXING"]) for name in streams]
        if not all(map(len, swept)):
            continue
        found = curve(*((each.times_s, each.values[:, 0]) for each in swept))
        learned = [
            float(event["threshold"])
            for event in run.events_of(row["trial"])
            if (event.get("event"), event.get("detector")) == ("BaselineReady", "contact")
        ]
        with figures.figure(2.6) as drawing:
            axes, scale = drawing.axes[0], scale_of("tendon_m")
            places = scale.factor * found["at_m"]
            axes.plot(places, found["hz"], ".", ms=2.0, color=FAINT, label="each period")
            at_m = np.linspace(0.0, found["at_m"].max(), 50)
            shown = np.polynomial.polynomial.polyval(at_m, found["terms"])
            axes.plot(scale.factor * at_m, shown, color=OURS, label="free resonance")
            for threshold_hz in learned[-1:]:
                axes.axhline(threshold_hz, color=FALSE, lw=0.9, ls=(0, (5, 2)), label="fixed threshold")
            axes.set(xlabel=scale.heading, ylabel="frequency (Hz)")
            axes.legend(loc="upper left")
            return drawing.save("flexion")
    return ""
