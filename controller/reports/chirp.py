"""The part of the page on C1: which frequency transfers best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from behaviors.chirp import ChirpSettings
from controller.measures.chirp import LATENCY_UNSURE_S, STEP_HZ, beginning, transfer
from controller.recording.reader import Run
from controller.reports.figures import FAINT, FALSE, OURS, PAPER, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Section
from controller.reports.sonicfinger import BEST_HZ, CITATION, NOT_THE_PAPERS
from controller.reports.text import number

NEAR_HZ = 500.0
"""How close to 40 kHz is called found: two bands of the sweep; ours, for the paper says 40 kHz and no more."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Best frequency of every sweep, and the curve of the first."""
    rows = [row for run in runs for row in run.trials if row.get("best_hz") is not None]
    found = [float(row["best_hz"]) for row in rows]  # type: ignore[arg-type]
    met = bool(found) and max(abs(hz - BEST_HZ) for hz in found) <= NEAR_HZ
    said = (
        f"The sweep finds {number(float(np.median(found)), 2, 1e-3)} kHz as the frequency that transfers best; "
        "the paper 40 kHz."
        if found
        else "No sweep came to its end."
    )
    svg = _draw(runs, figures)
    return Section(
        title="Chirp (C1)",
        template="plain.html.j2",
        citation=CITATION,
        summary=[(met, said)],
        not_the_papers=[
            *NOT_THE_PAPERS,
            "The fingers' resonance near 40 kHz is put into the plant, not found by it.",
        ],
        context={
            "paragraphs": [
                "The drive is swept once, linearly, while nothing is near; what comes back is squared and "
                f"averaged in bands of {STEP_HZ:g} Hz. When it began is counted back from its end, by the frames "
                "in which the device heard it; what a card says of its own latency is in that, and may be off by "
                f"{number(LATENCY_UNSURE_S, 0, 1e3)} ms (assumed)."
            ],
            "tables": [
                {
                    "caption": "Best frequency: both fingers' powers added, and each finger's own.",
                    "head": [
                        "trial",
                        "best, kHz",
                        "right",
                        "left",
                        "± (band and latency)",
                        "half-power band",
                        "over noise, dB",
                    ],
                    "rows": [_row(row) for row in rows],
                    "left": 1,
                }
            ],
            "figures": [{"svg": svg, "caption": "What comes back while the drive passes each frequency."}]
            if svg
            else [],
            "notes": [],
        },
    )


def _row(row: Any) -> list[str]:
    def khz(name: str) -> str:
        return number(row.get(name), 2, 1e-3)

    return [
        str(row["trial"]),
        khz("best_hz"),
        khz("best_right_hz"),
        khz("best_left_hz"),
        khz("unsure_hz"),
        f"{khz('band_low_hz')} to {khz('band_high_hz')}",
        number(row.get("over_noise_db"), 1),
    ]


def _draw(runs: Sequence[Run], figures: Figures) -> Markup | None:
    for run in runs:
        settings = ChirpSettings.model_validate(setting_of(run, "behavior") or {})
        begun_s = {
            int(event["trial"]): beginning(float(event["t_s"]), settings)
            for event in run.events
            if event.get("next") == "RINGING"
        }
        for trial in run.recorded_trials:
            recording = run.readable(trial)
            if recording is None or trial not in begun_s:
                continue
            series = recording.stream(settings.fingers_stream)
            if not len(series):
                continue
            frequencies_hz, power = transfer(series.times_s - begun_s[trial], series.values, settings)
            with figures.figure(2.6) as drawing:
                axes = drawing.axes[0]
                for column, name, color in zip(
                    power.T, ("right finger", "left finger"), (OURS, PAPER), strict=False
                ):
                    axes.plot(frequencies_hz / 1e3, 10.0 * np.log10(column + 1e-20), color=color, label=name)
                axes.axvline(BEST_HZ / 1e3, color=FALSE, lw=0.8, ls=(0, (4, 2)), label="the paper's 40 kHz")
                axes.set_xlabel("frequency (kHz)")
                axes.set_ylabel("received (dBFS)")
                axes.grid(color=FAINT, lw=0.4, alpha=0.6)
                axes.legend(loc="lower right")
                return Markup(drawing.save("chirp"))
    return None
