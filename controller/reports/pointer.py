"""The part of the page on B7: the angle of the contact against the true angle, beside the paper's Fig. 2 and 11."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from controller.measures.touches import Errors, Touch, errors_of, touches_of
from controller.reports.fernandez import CITATION
from controller.reports.figures import FAINT, FALSE, GOOD, OURS, PAPER, Figures
from controller.reports.run_account import acting_of, setting_of
from controller.reports.section import Block, Figure, Kind, Notes, Result, Section
from controller.reports.section_texts import SectionTexts
from controller.reports.text import number, signed
from controller.scales import scale_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from controller.recording.reader import Run
    from controller.recording.series import TrialRecording

DEGREES = scale_of("angle_rad").factor

SAME_FORCE = 0.05
"""Trials whose thresholds differ by less than this share were touched with the same force."""

TEXTS = SectionTexts("pointer")


@dataclass(frozen=True, slots=True)
class PointerSweep:
    """All touches of one force.

    Attributes:
        force_n: Threshold that ended the descents; NaN where the profile has none.
        trials: The touches of each trial.
        errors: Over all of them; the hysteresis is the largest of any trial.
    """

    force_n: float
    trials: Sequence[Sequence[Touch]]
    errors: Errors

    @property
    def touches(self) -> Sequence[Touch]:
        """All of them."""
        return [touch for touches in self.trials for touch in touches]

    @property
    def pressed_n(self) -> float:
        """Mean normal force."""
        return float(np.mean([touch.force_n for touch in self.touches]))


def read_sweeps(runs: Sequence[Run]) -> list[PointerSweep]:
    """The sweeps of some runs, from the least force to the largest."""
    found: dict[float, list[Sequence[Touch]]] = {}
    for run in runs:
        for row in run.trials:
            trial = int(row["trial"] or 0)
            recording = run.readable(trial)
            touches = _touches(run, trial, recording) if recording else []
            if touches:
                force_n = _force_n(run, row)
                same = next(
                    (known for known in found if abs(known - force_n) <= SAME_FORCE * force_n), force_n
                )
                found.setdefault(same, []).append(touches)
    return [_sweep(force_n, trials) for force_n, trials in sorted(found.items())]


def _sweep(force_n: float, trials: Sequence[Sequence[Touch]]) -> PointerSweep:
    whole = errors_of([touch for touches in trials for touch in touches])
    loops = [errors_of(touches).hysteresis for touches in trials]
    known = [width for width in loops if not math.isnan(width)]
    return PointerSweep(force_n, trials, whole._replace(hysteresis=max(known, default=math.nan)))


def _force_n(run: Run, row: Mapping[str, Any]) -> float:
    detector = acting_of(run)
    value = row.get(f"detectors.{detector}.threshold")
    if value is None:
        value = setting_of(run, "detectors", detector, "threshold")
    return float(value) if isinstance(value, int | float) else math.nan


def _touches(run: Run, trial: int, recording: TrialRecording) -> list[Touch]:
    own = [event for event in run.events if event["trial"] == trial]
    visits = [(str(event["next"]), float(event["t_s"])) for event in own if event["next"] != event["state"]]
    return touches_of(
        recording,
        visits,
        forces_stream=str(setting_of(run, "behavior", "forces_stream")),
        pose_stream=str(setting_of(run, "behavior", "pose_stream")),
        angles=len(setting_of(run, "behavior", "angles_rad") or ()),
        broken_s=frozenset(float(event["t_s"]) for event in own if event["event"] == "Resumed"),
    )


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Table and figures of all sweeps of some runs on one kind of bench."""
    sweeps = read_sweeps(runs)
    simulated = all(run.simulated for run in runs)
    emulated = any(run.manifest.get("bench") == "emulated" for run in runs)
    body: list[Block] = [TEXTS.text("intro")]
    if sweeps:
        body += [
            TEXTS.table("errors", map(_row, sweeps)),
            Figure(Markup(_draw_pointers(figures, sweeps)), TEXTS.sentence("figure_2")),
            Figure(Markup(_draw_errors(figures, sweeps)), TEXTS.sentence("figure_11")),
            Notes([_note(sweep) for sweep in sweeps]),
        ]
    else:
        body.append(TEXTS.text("nothing", trials=sum(len(run.trials) for run in runs)))
    ours = {"arm": True, "simulated": simulated, "emulated": emulated}
    return Section(
        title="Angle of the contact (B7)",
        body=body,
        citation=CITATION,
        summary=[Result(Kind.ASSUMED if simulated else Kind.MEASURED, _sentence(sweeps))] if sweeps else [],
        not_the_papers=[TEXTS.sentence(name) for name, holds in ours.items() if holds],
    )


def _range(sweeps: Sequence[PointerSweep]) -> tuple[float, float]:
    angles = [touch.true_rad for sweep in sweeps for touch in sweep.touches]
    return min(angles), max(angles)


def _sentence(sweeps: Sequence[PointerSweep]) -> str:
    low, high = _range(sweeps)
    worst = max(sweeps, key=lambda sweep: sweep.errors.largest)
    return TEXTS.sentence(
        "summary",
        low=signed(low * DEGREES, 0),
        high=signed(high * DEGREES, 0),
        rms=number(errors_of([touch for sweep in sweeps for touch in sweep.touches]).rms * DEGREES, 2),
        largest=number(worst.errors.largest * DEGREES, 2),
        force=number(worst.pressed_n, 1),
    )


def _row(sweep: PointerSweep) -> dict[str, Any]:
    return {f"{name}_rad": value for name, value in sweep.errors._asdict().items()} | {
        "force_n": sweep.pressed_n,
        "touches": len(sweep.touches),
        "bias_rad": signed(sweep.errors.bias, 2, DEGREES),
        "spread_rad": float(np.mean([touch.spread_rad for touch in sweep.touches])),
    }


def _note(sweep: PointerSweep) -> str:
    worst = max(sweep.touches, key=lambda touch: abs(touch.error_rad))
    middle = [touch for touch in sweep.touches if abs(touch.true_rad) <= 1.0]
    rest = [touch for touch in sweep.touches if abs(touch.true_rad) > 1.0]
    return TEXTS.sentence(
        "worst",
        force=number(sweep.pressed_n, 1),
        error=signed(worst.error_rad * DEGREES, 2),
        at=signed(worst.true_rad * DEGREES, 0),
        going="ascending" if worst.going == "up" else "descending",
        within=number(errors_of(middle).rms * DEGREES, 2),
        beyond=number(errors_of(rest).rms * DEGREES, 2),
    )


# --- figures -----------------------------------------------------------------------------------------


def _draw_pointers(figures: Figures, sweeps: Sequence[PointerSweep]) -> str:
    with figures.figure(1.9, columns=len(sweeps), subplot_kw={"projection": "polar"}) as drawing:
        for axes, sweep in zip(drawing.axes, sweeps, strict=True):
            polar: Any = axes
            polar.set_theta_zero_location("S")
            polar.set_thetamin(-95)
            polar.set_thetamax(95)
            for touch in sweep.trials[0]:
                polar.plot(
                    [touch.true_rad] * 2, [0.0, touch.force_n], color=FAINT, lw=3.4, solid_capstyle="butt"
                )
            for touch in sweep.trials[0]:
                polar.plot([touch.measured_rad] * 2, [0.0, touch.force_n], color=OURS, lw=0.8)
                polar.plot([touch.measured_rad], [touch.force_n], color=OURS, marker="o", ms=2.0)
            angles = [-90, -60, -30, 0, 30, 60, 90]
            polar.set_thetagrids(angles, [f"{signed(angle, 0)}°" for angle in angles])
            polar.set_rmax(1.08 * max(touch.force_n for touch in sweep.trials[0]))
            polar.set_rticks([])
            polar.grid(color=FAINT, lw=0.4)
            polar.set_title(f"{sweep.pressed_n:.1f} N", loc="center", pad=-16.0)
        return drawing.save("fig_2_pointers")


def _draw_errors(figures: Figures, sweeps: Sequence[PointerSweep]) -> str:
    with figures.figure(
        4.1, rows=2, columns=len(sweeps), sharex=True, sharey="row", height_ratios=[1.4, 1.0]
    ) as drawing:
        for column, sweep in enumerate(sweeps):
            above, below = drawing.axes[column], drawing.axes[len(sweeps) + column]
            low, high = (angle * DEGREES for angle in _range([sweep]))
            above.plot([low, high], [low, high], color=PAPER, lw=0.9, ls=(0, (4, 3)), zorder=0)
            below.axhline(0.0, color=FAINT, lw=0.7, zorder=0)
            for going, color, marker, label in (
                ("up", GOOD, "^", "ascending"),
                ("down", FALSE, "v", "descending"),
            ):
                _draw_direction(above, below, sweep, going, color=color, marker=marker, label=label)
            above.set_title(f"{sweep.pressed_n:.1f} N")
            below.set_xlabel("true angle (°)")
            below.set_xticks([-90, -45, 0, 45, 90])
            above.set_yticks([-90, -45, 0, 45, 90])
        drawing.axes[0].set_ylabel("measured angle, θ (°)")
        drawing.axes[len(sweeps)].set_ylabel("error (°)")
        drawing.axes[0].legend(loc="upper left")
        return drawing.save("fig_11_theta")


def _draw_direction(
    above: Axes, below: Axes, sweep: PointerSweep, going: str, *, color: str, marker: str, label: str
) -> None:
    for index, touches in enumerate(sweep.trials):
        own = [touch for touch in touches if touch.going == going]
        true = [touch.true_rad * DEGREES for touch in own]
        name = label if index == 0 else None
        measured = [(touch.true_rad + touch.error_rad) * DEGREES for touch in own]
        above.plot(true, measured, ls="", color=color, marker=marker, ms=3.4, label=name)
        below.plot(
            true, [touch.error_rad * DEGREES for touch in own], color=color, marker=marker, ms=3.2, lw=0.8
        )
