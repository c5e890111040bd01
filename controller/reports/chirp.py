"""The part of the page on C1: which frequency transfers best."""

import statistics
from collections.abc import Sequence

import numpy as np

from behaviors.chirp import ChirpSettings
from controller.measures.chirp import COLUMNS, LATENCY_UNSURE_S, STEP_HZ, beginning, transfer
from controller.recording.reader import Run
from controller.reports.counts import Comparison, Trials, all_of, sure
from controller.reports.figures import FAINT, FALSE, OURS, PAPER, Figures
from controller.reports.papers import BEST_HZ
from controller.reports.run_account import entered_s, recorded, setting_of
from controller.reports.section import Kind, Section, kind_of, measured, told

PRINTED = "40 kHz"
"""`BEST_HZ` as the paper prints it."""

NEAR_HZ = 500.0
"""How close to 40 kHz counts as found: two bands of the sweep; ours, since the paper gives only 40 kHz."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Best frequency over all sweeps, and the curve of the first."""
    rows = Trials.of(runs).known("best_hz")
    near = []
    for row in rows:
        # whether the sweep found the paper's frequency, by band and latency
        off_hz, half_hz = abs(row["best_hz"] - BEST_HZ), float(row.get("unsure_hz") or 0.0)
        near.append(sure(off_hz + half_hz <= NEAR_HZ, off_hz - half_hz > NEAR_HZ))
    return told(
        runs,
        "Chirp (C1)",
        "chirp",
        {
            "kind": kind_of(runs, Kind.FITTED),
            "beside": Comparison(statistics.median(rows.values("best_hz")), BEST_HZ, all_of(near))
            if rows
            else None,
            "printed": PRINTED,
            "put_in": " and ".join(f"{hz:g}" for hz in setting_of(runs[0], "plant", "resonance_hz") or ()),
            "step_hz": STEP_HZ,
            "unsure_s": LATENCY_UNSURE_S,
            "n": len(rows),
            "best": measured([rows] * bool(rows), [], COLUMNS),
            "figure": _draw(runs, figures),
        },
        paper="rupavatharam",
    )


def _draw(runs: Sequence[Run], figures: Figures) -> str:
    for run, row, recording in recorded(runs):
        settings = ChirpSettings.model_validate(setting_of(run, "behavior") or {})
        ended_s = entered_s(run, row["trial"]).get("RINGING")
        series = recording.stream(settings.fingers_stream)
        if ended_s is None or not len(series):
            continue
        times_s = series.times_s - beginning(ended_s, settings)
        frequencies_hz, power = transfer(times_s, series.values, settings)
        with figures.figure(2.6) as drawing:
            axes = drawing.axes[0]
            for column, name, color in zip(power.T, ("right", "left"), (OURS, PAPER), strict=False):
                axes.plot(
                    frequencies_hz, 10.0 * np.log10(column + 1e-20), color=color, label=f"{name} finger"
                )
            axes.axvline(BEST_HZ, color=FALSE, lw=0.8, ls=(0, (4, 2)), label=f"the paper's {PRINTED}")
            axes.set(xlabel="frequency (Hz)", ylabel="received (dBFS)")
            axes.grid(color=FAINT, lw=0.4, alpha=0.6)
            axes.legend(loc="upper left")
            return drawing.save("chirp")
    return ""
