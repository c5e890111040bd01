"""The part of the page on A1: no, light and full contact at rest, beside the paper's Fig. 4."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from controller.recording.reader import Run
from controller.recording.series import Series
from controller.reports.approaches import Mean, mean_of
from controller.reports.figures import FAINT, FALSE, OURS, Figures
from controller.reports.paper import CITATION, SETTLE, STATIC_HZ, STATIC_KINDS, STATIC_TOLERANCE_HZ
from controller.reports.run_account import series_of, setting_of
from controller.reports.section import Block, Figure, Kind, Notes, Result, Section
from controller.reports.section_texts import SectionTexts
from controller.reports.text import number, quantity, signed
from controller.scales import NOTHING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CONDITIONS = ("none", "light", "full")
NAMES = {"none": "no contact", "light": "light contact", "full": "full contact"}

WINDOW_S = 0.6
"""Length of waveform drawn: some 17 periods of 28 Hz, as many as the paper's Fig. 4 shows."""

SPECTRUM_HZ = 100.0
"""How far the spectra are drawn."""


@dataclass(frozen=True, slots=True)
class StaticCondition:
    """All trials of one condition; each measure a mean over trials."""

    name: str
    trials: Sequence[tuple[Run, int]]
    frequency_hz: Mean
    frequency_sd_hz: Mean
    amplitude_m_s2: Mean
    amplitude_m: Mean
    force_n: Mean
    force_peak_n: Mean

    @property
    def difference_hz(self) -> float:
        """Dominant frequency less the paper's."""
        return self.frequency_hz.mean - STATIC_HZ[self.name]

    @property
    def met(self) -> bool:
        """Whether it is as near the paper's as is called reproduced."""
        return abs(self.difference_hz) <= STATIC_TOLERANCE_HZ[self.name]


def read_conditions(runs: Sequence[Run]) -> list[StaticCondition]:
    """The conditions of which there are measured trials, from none to full."""
    measures = ("frequency_hz", "frequency_sd_hz", "amplitude_m_s2", "amplitude_m", "force_n", "force_peak_n")
    conditions = []
    for name in CONDITIONS:
        rows = [
            (run, row)
            for run in runs
            for row in run.trials
            if row.get("condition") == name and row.get("frequency_hz") is not None
        ]
        if rows:
            means = {key: mean_of(_float(row.get(key)) for _, row in rows) for key in measures}
            trials = [(run, int(row["trial"] or 0)) for run, row in rows]
            conditions.append(StaticCondition(name, trials, **means))
    return conditions


def _float(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


TEXTS = SectionTexts("static")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and waveforms of all static trials of some runs on one kind of bench."""
    conditions = read_conditions(runs)
    simulated = runs[0].simulated
    summary = [
        Result(STATIC_KINDS[each.name] if simulated else Kind.MEASURED, _sentence(each), each.met)
        for each in conditions
    ]
    falls = _falls([condition.amplitude_m for condition in conditions])
    if falls is not None:
        ratio = number(conditions[0].amplitude_m.mean / conditions[-1].amplitude_m.mean, 1)
        how = f"{ratio} times smaller with full contact than without"
        text = f"Amplitude of motion {how}; it {'falls' if falls else 'does not fall'} from none over light to full."
        summary.append(Result(Kind.PREDICTED if simulated else Kind.MEASURED, text, falls))
    return Section(
        title="Static contact (A1)",
        body=[TEXTS.text("intro"), *_body(runs, figures, conditions, falls)],
        citation=CITATION,
        summary=summary,
        not_the_papers=TEXTS.each("ours"),
        printed=SETTLE,
    )


def _body(
    runs: Sequence[Run], figures: Figures, conditions: Sequence[StaticCondition], falls: bool | None
) -> Iterator[Block]:
    if not conditions:
        yield TEXTS.text("nothing", trials=sum(len(run.trials) for run in runs))
        return
    yield TEXTS.table("at_rest", map(_row, conditions))
    notes = []
    if falls is not None:
        too = _falls([condition.amplitude_m_s2 for condition in conditions])
        as_well = "as well" if falls == too else "falls" if too else "does not"
        notes.append(TEXTS.sentence("falls", falls="falls" if falls else "does not fall", as_well=as_well))
    if times := _erratic(conditions):
        notes.append(TEXTS.sentence("erratic", times=times))
    yield Notes(notes)
    drawn = [(condition, series) for condition in conditions if (series := _waveform(condition)) is not None]
    if drawn:
        yield Figure(Markup(_draw(figures, drawn)), TEXTS.sentence("figure_4"))


def _sentence(condition: StaticCondition) -> str:
    """`No contact: 0.1 Hz above the paper's 28 Hz, at 28.1 Hz, the probe at 0.0 mm.`"""
    off, paper = round(condition.difference_hz, 1), quantity("paper_hz", STATIC_HZ[condition.name], 0)
    beside = (
        f"{quantity('off_hz', abs(off), 1)} {'below' if off < 0.0 else 'above'}" if off else "the same as"
    )
    shown = f"{beside} the paper's {paper}"
    place_m = setting_of(condition.trials[0][0], "behavior", f"{condition.name}_m")
    place = f", the probe at {quantity('place_m', place_m, 1)}" if isinstance(place_m, int | float) else ""
    name = NAMES[condition.name].capitalize()
    return f"{name}: {shown}, at {number(condition.frequency_hz.mean, 1)} Hz{place}."


def _falls(amplitudes: Sequence[Mean]) -> bool | None:
    """Whether the amplitude falls from condition to condition; None where one is missing."""
    means = [amplitude.mean for amplitude in amplitudes]
    if len(means) < len(CONDITIONS) or any(math.isnan(mean) for mean in means):
        return None
    return means[0] > means[1] > means[2]


def _erratic(conditions: Sequence[StaticCondition]) -> str:
    """How much more the frequency wanders from period to period in light contact than without."""
    sd = {condition.name: condition.frequency_sd_hz.mean for condition in conditions}
    if not sd.get("none", 0.0) > 0.0 or math.isnan(sd.get("light", math.nan)):
        return ""
    return number(sd["light"] / sd["none"], 0 if sd["light"] > 10.0 * sd["none"] else 1)


def _row(condition: StaticCondition) -> dict[str, Any]:
    names = ("frequency_hz", "frequency_sd_hz", "amplitude_m_s2", "amplitude_m", "force_n", "force_peak_n")
    means = {name: getattr(condition, name) for name in names}
    n = len(condition.trials)
    kind = STATIC_KINDS[condition.name] if condition.trials[0][0].simulated else Kind.MEASURED
    difference = signed(condition.difference_hz, 1)
    return {name: mean if mean.n > 1 else mean.mean for name, mean in means.items()} | {
        "contact": NAMES[condition.name] + (f" (n = {n})" if n > 1 else ""),
        "paper_hz": f"{STATIC_HZ[condition.name]:g}",
        "difference_hz": difference,
        "tolerance_hz": f"± {STATIC_TOLERANCE_HZ[condition.name]:g}" if difference != NOTHING else NOTHING,
        "met": condition.met if kind == Kind.MEASURED else str(kind),
    }


def _waveform(condition: StaticCondition) -> Series | None:
    recordings = (run.readable(trial) for run, trial in condition.trials)
    drawn = (series_of(recording, "accelerometer") for recording in recordings if recording is not None)
    return next((series for series in drawn if len(series) > 1), None)


def _draw(figures: Figures, drawn: Sequence[tuple[StaticCondition, Series]]) -> str:
    """Fig. 4: the waveforms on one scale, and beside each its spectrum."""
    with figures.figure(
        1.45 * len(drawn) + 0.4, rows=len(drawn), columns=2, sharex="col", sharey="col", width_ratios=[3, 1.3]
    ) as drawing:
        for index, (condition, series) in enumerate(drawn):
            left, right = drawing.axes[2 * index : 2 * index + 2]
            start_s = float(series.times_s[0])
            shown = series.between(start_s, start_s + WINDOW_S)
            left.plot(shown.times_s - start_s, shown.values[:, 0], color=OURS, lw=0.9)
            left.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
            left.set_title(NAMES[condition.name])
            left.set_title(
                f"{condition.frequency_hz.mean:.1f} Hz, {condition.amplitude_m_s2.mean:.1f} m/s²", loc="right"
            )
            _draw_spectrum(right, condition, series)
        drawing.axes[2 * (len(drawn) // 2)].set_ylabel("acceleration (m/s²)")
        drawing.axes[2 * (len(drawn) // 2) + 1].set_ylabel("amplitude (m/s²)")
        drawing.axes[-2].set_xlabel("time (s)")
        drawing.axes[-1].set_xlabel("frequency (Hz)")
        drawing.axes[-2].set_xlim(0.0, WINDOW_S)
        return drawing.save("fig_4_waveforms")


def _draw_spectrum(axes: Axes, condition: StaticCondition, series: Series) -> None:
    rate_hz = (len(series) - 1) / float(series.times_s[-1] - series.times_s[0])
    values = series.values[:, 0]
    window = np.hanning(len(values) + 1)[:-1]
    amplitudes = 2.0 * np.abs(np.fft.rfft((values - values.mean()) * window)) / window.sum()
    frequencies_hz = np.fft.rfftfreq(len(values), 1.0 / rate_hz)
    low = frequencies_hz <= SPECTRUM_HZ
    axes.plot(frequencies_hz[low], amplitudes[low], color=OURS, lw=0.9)
    axes.axvline(STATIC_HZ[condition.name], color=FALSE, lw=0.8, ls=(0, (4, 2)))
    axes.set_xlim(0.0, SPECTRUM_HZ)
    axes.set_ylim(bottom=0.0)
    if condition.name == "none":
        axes.text(
            STATIC_HZ["none"] + 2.0,
            0.97,
            "paper",
            color=FALSE,
            fontsize=8,
            va="top",
            transform=axes.get_xaxis_transform(),
        )
