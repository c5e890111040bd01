"""The part of the page on A1: no, light and full contact at rest, beside the paper's Fig. 4."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

from controller.measures.static import COLUMNS
from controller.recording.reader import Run
from controller.recording.series import Series
from controller.reports.counts import (
    Comparison,
    Mean,
    Row,
    all_of,
    larger,
    mean_of,
    near,
    number,
    printed,
    quantity,
    signed,
    under,
    values,
)
from controller.reports.figures import FAINT, OURS, Figures
from controller.reports.papers import table
from controller.reports.run_account import series_of, setting_of
from controller.reports.section import Kind, Section, judged, kind_of
from controller.scales import NOTHING

WINDOW_S = 0.6
"""Length of waveform drawn: some 17 periods of 28 Hz, as many as the paper's Fig. 4 shows."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and waveforms of all static trials of some runs on one kind of bench."""
    rows, summary, means, drawn = [], [], {}, []
    for paper in table("backus_static"):
        own = [
            (run, row)
            for run in runs
            for row in run.trials
            if row.get("condition") == paper["condition"] and row.get("frequency_hz") is not None
        ]
        if not own:
            continue
        found = {name: mean_of(values([row for _, row in own], name)) for name in COLUMNS}
        means[paper["condition"]] = found
        met = near(found["frequency_hz"], paper["frequency_hz"], paper["tolerance_hz"])
        beside = Comparison(found["frequency_hz"].mean, paper["frequency_hz"], met)
        kind = Kind(paper["kind"]) if runs[0].simulated else Kind.MEASURED
        rows.append(_row(paper, len(own), found, beside, kind))
        place_m = setting_of(own[0][0], "behavior", f"{paper['condition']}_m")
        place = f", the probe at {quantity('place_m', place_m, 1)}" if place_m is not None else ""
        text = f"{paper['name'].capitalize()}: {beside.off('off_hz')} the paper's {beside.paper:g} Hz, "
        text += f"at {number(beside.ours, 1)} Hz{place}"
        summary.append(judged(kind, text, met, len(own)))
        drawn += [
            (paper["name"], found, series)
            for run, row in own
            if (recording := run.readable(int(row["trial"] or 0)))
            and len(series := series_of(recording, "accelerometer")) > 1
        ][:1]
    # whether an amplitude falls from condition to condition
    falls, too = (
        all_of(larger(*pair) for pair in pairwise(each[name] for each in means.values()))
        if len(means) > 2
        else None
        for name in ("amplitude_m", "amplitude_m_s2")
    )
    if len(means) == 3:
        ratio = number(means["none"]["amplitude_m"].mean / means["full"]["amplitude_m"].mean, 1)
        text = f"Amplitude of motion {ratio} times smaller with full contact than without; it "
        text += f"{'does not fall' if falls is False else 'falls'} from none over light to full"
        n = min(each["amplitude_m"].n for each in means.values())
        summary.append(judged(kind_of(runs), text, falls, n))
    return Section(
        title="Static contact (A1)",
        content={
            "trials": sum(len(run.trials) for run in runs),
            "at_rest": rows,
            "falls": falls,
            "too": too,
            "erratic": _erratic(means),
            "figure_4": _draw(figures, drawn) if drawn else "",
        },
        template="static",
        paper="backus",
        summary=summary,
    )


def _row(paper: Row, n: int, means: Mapping[str, Mean], beside: Comparison, kind: Kind) -> Row:
    found = {
        name: printed(name, mean if n > 1 else mean.mean, COLUMNS[name].digits)
        for name, mean in means.items()
    }
    difference = signed(beside.ours - beside.paper, 1)
    return {
        "contact": paper["name"] + (f" (n = {n})" if n > 1 else ""),
        "dominant frequency, Hz": {
            "ours": found["frequency_hz"],
            "paper": f"{beside.paper:g}",
            "Δ": difference,
            "bound": f"± {paper['tolerance_hz']:g}" if difference != NOTHING else NOTHING,
            "kind": beside.met if kind == Kind.MEASURED else str(kind),
        },
        "wander, Hz": {"σ": found["frequency_sd_hz"]},
        "amplitude": under("amplitude_m_s2", found["amplitude_m_s2"], "")
        | under("amplitude_m", found["amplitude_m"], ""),
        "force, N": {"mean": found["force_n"], "peak": found["force_peak_n"]},
    }


def _erratic(means: Mapping[str, Mapping[str, Mean]]) -> str:
    """How much more the frequency wanders from period to period in light contact than without."""
    none, light = (
        means[name]["frequency_sd_hz"].mean if name in means else 0.0 for name in ("none", "light")
    )
    return number(light / none, 0 if light > 10.0 * none else 1) if none > 0.0 and light > 0.0 else ""


def _draw(figures: Figures, drawn: Sequence[tuple[str, Mapping[str, Mean], Series]]) -> str:
    """Fig. 4: the waveforms, on one scale."""
    with figures.figure(1.3 * len(drawn) + 0.4, rows=len(drawn), sharex=True, sharey=True) as drawing:
        for axes, (name, means, series) in zip(drawing.axes, drawn, strict=True):
            start_s = float(series.times_s[0])
            shown = series.between(start_s, start_s + WINDOW_S)
            axes.plot(shown.times_s - start_s, shown.values[:, 0], color=OURS, lw=0.9)
            axes.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
            axes.set_title(name)
            said = f"{means['frequency_hz'].mean:.1f} Hz, {means['amplitude_m_s2'].mean:.1f} m/s²"
            axes.set_title(said, loc="right")
        drawing.axes[len(drawn) // 2].set_ylabel("acceleration (m/s²)")
        drawing.axes[-1].set(xlabel="time (s)", xlim=(0.0, WINDOW_S))
        return drawing.save("fig_4_waveforms")
