"""The part of the page on B7: the angle of the contact against the true angle, beside the paper's Fig. 11."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.measures.pointer import Errors, Touch, errors_of, touches_of
from controller.reports.counts import Row, under
from controller.reports.figures import FAINT, FALSE, GOOD, PAPER, Figures
from controller.reports.run_account import acting_of, recorded, setting_of
from controller.reports.section import Kind, Section, kind_of, told
from controller.scales import scale_of

if TYPE_CHECKING:
    from controller.recording.reader import Run

DEGREES = scale_of("angle_rad").factor

SAME_FORCE = 0.05
"""Trials whose thresholds differ by less than this share were touched with the same force."""


class PointerSweep:
    """All touches of one force.

    Args:
        force_n: Threshold that ended the descents; NaN where the profile has none.
        trials: The touches of each trial.

    Attributes:
        errors: Over all touches; the hysteresis is the largest of any trial.
        pressed_n: Mean normal force.
        ends: Least and largest true angle, °.
        worst: The touch of the largest error.
    """

    def __init__(self, force_n: float, trials: Sequence[Sequence[Touch]]) -> None:
        self.force_n, self.trials = force_n, trials
        self.touches = [touch for touches in trials for touch in touches]
        self.pressed_n = float(np.mean([touch.force_n for touch in self.touches]))
        loops = [width for touches in trials if not math.isnan(width := errors_of(touches).hysteresis)]
        self.errors = errors_of(self.touches)._replace(hysteresis=max(loops, default=math.nan))
        angles = [touch.true_rad * DEGREES for touch in self.touches]
        self.ends = min(angles), max(angles)
        self.worst = max(self.touches, key=lambda touch: abs(touch.error_rad))

    def rms(self, middle: bool) -> float:
        """Root mean square error within a radian of the middle, or beyond, rad."""
        return errors_of([each for each in self.touches if (abs(each.true_rad) <= 1.0) == middle]).rms


def read_sweeps(runs: Sequence[Run]) -> list[PointerSweep]:
    """The sweeps of some runs that ended as meant, from the least force to the largest."""
    found: dict[float, list[Sequence[Touch]]] = {}
    for run, row, recording in recorded(runs):
        if not run.succeeded(row):
            continue
        own = run.events_of(row["trial"])
        touches = touches_of(
            recording,
            [(str(event["next"]), float(event["t_s"])) for event in own if event["next"] != event["state"]],
            forces_stream=str(setting_of(run, "behavior", "forces_stream")),
            pose_stream=str(setting_of(run, "behavior", "pose_stream")),
            angles=len(setting_of(run, "behavior", "angles_rad") or ()),
            broken_s=frozenset(float(event["t_s"]) for event in own if event["event"] == "Resumed"),
        )
        if touches:
            path = "detectors", acting_of(run), "threshold"
            own_n = row.get(".".join(path))
            value = setting_of(run, *path) if own_n is None else own_n
            force_n = float(value) if isinstance(value, int | float) else math.nan
            same = next((known for known in found if abs(known - force_n) <= SAME_FORCE * force_n), force_n)
            found.setdefault(same, []).append(touches)
    return [PointerSweep(force_n, trials) for force_n, trials in sorted(found.items())]


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and figure of all sweeps of some runs on one kind of bench."""
    sweeps, errors = read_sweeps(runs), []
    for sweep in sweeps:
        line: Row = {**under("force_n", sweep.pressed_n, digits=2), "touches": len(sweep.touches)}
        for name in Errors._fields:
            cell = under(f"{name}_rad", getattr(sweep.errors, name), digits=2, sign=name == "bias")
            line = {**line, **cell}
        spread_rad = float(np.mean([touch.spread_rad for touch in sweep.touches]))
        errors.append({**line, **under("spread_rad", spread_rad, "one sample", 2)})
    content = {
        "kind": kind_of(runs, Kind.ASSUMED),
        "sweeps": sweeps,
        "rms": errors_of([touch for sweep in sweeps for touch in sweep.touches]).rms,
        "worst": max(sweeps, key=lambda sweep: sweep.errors.largest, default=None),
        "degrees": DEGREES,
        "errors": errors,
        "figure_11": _draw(figures, sweeps) if sweeps else "",
    }
    heading = "Angle of the contact (B7)"
    return told(runs, heading, "pointer", content, paper="fernandez", shows_trials=not sweeps)


def _draw(figures: Figures, sweeps: Sequence[PointerSweep]) -> str:
    """Fig. 11: the measured angle against the true one, and its error."""
    layout: Any = {"sharex": True, "sharey": "row", "height_ratios": [1.4, 1.0]}
    with figures.figure(4.1, rows=2, columns=len(sweeps), **layout) as drawing:
        for above, below, sweep in zip(drawing.axes, drawing.axes[len(sweeps) :], sweeps, strict=False):
            above.plot(sweep.ends, sweep.ends, color=PAPER, lw=0.9, ls=(0, (4, 3)), zorder=0)
            below.axhline(0.0, color=FAINT, lw=0.7, zorder=0)
            looks = (("up", GOOD, "^", "ascending"), ("down", FALSE, "v", "descending"))
            for going, color, marker, label in looks:
                for index, touches in enumerate(sweep.trials):
                    own = [touch for touch in touches if touch.going == going]
                    true = np.array([touch.true_rad * DEGREES for touch in own])
                    error = np.array([touch.error_rad * DEGREES for touch in own])
                    look: Any = {"color": color, "marker": marker, "ms": 3.3}
                    above.plot(true, true + error, ls="", label=label if index == 0 else None, **look)
                    below.plot(true, error, lw=0.8, **look)
            above.set_title(f"{sweep.pressed_n:.1f} N")
            above.set_yticks([-90, -45, 0, 45, 90])
            below.set(xlabel="true angle (°)", xticks=[-90, -45, 0, 45, 90])
        drawing.axes[0].set_ylabel("measured angle, θ (°)")
        drawing.axes[len(sweeps)].set_ylabel("error (°)")
        drawing.axes[0].legend(loc="upper left")
        return drawing.save("fig_11_theta")
