"""The part of the page on B7: the angle of the contact against the true angle, beside the paper's Fig. 11."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.measures.pointer import COLUMNS, Touch, touches_of
from controller.reports.counts import Row, Trials
from controller.reports.figures import FAINT, FALSE, GOOD, PAPER, Figures
from controller.reports.run_account import recorded, setting_of
from controller.reports.section import Kind, Section, kind_of, measured, told
from controller.scales import scale_of

if TYPE_CHECKING:
    from controller.recording.reader import Run

DEGREES = scale_of("angle_rad").factor


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and figure of all sweeps of some runs on one kind of bench; one that was broken off is not among them."""
    rows = Trials(
        row for run in runs for row in Trials.of([run]).known("theta_rms_rad") if run.succeeded(row)
    )
    factors = list(dict.fromkeys(name for run in runs for name in run.factors))
    sweeps: dict[tuple[Any, ...], list[Sequence[Touch]]] = {}
    for row, touches in touched(runs):
        sweeps.setdefault(tuple(row.get(name) for name in factors), []).append(touches)
    angles_rad = setting_of(runs[0], "behavior", "angles_rad") or ()
    square = sum(row["touches"] * row["theta_rms_rad"] ** 2 for row in rows)
    content = {
        "kind": kind_of(runs, Kind.ASSUMED),
        "ends": (min(angles_rad, default=math.nan), max(angles_rad, default=math.nan)),
        "rms": math.sqrt(square / rows.total("touches")) if rows else math.nan,
        "worst": max(rows, key=lambda row: float(row["theta_max_rad"]), default=None),
        "degrees": DEGREES,
        "errors": measured(rows.by(*factors).values(), factors, COLUMNS),
        "figure_11": _draw(figures, sweeps) if sweeps else "",
    }
    heading = "Angle of the contact (B7)"
    return told(runs, heading, "pointer", content, paper="fernandez", shows_trials=not sweeps)


def touched(runs: Sequence[Run]) -> Iterator[tuple[Row, Sequence[Touch]]]:
    """The touches of each sweep that ended as meant, and its row."""
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
            yield row, touches


def _draw(figures: Figures, sweeps: Mapping[Any, Sequence[Sequence[Touch]]]) -> str:
    """Fig. 11: the measured angle against the true one, and its error; a column for each force."""
    layout: Any = {"sharex": True, "sharey": "row", "height_ratios": [1.4, 1.0]}
    with figures.figure(4.1, rows=2, columns=len(sweeps), **layout) as drawing:
        for above, below, trials in zip(
            drawing.axes, drawing.axes[len(sweeps) :], sweeps.values(), strict=False
        ):
            listed = [touch for touches in trials for touch in touches]
            angles = [touch.true_rad * DEGREES for touch in listed]
            ends = min(angles), max(angles)
            above.plot(ends, ends, color=PAPER, lw=0.9, ls=(0, (4, 3)), zorder=0)
            below.axhline(0.0, color=FAINT, lw=0.7, zorder=0)
            looks = (("up", GOOD, "^", "ascending"), ("down", FALSE, "v", "descending"))
            for going, color, marker, label in looks:
                for index, touches in enumerate(trials):
                    own = [touch for touch in touches if touch.going == going]
                    true = np.array([touch.true_rad * DEGREES for touch in own])
                    error = np.array([touch.error_rad * DEGREES for touch in own])
                    look: Any = {"color": color, "marker": marker, "ms": 3.3}
                    above.plot(true, true + error, ls="", label=label if index == 0 else None, **look)
                    below.plot(true, error, lw=0.8, **look)
            above.set_title(f"{np.mean([touch.force_n for touch in listed]):.1f} N")
            above.set_yticks([-90, -45, 0, 45, 90])
            below.set(xlabel="true angle (°)", xticks=[-90, -45, 0, 45, 90])
        drawing.axes[0].set_ylabel("measured angle, θ (°)")
        drawing.axes[len(sweeps)].set_ylabel("error (°)")
        drawing.axes[0].legend(loc="upper left")
        return drawing.save("fig_11_theta")
