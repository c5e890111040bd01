"""The part of the page on C1: which frequency transfers best."""

import statistics
from collections.abc import Sequence
from typing import Any

import numpy as np

from behaviors.chirp import ChirpSettings
from controller.measures.chirp import COLUMNS, LATENCY_UNSURE_S, STEP_HZ, beginning, transfer
from controller.recording.reader import Run
from controller.reports.counts import Comparison, all_of, number, quantity, sure, under, values
from controller.reports.figures import FAINT, FALSE, OURS, PAPER, Figures
from controller.reports.papers import BEST_HZ
from controller.reports.run_account import entered_s, recorded, setting_of
from controller.reports.section import Kind, Section, judged, kind_of

PRINTED = "40 kHz"
"""`BEST_HZ` as the paper prints it."""

NEAR_HZ = 500.0
"""How close to 40 kHz counts as found: two bands of the sweep; ours, since the paper gives only 40 kHz."""


HEADS = {
    "best": "best_hz",
    "right": "best_right_hz",
    "left": "best_left_hz",
    "± (band and latency)": "unsure_hz",
    "over noise": "over_noise_db",
}


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Best frequency of every sweep, and the curve of the first."""
    rows = [row for run in runs for row in run.trials if row.get("best_hz") is not None]
    found = values(rows, "best_hz")
    unsure = [float(row.get("unsure_hz") or 0.0) for row in rows]
    off = [(abs(hz - BEST_HZ), half_hz) for hz, half_hz in zip(found, unsure, strict=True)]
    # whether each sweep found the paper's frequency, by band and latency
    near = [sure(off_hz + half_hz <= NEAR_HZ, off_hz - half_hz > NEAR_HZ) for off_hz, half_hz in off]
    met = all_of(near) if found else False
    text = "No sweep came to its end"
    if found:
        beside = Comparison(statistics.median(found), BEST_HZ)
        far = beside.off("off_hz", 0)
        text = f"{far[:1].upper()}{far[1:]} the paper's {PRINTED}: {quantity('best_hz', beside.ours, 0)} transfers "
        text += f"best in {len(found)} {'sweep' if len(found) == 1 else 'sweeps'} (median)"
    put_in_hz = setting_of(runs[0], "plant", "resonance_hz")
    best = []
    for row in rows:
        line: dict[str, Any] = {"trial": row["trial"]}
        for head, name in HEADS.items():
            line |= under(name, row.get(name), head, COLUMNS[name].digits)
        band = " to ".join(number(row.get(f"band_{side}_hz"), 0) for side in ("low", "high"))
        best.append(line | under("band_hz", band, "half-power band"))
    return Section(
        title="Chirp (C1)",
        content={
            "put_in": " and ".join(f"{hz:g}" for hz in put_in_hz or ()),
            "step_hz": STEP_HZ,
            "unsure": quantity("latency_s", LATENCY_UNSURE_S, 3),
            "best": best,
            "figure": _draw(runs, figures),
        },
        template="chirp",
        paper="rupavatharam",
        summary=[judged(kind_of(runs, Kind.FITTED), text, met, len(found))],
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
            fingers = (("right finger", OURS), ("left finger", PAPER))
            for column, (name, color) in zip(power.T, fingers, strict=False):
                axes.plot(frequencies_hz, 10.0 * np.log10(column + 1e-20), color=color, label=name)
            axes.axvline(BEST_HZ, color=FALSE, lw=0.8, ls=(0, (4, 2)), label=f"the paper's {PRINTED}")
            axes.set(xlabel="frequency (Hz)", ylabel="received (dBFS)")
            axes.grid(color=FAINT, lw=0.4, alpha=0.6)
            axes.legend(loc="upper left")
            return drawing.save("chirp")
    return ""
