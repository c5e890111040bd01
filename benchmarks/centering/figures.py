"""The histogram of Fig. 8c: the paper's algorithm and ours, both speeds, fingers alike and not."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.centering.scoring import clean
from benchmarks.centering.study import MISMATCH_DB, SPEEDS_M_S

if TYPE_CHECKING:
    from benchmarks.centering.report import Study

FOLDER = Path(__file__).resolve().parents[1] / "figures"

COLOURS = {0.01: "#457b9d", 0.03: "#e9a03b"}

COLUMNS = (
    ("paper", 0.0, "the paper's, fingers alike"),
    ("paper", MISMATCH_DB, f"the paper's, {MISMATCH_DB:g} dB apart"),
    ("ours", 0.0, "ours, fingers alike"),
    ("ours", MISMATCH_DB, f"ours, {MISMATCH_DB:g} dB apart"),
    ("ours, gains calibrated", MISMATCH_DB, f"ours, {MISMATCH_DB:g} dB apart, calibrated"),
)


def draw(study: Study) -> list[Path]:
    """The figure, as SVG and PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "touchbench"
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(len(COLUMNS), 1, figsize=(8, 9), sharex=True, layout="constrained")
    edges_mm = np.arange(-6.0, 6.01, 0.1)
    for panel, (name, mismatch_db, title) in zip(panels, COLUMNS, strict=True):
        for speed_m_s in SPEEDS_M_S:
            repeats = study.main[name, mismatch_db, speed_m_s]
            every = [one for repeat in repeats for one in repeat]
            errors_mm = 1e3 * np.array([one.error_m for one in clean(every)])
            panel.hist(
                errors_mm,
                edges_mm,
                weights=np.full(len(errors_mm), 100.0 / len(every)),
                color=COLOURS[speed_m_s],
                alpha=0.6,
                label=f"{speed_m_s:g} m/s",
            )
        panel.axvline(0.0, color="0.3", linewidth=0.8)
        for limit_mm in (-2.5, 2.5):
            panel.axvline(limit_mm, color="0.3", linewidth=0.8, linestyle=":")
        panel.set_title(title, fontsize=10)
        panel.set_ylabel("searches, %")
        panel.grid(alpha=0.3)
    panels[0].legend(fontsize=8)
    panels[-1].set_xlabel("error, mm (dotted: what is aimed at; the paper's own worst is 8 mm)")
    panels[-1].set_xlim(-6.0, 6.0)
    times = study.size.repeats
    figure.suptitle(f"Simulated: centering on the pipe, {times} times 85 searches", fontsize=11)
    FOLDER.mkdir(exist_ok=True)
    paths = [FOLDER / f"centering.{kind}" for kind in ("svg", "png")]
    figure.savefig(paths[0], metadata={"Date": None})
    figure.savefig(paths[1], dpi=130)
    plt.close(figure)
    return paths
