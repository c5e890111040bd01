"""The figures on the benchmarks' pages, from results/*.json and a few passages: `python -m benchmarks.drawings`.

Colours and markers are the reports': ours, the paper's, rivals, the truth or a bound (`controller.reports.figures`).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from benchmarks.pretouch.scenes import SPEEDS_M_S, Event, PassageRecord, passage, template
from benchmarks.results import FOLDER
from controller.detectors.level import LevelDetector, LevelPaperDetector, LevelPaperSettings, LevelSettings
from controller.reports.figures import FAINT, INK, LOOKS, OURS, PAPER, RIVAL, TRUTH, Drawing, Figures
from drivers.mock.physics.aura_objects import OBJECTS, SIDES, SIX

OUT = FOLDER.parent / "figures"

FLOOR = 2e-16
"""Errors below this are drawn here: the spacing of doubles at 1."""

SEEN = {"pretouch": LOOKS["ours"], "pretouch.paper, 0.5 s": LOOKS["paper"]}
"""Detectors of pre-touch, and how each is drawn."""

SEED = 7
"""Of the passages that are shown."""


def main(names: Sequence[str]) -> None:
    """Draw those of these names, or all."""
    for figure in (physics, objects, strengths, centering, sides, undulations, touch, campaigns):
        if names and figure.__name__ not in names:
            continue
        with TemporaryDirectory() as folder:
            figures = Figures(Path(folder), simulated=figure not in (physics, campaigns), also=("png",))
            name = figure(figures)
            (OUT / f"{name}.png").write_bytes((Path(folder) / f"{name}.png").read_bytes())


def results(name: str) -> Any:
    """A benchmark's saved figures."""
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def saved(drawing: Drawing, name: str) -> str:
    """Write it under a name, which is returned."""
    drawing.save(name)
    return name


def physics(figures: Figures) -> str:
    """Run time against error, loop closed, a panel a scene; hollow where an event was missed or invented."""
    points = [point for point in results("physics")["points"] if point["closed"]]
    rivals = sorted({point["solver"] for point in points} - {"exact pieces"})
    shades = np.linspace(0.0, 0.75, len(rivals))
    with figures.figure(3.6, columns=3, sharex=True, sharey=True) as drawing:
        for axes, scene in zip(drawing.axes, ("free", "bouncing", "full contact"), strict=True):
            for place, solver in enumerate(["exact pieces", *rivals]):
                look = LOOKS["ours"] if not place else {"color": mixed(RIVAL, shades[place - 1])}
                here = [point for point in points if (point["scene"], point["solver"]) == (scene, solver)]
                whole = [not point["off"]["missed"] and not point["off"]["invented"] for point in here]
                look = {"marker": "o^v<>sDPXhd"[place], "ms": 4.0 if place else 7.0, **look}
                errors = [max(point["off"]["theta_rad"], point["off"]["event_s"], FLOOR) for point in here]
                costs = [point["us_per_s"] for point in here]
                axes.plot(errors, costs, **look | {"marker": ""}, lw=0.9)
                for error, cost, full in zip(errors, costs, whole, strict=True):
                    axes.plot(error, cost, **look, mfc=look["color"] if full else "white")
                axes.plot([], [], **look, label=f"{solver} (ours)" if not place else solver)
            axes.axhline(1e6, color=FAINT, lw=0.8, ls=(0, (1, 2)))
            axes.set(xscale="log", yscale="log", title=scene, xlabel="error of events (s), angle (rad)")
        drawing.axes[0].text(FLOOR, 1.1e6, "real time", color=PAPER, fontsize=8, va="bottom")
        drawing.axes[0].set_ylabel("processor time a simulated second (µs)")
        below(drawing, 4)
        return saved(drawing, "physics_closed_loop")


def mixed(colour: str, share: float) -> tuple[float, ...]:
    """A colour with a share of ink in it: rivals have one hue, and differ by lightness and marker."""
    from matplotlib.colors import to_rgb

    return tuple((1.0 - share) * a + share * b for a, b in zip(to_rgb(colour), to_rgb(INK), strict=True))


def below(drawing: Drawing, columns: int) -> None:
    """One legend for all panels."""
    handles, names = drawing.axes[0].get_legend_handles_labels()
    drawing.figure.legend(handles, names, loc="outside lower center", ncols=columns)


def objects(figures: Figures) -> str:
    """Of each object: share seen with its 95 % interval, and from how far."""
    study = results("pretouch")
    found = study["matched"]["objects"]
    with figures.figure(2.9, columns=2, sharey=True) as drawing:
        for place, name in enumerate(reversed(SIX)):
            scores(drawing.axes, place, found[name]["pretouch"], across=True)
        n = {score["tpr"]["of"] for each in found.values() for score in each["pretouch"].values()}
        drawing.axes[0].set_yticks(range(len(SIX)), [name.replace("_", " ") for name in reversed(SIX)])
        drawing.axes[0].set_xlabel(f"seen (%), 95 % interval, n = {', '.join(map(str, sorted(n)))} each")
        drawing.axes[1].set_xlabel("distance of those seen (cm): median, p10 to p90")
        drawing.axes[1].set_xlim(left=0.0)
        below(drawing, 2)
        return saved(drawing, "pretouch_distance")


def strengths(figures: Figures) -> str:
    """The same against the strength of the echo."""
    study = results("pretouch")
    with figures.figure(2.9, columns=2) as drawing:
        for weaker_db, found in study["sweep"].items():
            scores(drawing.axes, float(weaker_db), found, across=False)
        n = {score["tpr"]["of"] for found in study["sweep"].values() for score in found.values()}
        for axes in drawing.axes:
            axes.axvline(study["weaker_db"], color=FAINT, lw=0.8, ls=(0, (1, 2)))
            axes.set_xlabel("echo below the plant's (dB)")
            axes.set_ylim(bottom=0.0)
        drawing.axes[0].set_ylabel(f"seen (%), 95 % interval, n = {', '.join(map(str, sorted(n)))} each")
        drawing.axes[1].set_ylabel("distance (cm): median, p10 to p90")
        below(drawing, 2)
        return saved(drawing, "pretouch_strength")


def scores(panels: Sequence[Axes], place: float, found: Mapping[str, Any], *, across: bool) -> None:
    """Rate and distance of each detector at a place, slightly offset."""
    step = 0.12 if across else 0.5
    for shift, (name, look) in zip((step, -step), SEEN.items(), strict=True):
        rate, far = found[name]["tpr"], found[name]["distance_m"]
        shown = ((rate, ("share", "low", "high")), (far, ("median", "p10", "p90")))
        for axes, (score, keys) in zip(panels, shown, strict=True):
            middle, low, high = (100.0 * (score[key] if score[key] is not None else np.nan) for key in keys)
            spread = [[middle - low], [high - middle]]
            label = name if place == 0 else None
            if across:
                axes.errorbar(middle, place + shift, xerr=spread, ls="", label=label, clip_on=False, **look)
            else:
                axes.errorbar(place + shift, middle, yerr=spread, ls="", label=label, clip_on=False, **look)


def centering(figures: Figures) -> str:
    """Mean with standard deviation, and the worst of 85 with its 95 % interval, of each way at each speed."""
    rows = results("centering")["eighty_five"]
    with figures.figure(2.9, columns=2, sharey=True) as drawing:
        mean, worst = drawing.axes
        names = [
            f"{row['method']}, {row['mismatch_db']:g} dB, {100.0 * row['speed_m_s']:g} cm/s" for row in rows
        ]
        for place, row in enumerate(rows):
            look = LOOKS["paper" if row["method"] == "paper" else "ours"]
            mean.errorbar(1e3 * row["mean_m"], place, xerr=1e3 * row["sd_m"], **look)
            spread = [[row["worst_m"] - row["worst_lo_m"]], [row["worst_hi_m"] - row["worst_m"]]]
            worst.errorbar(1e3 * row["worst_m"], place, xerr=1e3 * np.array(spread), **look)
        mean.axvline(0.0, color=FAINT, lw=0.7)
        mean.set_yticks(range(len(rows)), names)
        mean.invert_yaxis()
        n = rows[0]["searches"]
        mean.set_xlabel(f"error (mm), mean ± σ, n = {n} each")
        worst.set_xlabel(f"worst of 85 (mm), mean of {n // 85}, 95 % interval")
        worst.set_xlim(left=0.0)
        return saved(drawing, "centering")


def campaigns(figures: Figures) -> str:
    """Trials a second of wall time, and the writer's largest memory, against the number of trials."""
    found = results("campaigns")
    with figures.figure(2.9, columns=2, sharex=True) as drawing:
        rate, memory = drawing.axes
        looks = {1: LOOKS["paper"], 2: LOOKS["ours"], 4: LOOKS["rival"]}
        for workers, look in looks.items():
            rows = sorted((row["trials"], row) for row in found["runs"] if row["workers"] == workers)
            sizes = [trials for trials, _ in rows]
            label = f"{workers} worker{'s' * (workers > 1)}"
            rate.plot(sizes, [trials / row["wall_s"] for trials, row in rows], label=label, **look)
        alone = [(row["asked"], row["writer_peak_mb"]) for row in found["writer_alone"]]
        memory.plot(*zip(*sorted(alone), strict=True), **LOOKS["truth"], label="writer alone")
        rate.set(xscale="log", xlabel="trials", ylabel="trials a second")
        memory.set(xlabel="trials", ylabel="writer's largest memory (MB)")
        for axes in drawing.axes:
            axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
        memory.legend()
        rate.legend()
        return saved(drawing, "campaigns")


def change(record: PassageRecord) -> Any:
    """Change since the rest before the motion, in thousandths of full scale."""
    return 1e3 * (record.z - record.z[: record.begun].mean())


def sides(figures: Figures) -> str:
    """Each side approaches the pipe, touches it and retracts, whole and enlarged."""
    with figures.figure(7.5, rows=len(SIDES), columns=2, sharex="col") as drawing:
        for place, side in enumerate(SIDES):
            record = passage(Event(SEED, 0, "touch", "pipe", side, 0.01))
            whole, far = drawing.axes[2 * place : 2 * place + 2]
            z, t = change(record), record.times_s - record.times_s[record.begun]
            for axes, part in (
                (whole, slice(0, None, 8)),
                (far, slice(record.begun, record.begun + 4800, 4)),
            ):
                axes.plot(t[part], z.real[part], color=INK, lw=0.7, label="in phase")
                axes.plot(t[part], z.imag[part], color=PAPER, lw=0.7, ls=(0, (3, 1)), label="in quadrature")
            whole.axvspan(t[record.touched or 0], t[(record.released or 1) - 1], color=TRUTH, alpha=0.2, lw=0)
            whole.set_ylabel(side)
            far.set_ylim(-1.5, 1.5)
        for axes in drawing.axes[-2:]:
            axes.set_xlabel("time since the arm set out (s)")
        drawing.figure.supylabel("change (1e-3 of full scale)", fontsize=9.5)
        below(drawing, 2)
        return saved(drawing, "aura_sides")


def undulations(figures: Figures) -> str:
    """The same undulations at two speeds over distance, and the echo of each object."""
    with figures.figure(3.2, columns=2) as drawing:
        speeds, echoes = drawing.axes
        for place, speed_m_s in enumerate(SPEEDS_M_S):
            record = passage(Event(SEED, 0, "near", "pipe", "normal", speed_m_s))
            way = slice(record.begun, record.arrived)
            style: Any = {"color": (INK, PAPER)[place], "lw": 0.8, "label": f"{100.0 * speed_m_s:g} cm/s"}
            speeds.plot(1e3 * record.gap_m[way], change(record).real[way] - 4.0 * place, **style)
        for place, name in enumerate(OBJECTS):
            event = Event(SEED, 0, "near", name, "normal", 0.01)
            record, (echo, _, _) = passage(event), template(event)
            way = slice(record.begun, record.arrived, 20)
            style = {"color": mixed(FAINT, place / len(OBJECTS)), "marker": "o^v<>sDPXhd"[place], "ms": 3.0}
            soft = {"ls": (0, (2, 2))} if OBJECTS[name].absorption > 0.5 else {}
            size = 1e3 * np.abs(echo[way])
            echoes.semilogy(
                1e3 * record.gap_m[way],
                size,
                markevery=40,
                lw=0.8,
                label=name.replace("_", " "),
                **style,
                **soft,
            )
        speeds.set_ylabel("change in phase (1e-3 FS), one 4 lower")
        echoes.set_ylabel("sent back (1e-3 FS)")
        for axes in drawing.axes:
            axes.set_xlabel("distance (mm)")
            axes.invert_xaxis()
            axes.legend(ncols=2, fontsize=7.5)
        return saved(drawing, "aura_speeds")


def touch(figures: Figures) -> str:
    """One touch: the envelope, the paper's z-score at two windows, and our detector's events."""
    record = passage(Event(SEED, 1, "touch", "mug", "normal", 0.01))
    values, t = np.column_stack([record.z.real, record.z.imag]), record.times_s
    with figures.figure(4.2, rows=2, sharex=True) as drawing:
        envelope, z_scores = drawing.axes
        few = slice(None, None, 8)
        for column, name, style in (
            (0, "in phase", {"color": INK}),
            (1, "in quadrature", {"color": PAPER, "ls": (0, (3, 1))}),
        ):
            envelope.plot(t[few], 100.0 * values[few, column], lw=0.8, label=name, **style)
        for window_s, colour in ((1.0, PAPER), (5.0, FAINT)):
            trace = LevelPaperDetector("paper", LevelPaperSettings(window_s=window_s)).statistic(
                values, 1000.0
            )
            z_scores.plot(
                t[few], trace[few], color=colour, lw=0.8, label=f"the paper's, window of {window_s:g} s"
            )
        for axes in drawing.axes:
            axes.axvspan(
                t[record.touched or 0],
                t[(record.released or 1) - 1],
                color=TRUTH,
                alpha=0.2,
                lw=0,
                label="touch (truth)",
            )
        for event in LevelDetector("ours", LevelSettings()).push(record.block):
            for axes in drawing.axes:
                axes.axvline(event.t_s, color=OURS, ls="--", lw=0.9)
            placed: Any = {
                "xycoords": ("data", "axes fraction"),
                "rotation": 90,
                "va": "top",
                "ha": "right",
                "fontsize": 8,
            }
            z_scores.annotate(f"ours: {type(event).__name__}", (event.t_s, 0.97), color=OURS, **placed)
        envelope.set_ylabel("envelope (% of full scale)")
        z_scores.set(ylabel="|z|", xlabel="time (s)")
        for axes in drawing.axes:
            axes.legend(loc="upper left")
        return saved(drawing, "pretouch_contact")


if __name__ == "__main__":
    main(sys.argv[1:])
