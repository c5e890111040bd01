"""The part of the page on A3: contact while the tendon moves."""

from collections.abc import Iterator, Sequence

import numpy as np

from controller.measures.flexion import LISTENERS, curve
from controller.recording.reader import Run
from controller.reports.counts import Mean, Row, Trials, decided, larger, paired, under
from controller.reports.figures import FAINT, FALSE, OURS, Figures
from controller.reports.run_account import entered_s, recorded, setting_of
from controller.reports.section import Headline, Kind, Section, kind_of, measured, rated, told
from controller.scales import scale_of

NAMES = dict(zip(LISTENERS, ("fixed (the paper's)", "follows the tendon", "waveform"), strict=True))


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """False contacts of each detector by the tendon's speed, and the free resonance against its position."""
    rows = Trials.of(runs).known("flexed_s")
    rise, detectors = rows.mean("free_rise_hz"), {}
    for name in LISTENERS:
        if blind := rows.values(f"{name}_blind"):
            hits, n = int(sum(blind)), len(blind)
            met = None if name == "ours" else decided(hits if name == "contact" else n - hits, n, 0.5)
            detectors[name] = {"share": rows.mean(f"{name}_share").mean, "hits": hits, "n": n, "met": met}
    content = {
        "rise": rise,
        "rises": larger(rise, Mean(0.0, 0.0, 2)),
        "rise_kind": kind_of(runs, Kind.ASSUMED),
        "flexed_m": setting_of(runs[0], "behavior", "flexed_m"),
        "detectors": detectors,
        "by_speed": list(_by_speed(rows)),
        "figure": _draw(runs, figures),
    }
    heading = "Contact while the finger is flexed (A3)"
    return told(runs, heading, "flexion", content, paper="backus", headline=_headline(rows))


def _headline(rows: Trials) -> Headline | None:
    """How often each threshold was blind to the touch, having reported contact before it."""
    both = rows.known("contact_blind", "following_blind")
    if not both:
        return None
    what, source = (
        "touches to which a threshold that follows the tendon was blind",
        "the paper's fixed one (same approaches)",
    )
    n, hits, theirs = len(both), both.total("following_blind"), both.total("contact_blind")
    above = paired((row["following_blind"], row["contact_blind"]) for row in both)
    return rated(what, hits, n, theirs / n, source, above=above, more=False)


def _by_speed(rows: Trials) -> Iterator[Row]:
    for (speed_m_s,), own in rows.by("tendon_m_s").items():
        for name in LISTENERS:
            of_one = [{key.removeprefix(f"{name}_"): cell for key, cell in row.items()} for row in own]
            means = measured([Trials(of_one)], (), ("false", "share", "blind", "event_s"))
            yield {**under("tendon_m_s", speed_m_s), "detector": NAMES[name], **means[0]}


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
