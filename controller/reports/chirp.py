"""The part of the page on C1: which frequency transfers best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from behaviors.chirp import ChirpSettings
from controller.measures.chirp import LATENCY_UNSURE_S, STEP_HZ, beginning, transfer
from controller.recording.reader import Run
from controller.reports.counts import values
from controller.reports.figures import FAINT, FALSE, OURS, PAPER, Figures
from controller.reports.run_account import entered_s, setting_of
from controller.reports.section import Figure, Kind, Result, Section
from controller.reports.section_texts import SectionTexts
from controller.reports.sonicfinger import ASSUMED, BEST_HZ, CITATION
from controller.reports.text import number, quantity

TEXTS = SectionTexts("chirp")

PRINTED = "40 kHz"
"""`BEST_HZ` as the paper prints it."""

NEAR_HZ = 500.0
"""How close to 40 kHz counts as found: two bands of the sweep; ours, since the paper gives only 40 kHz."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Best frequency of every sweep, and the curve of the first."""
    rows: list[dict[str, Any]] = [
        dict(row) for run in runs for row in run.trials if row.get("best_hz") is not None
    ]
    found = values(rows, "best_hz")
    met = bool(found) and max(abs(hz - BEST_HZ) for hz in found) <= NEAR_HZ
    text = "No sweep came to its end."
    if found:
        best_hz = float(np.median(found))
        off_hz = round(best_hz - BEST_HZ)
        beside = f"{quantity('off_hz', abs(off_hz), 0)} {'below' if off_hz < 0 else 'above'}"
        text = (
            f"{beside if off_hz else 'The same as'} the paper's {PRINTED}: "
            f"{quantity('best_hz', best_hz, 0)} transfers best in {len(found)} "
            f"{'sweep' if len(found) == 1 else 'sweeps'} (median)."
        )
    put_in_hz = setting_of(runs[0], "plant", "resonance_hz")
    simulated = runs[0].simulated
    ours = [*ASSUMED] if simulated else []
    if put_in_hz:
        ours.append(TEXTS.sentence("put_in", hz=" and ".join(f"{hz:g}" for hz in put_in_hz)))
    for row in rows:
        row["band_hz"] = " to ".join(number(row.get(f"band_{side}_hz"), 0) for side in ("low", "high"))
    svg = _draw(runs, figures)
    return Section(
        title="Chirp (C1)",
        body=[
            TEXTS.text("intro", step_hz=STEP_HZ, unsure=quantity("latency_s", LATENCY_UNSURE_S, 3)),
            TEXTS.table("best", rows),
            *([Figure(svg, TEXTS.sentence("figure"))] if svg else []),
        ],
        citation=CITATION,
        summary=[Result(Kind.FITTED if simulated else Kind.MEASURED, text, met)],
        not_the_papers=ours,
    )


def _draw(runs: Sequence[Run], figures: Figures) -> Markup | None:
    for run in runs:
        settings = ChirpSettings.model_validate(setting_of(run, "behavior") or {})
        for trial in run.recorded_trials:
            recording, ended_s = run.readable(trial), entered_s(run, trial).get("RINGING")
            if recording is None or ended_s is None:
                continue
            series = recording.stream(settings.fingers_stream)
            if not len(series):
                continue
            frequencies_hz, power = transfer(
                series.times_s - beginning(ended_s, settings), series.values, settings
            )
            with figures.figure(2.6) as drawing:
                axes = drawing.axes[0]
                for column, name, color in zip(
                    power.T, ("right finger", "left finger"), (OURS, PAPER), strict=False
                ):
                    axes.plot(frequencies_hz, 10.0 * np.log10(column + 1e-20), color=color, label=name)
                axes.axvline(BEST_HZ, color=FALSE, lw=0.8, ls=(0, (4, 2)), label=f"the paper's {PRINTED}")
                axes.set_xlabel("frequency (Hz)")
                axes.set_ylabel("received (dBFS)")
                axes.grid(color=FAINT, lw=0.4, alpha=0.6)
                axes.legend(loc="lower right")
                return Markup(drawing.save("chirp"))
    return None
