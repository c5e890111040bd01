"""Three figures: from how far, how weak an echo may be, and what contact looks like."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.pretouch.scenes import Event, passage
from benchmarks.pretouch.study import BOTH, CLAIRVOYANT, MATCHED, PAPER_TPR, SEED_MATCH, Verdict
from controller.detectors.level import LevelDetector, LevelPaperDetector, LevelPaperSettings, LevelSettings
from drivers.mock.physics.aura_objects import SIX

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from benchmarks.pretouch.rates import Study

FOLDER = Path(__file__).resolve().parents[1] / "figures"

COLOURS = {MATCHED: "#457b9d", BOTH: "#8ab17d", "pretouch": "#c1121f", CLAIRVOYANT: "#6c757d"}


def draw(study: Study) -> list[Path]:
    """All figures, as SVG and PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "touchbench"
    FOLDER.mkdir(exist_ok=True)
    return [*_distances(study), *_strengths(study), *_contact()]


def _save(figure: Figure, name: str) -> list[Path]:
    paths = [FOLDER / f"{name}.{kind}" for kind in ("svg", "png")]
    figure.savefig(paths[0], metadata={"Date": None})
    figure.savefig(paths[1], dpi=130)
    return paths


def _seen(verdicts: Sequence[Verdict], name: str, object_name: str | None = None) -> list[float]:
    return [
        v.seen_m[name]
        for v in verdicts
        if name in v.seen_m and (object_name is None or v.event.object == object_name)
    ]


def _distances(study: Study) -> list[Path]:
    """Share of approaches in which the object has been seen, by distance; one panel for each object."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(11, 6), sharex=True, sharey=True, layout="constrained")
    grid_cm = np.linspace(0.0, 5.6, 300)
    for panel, name in zip(axes.flat, SIX, strict=True):
        for detector, colour in COLOURS.items():
            seen_cm = 100.0 * np.array(_seen(study.matched, detector, name))
            share = [100.0 * float(np.mean(seen_cm >= cm)) for cm in grid_cm]
            panel.plot(grid_cm, share, color=colour, label=detector)
        panel.set_title(name.replace("_", " "), fontsize=10)
        panel.invert_xaxis()
        panel.grid(alpha=0.3)
    axes[0, 0].invert_xaxis()
    axes[0, 0].set_xlim(5.6, 0.0)
    for panel in axes[1]:
        panel.set_xlabel("distance, cm")
    for panel in axes[:, 0]:
        panel.set_ylabel("seen by then, %")
    axes[0, 0].legend(fontsize=8)
    figure.suptitle(f"Simulated, echo {study.weaker_db} dB below the plant's, TNR 95.3 %", fontsize=11)
    paths = _save(figure, "pretouch_distance")
    plt.close(figure)
    return paths


def _strengths(study: Study) -> list[Path]:
    """Rate and median distance against the strength of the echo."""
    import matplotlib.pyplot as plt

    figure, (rates, distances) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    steps = list(study.sweep)
    for detector in (MATCHED, "pretouch"):
        seen = [np.array(_seen(study.sweep[db], detector)) for db in steps]
        colour = COLOURS[detector]
        rates.plot(
            steps, [100.0 * float(np.mean(np.isfinite(s))) for s in seen], "o-", color=colour, label=detector
        )
        medians = [100.0 * float(np.nanmedian(s)) if np.isfinite(s).any() else math.nan for s in seen]
        distances.plot(steps, medians, "o-", color=colour, label=detector)
    rates.axhline(100.0 * PAPER_TPR, color="#adb5bd", linestyle="--", label="the paper's printed rate")
    for panel in (rates, distances):
        panel.axvline(study.weaker_db, color="#adb5bd", linestyle=":")
        panel.set_xlabel("echo below the plant's, dB")
        panel.grid(alpha=0.3)
    rates.set_ylabel("TPR at TNR 95.3 %, %")
    distances.set_ylabel("median distance of those seen, cm")
    rates.legend(fontsize=8)
    paths = _save(figure, "pretouch_strength")
    plt.close(figure)
    return paths


def _contact() -> list[Path]:
    """One touch: the envelope, the z-score of two windows, and what our detector says."""
    import matplotlib.pyplot as plt

    heard = passage(Event(SEED_MATCH, 1, "touch", "mug", "normal", 0.01))
    values = np.column_stack([heard.z.real, heard.z.imag])
    assert heard.touched is not None
    assert heard.released is not None
    figure, (envelope, scores) = plt.subplots(2, 1, figsize=(10, 6), sharex=True, layout="constrained")
    few = slice(None, None, 4)  # enough for the eye
    envelope.plot(heard.times_s[few], 100.0 * values[few, 0], color="#1d3557", linewidth=0.8, label="I")
    envelope.plot(heard.times_s[few], 100.0 * values[few, 1], color="#e76f51", linewidth=0.8, label="Q")
    for window_s, colour in ((1.0, "#457b9d"), (5.0, "#a8dadc")):
        judge = LevelPaperDetector("paper", LevelPaperSettings(window_s=window_s))
        trace = judge.statistic(values, 1000.0)
        scores.plot(
            heard.times_s[few],
            trace[few],
            color=colour,
            linewidth=0.8,
            label=f"z-score, window of {window_s:g} s",
        )
    ours = LevelDetector("ours", LevelSettings())
    for event in ours.push(heard.block):
        for panel in (envelope, scores):
            panel.axvline(event.t_s, color="#c1121f", linestyle="--", linewidth=1.0)
        scores.annotate(
            type(event).__name__,
            (event.t_s, 0.97),
            xycoords=("data", "axes fraction"),
            rotation=90,
            va="top",
            ha="right",
            fontsize=8,
            color="#c1121f",
        )
    for panel in (envelope, scores):
        panel.axvspan(
            heard.times_s[heard.touched],
            heard.times_s[heard.released],
            color="#ffe8d6",
            zorder=0,
            label="contact (truth)",
        )
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8, loc="upper right")
    envelope.set_ylabel("envelope, % of full scale")
    scores.set_ylabel("|z|")
    scores.set_xlabel("time, s")
    envelope.set_title("A touch of the mug, simulated; dashed: what our level detector says", fontsize=10)
    paths = _save(figure, "pretouch_contact")
    plt.close(figure)
    return paths
