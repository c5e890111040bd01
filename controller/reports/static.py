"""The part of the page on A1: no, light and full contact at rest, beside the paper's Fig. 4."""

from collections.abc import Sequence
from itertools import pairwise

from controller.measures.static import COLUMNS
from controller.recording.reader import Run
from controller.recording.series import Series
from controller.reports.counts import Comparison, Trials, all_of, larger, near, number
from controller.reports.figures import FAINT, OURS, Figures
from controller.reports.papers import table
from controller.reports.run_account import recorded, series_of, setting_of
from controller.reports.section import Kind, Section, kind_of, measured, told

WINDOW_S = 0.6
"""Length of waveform drawn: some 17 periods of 28 Hz, as many as the paper's Fig. 4 shows."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and waveforms of all static trials of some runs on one kind of bench."""
    rows, said, groups, drawn = Trials.of(runs), [], [], []
    for paper in table("backus_static"):
        name, aim_hz = paper["condition"], paper["frequency_hz"]
        own = rows.where(condition=name)
        if not (ours := own.mean("frequency_hz")).n:
            continue
        groups.append(own)
        beside = Comparison(ours.mean, aim_hz, near(ours, aim_hz, paper["tolerance_hz"]))
        kind = kind_of(runs, Kind(paper["kind"]))
        place_m = setting_of(runs[0], "behavior", f"{name}_m")
        said.append({"name": paper["name"], "kind": kind, "beside": beside, "n": ours.n, "place_m": place_m})
        drawn += [
            (paper["name"], own, series)
            for _, row, recording in recorded(runs)
            if row.get("condition") == name
            and row.get("frequency_hz") is not None
            and len(series := series_of(recording, "accelerometer")) > 1
        ][:1]
    amplitudes = [own.mean("amplitude_m") for own in groups]
    content = {
        "at_rest": measured(groups, ["condition"], COLUMNS),
        "said": said,
        "amplitudes": amplitudes,
        "falls": all_of(larger(*pair) for pair in pairwise(amplitudes)),
        "figure_4": _draw(figures, drawn) if drawn else "",
    }
    return told(runs, "Static contact (A1)", "static", content, paper="backus")


def _draw(figures: Figures, drawn: Sequence[tuple[str, Trials, Series]]) -> str:
    """Fig. 4: the waveforms, on one scale."""
    with figures.figure(1.3 * len(drawn) + 0.4, rows=len(drawn), sharex=True, sharey=True) as drawing:
        for axes, (name, own, series) in zip(drawing.axes, drawn, strict=True):
            start_s = float(series.times_s[0])
            shown = series.between(start_s, start_s + WINDOW_S)
            axes.plot(shown.times_s - start_s, shown.values[:, 0], color=OURS, lw=0.9)
            axes.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
            axes.set_title(name)
            hz, m_s2 = (number(own.mean(each).mean, 1) for each in ("frequency_hz", "amplitude_m_s2"))
            axes.set_title(f"{hz} Hz, {m_s2} m/s²", loc="right")
        drawing.axes[len(drawn) // 2].set_ylabel("acceleration (m/s²)")
        drawing.axes[-1].set(xlabel="time (s)", xlim=(0.0, WINDOW_S))
        return drawing.save("fig_4_waveforms")
