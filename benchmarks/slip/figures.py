"""Two figures: what the detectors hear and make of it, and how late they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.slip import scenes
from benchmarks.slip.study import SEED_SLIP, Result, detectors
from controller.reports.slip_verdicts import VERDICTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parents[1] / "figures"

COLOURS = {"slip.paper": "#457b9d", "slip": "#c1121f"}
"""Of the two detectors."""

SENSORS = ("fingertip", "flexible_finger", "barrett_finger")
"""Those that any detector can use."""


def draw(results: Sequence[Result]) -> list[Path]:
    """Both figures, as SVG and PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "touchbench"
    FOLDER.mkdir(exist_ok=True)
    return [*_delays(results), *_example(results)]


def _save(figure: Figure, name: str) -> list[Path]:
    paths = [FOLDER / f"{name}.{kind}" for kind in ("svg", "png")]
    figure.savefig(paths[0], metadata={"Date": None})
    figure.savefig(paths[1], dpi=130)
    return paths


def _found(results: Sequence[Result], sensor: str, nuisance: str, detector: str) -> Result:
    """The one result on structures that are off."""
    wanted = (sensor, nuisance, detector, "off")
    return next(r for r in results if (r.sensor, r.nuisance, r.detector, r.population) == wanted)


def _delays(results: Sequence[Result]) -> list[Path]:
    """Share of slips reported after a time, one panel per sensor and nuisance."""
    import matplotlib.pyplot as plt

    nuisances = ("clean", "ramp", "bumps", "loads", "rough")
    figure, axes = plt.subplots(
        len(SENSORS), len(nuisances), figsize=(13, 6.5), sharex=True, sharey=True, layout="constrained"
    )
    for row, sensor in zip(axes, SENSORS, strict=True):
        for panel, nuisance in zip(row, nuisances, strict=True):
            for name, colour in COLOURS.items():
                delays_s = np.sort(_found(results, sensor, nuisance, name).score.delays_s)
                share = np.arange(1, delays_s.size + 1) / max(1, delays_s.size)
                seen = np.isfinite(delays_s)
                x = np.r_[1e-3, np.maximum(1e-3, delays_s[seen]), VERDICTS["missed_after_s"]]
                y = np.r_[0.0, share[seen], share[seen][-1] if seen.any() else 0.0]
                panel.step(1e3 * x, 100 * y, where="post", color=colour, label=name, linewidth=1.8)
            panel.set_xscale("log")
            panel.grid(alpha=0.3, linewidth=0.5)
            if sensor == SENSORS[0]:
                panel.set_title(nuisance)
        row[0].set_ylabel(f"{sensor.replace('_', ' ')}\nslips reported, %")
    for panel in axes[-1]:
        panel.set_xlabel("after the contact's first motion, ms")
    axes[0, 0].legend(loc="lower right", fontsize=8)
    figure.suptitle("Simulated slips, structures off by 30 % and a factor of 3: one false alarm an hour each")
    saved = _save(figure, "slip_delays")
    plt.close(figure)
    return saved


def _example(results: Sequence[Result]) -> list[Path]:
    """One slip of the fingertip among bumps: signal and both statistics against their thresholds."""
    import matplotlib.pyplot as plt

    plant = scenes.sensor("fingertip", "bumps", *scenes.OFF[0])
    trials = [trial for trial in scenes.slips(plant, 20, SEED_SLIP) if trial.onset is not None]
    # the liveliest second before the slip: one without a bump would show nothing
    trial = max(
        trials, key=lambda each: float(np.ptp(np.diff(each.values[each.start - 1200 : each.start, 0])))
    )
    t_s = np.arange(1, len(trial.values) + 1) / plant.rate_hz
    figure, axes = plt.subplots(3, 1, figsize=(9, 6), sharex=True, layout="constrained")
    axes[0].plot(t_s, trial.values[:, 0], color="black", linewidth=0.6)
    axes[0].set_ylabel("Ft bridge, V")
    for panel, (name, judge) in zip(axes[1:], detectors("fingertip").items(), strict=True):
        statistic = judge.statistic(trial.values, plant.rate_hz)
        known = np.isfinite(statistic)
        threshold = _found(results, "fingertip", "bumps", name).calibration.threshold
        panel.plot(t_s[known], statistic[known], color=COLOURS[name], linewidth=1.0, drawstyle="steps-post")
        panel.axhline(threshold, color="black", linestyle="--", linewidth=0.8)
        panel.set_ylabel("evidence, nats" if name == "slip" else "peak × frequency, V² Hz")
        panel.set_title(
            f"{name}: one false alarm an hour of bumps at {threshold:.3g}", fontsize=9, loc="left"
        )
        panel.set_ylim(0.0, 4.0 * threshold if name == "slip" else 1.2 * threshold)
    for panel in axes:
        panel.axvspan(t_s[trial.onset], t_s[-1], color="#f4a261", alpha=0.2, linewidth=0)
    axes[2].set_xlabel("s")
    axes[2].set_xlim(t_s[trial.start] - 1.3, t_s[trial.onset] + 0.6)
    figure.suptitle("A simulated slip (shaded) among bumps")
    saved = _save(figure, "slip_example")
    plt.close(figure)
    return saved
