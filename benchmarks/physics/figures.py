"""The figure: run time against error, one panel a scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.physics.comparison import EXACT, Point
from benchmarks.physics.report import scenes_of, solvers_of

FOLDER = Path(__file__).resolve().parents[1] / "figures"

STYLES = {
    EXACT: ("#c1121f", "*"),
    "RK4, events located": ("#1d3557", "o"),
    "order 8, events located": ("#457b9d", "D"),
    "RK4": ("#2a9d8f", "o"),
    "semi-implicit Euler": ("#8ab17d", "s"),
    "scipy RK45": ("#e9c46a", "^"),
    "scipy DOP853": ("#f4a261", "v"),
    "scipy LSODA": ("#e76f51", "<"),
    "scipy Radau": ("#b5838d", ">"),
    "MuJoCo Euler": ("#6c757d", "s"),
    "MuJoCo RK4": ("#adb5bd", "o"),
}
"""Colour and marker of each solver: ours red, compiled blue to green, scipy warm, MuJoCo grey."""

FLOOR = 2e-16
"""Errors below this are drawn here: the spacing of doubles at 1."""


def draw(points: Sequence[Point], *, closed: bool) -> list[Path]:
    """Draw the scenes with the loop closed or open; SVG and PNG.

    Only points that found every event are drawn filled; the others are hollow.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    # the same figure, byte by byte, from the same numbers
    mpl.rcParams.update({"svg.hashsalt": "physics", "font.size": 9, "svg.fonttype": "none"})
    names = [scene for scene, loop in scenes_of(points) if loop == closed]
    figure, axes = plt.subplots(
        1, len(names), figsize=(11.0, 4.6), sharex=True, sharey=True, layout="constrained"
    )
    for axis, name in zip(axes, names, strict=True):
        here = [p for p in points if p.scene == name and p.closed == closed]
        for solver in solvers_of(here):
            colour, marker = STYLES[solver]
            line = [p for p in here if p.solver == solver]
            errors = [max(p.error, FLOOR) for p in line]
            costs = [p.us_per_s for p in line]
            ours = solver == EXACT
            axis.plot(errors, costs, color=colour, lw=1.2, zorder=3 if ours else 2)
            for error, cost, point in zip(errors, costs, line, strict=True):
                axis.plot(
                    error,
                    cost,
                    marker=marker,
                    ms=15 if ours else 5,
                    color=colour,
                    mfc=colour if point.whole else "white",
                    zorder=4 if ours else 2,
                )
        axis.axhline(1e6, color="0.6", lw=0.8, ls=":")
        axis.set(xscale="log", yscale="log", title=name, xlabel="error of events (s) and theta (rad)")
        axis.grid(color="0.92", lw=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("CPU time per simulated second, us")
    axes[0].text(FLOOR, 1.1e6, "real time", color="0.45", fontsize=8, va="bottom")
    handles = [
        Line2D([], [], color=c, marker=m, ms=12 if s == EXACT else 5, lw=1.2, label=s)
        for s, (c, m) in STYLES.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    figure.suptitle(
        f"The finger, loop {'closed' if closed else 'open'}: left and low is better; hollow: not every event found"
    )
    FOLDER.mkdir(exist_ok=True)
    paths = [FOLDER / f"physics_{'closed' if closed else 'open'}_loop.{kind}" for kind in ("svg", "png")]
    for path in paths:
        figure.savefig(path, dpi=160, metadata={"Date": None} if path.suffix == ".svg" else None)
    plt.close(figure)
    return paths
