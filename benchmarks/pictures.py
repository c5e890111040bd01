"""The README's pictures, of the bench and of a session in the terminal; `python -m benchmarks.pictures` draws them."""

from __future__ import annotations

import os
import pty
import re
import sys
import tempfile
from io import StringIO
from pathlib import Path
from subprocess import Popen
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Arc, FancyArrowPatch, Rectangle
from rich.console import Console
from rich.text import Text

from controller.recording.reader import open_run
from controller.reports.approaches import read_approaches
from controller.reports.figures import FAINT, INK, OURS, PAPER, TRUTH, Figures
from controller.reports.transient_figures import Trace, representative, trace_of

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "pictures"
COLUMNS, LINES = 100, 40


def main() -> None:
    """Run mock/transient in a terminal, and draw the session and one of its approaches."""
    with tempfile.TemporaryDirectory() as folder:
        output = _session(Path(folder))
        draw_session(output, OUT / "terminal.svg")
        approaches = read_approaches([open_run("latest", Path(folder))])
        approach = representative(approaches)
        trace = trace_of(approach) if approach else None
        if trace is None:
            raise SystemExit("no approach was recorded")
        draw_bench(trace, OUT / "bench.svg")


def _session(folder: Path) -> str:
    """Output of the campaign to a terminal of `COLUMNS`."""
    command = [sys.executable, str(ROOT / "run.py"), "run", "mock/transient", "--out", str(folder)]
    ours, theirs = pty.openpty()
    environment = os.environ | {"COLUMNS": str(COLUMNS), "LINES": str(LINES), "TERM": "xterm-256color"}
    with Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, cwd=ROOT, env=environment):
        os.close(theirs)
        output = bytearray()
        try:
            while chunk := os.read(ours, 65_536):
                output += chunk
        except OSError:  # how a terminal of Linux ends
            pass
    os.close(ours)
    return output.decode("utf-8", "replace").replace("\r\n", "\n").replace(str(folder), "runs")


def draw_session(output: str, path: Path) -> None:
    """The command, the live view in mid-campaign, and the end of the output."""
    frames = re.split(r"(?:\x1b\[2K|\x1b\[1A|\r)+", output)
    live = [frame for frame in frames if "━" in frame and "board.period" in frame]
    live = [frame for frame in live if "APPROACH" in frame and re.search(r"Hz +contact", frame)] or live
    end = output[output.rindex("Stop at first contact") :]
    lines = [
        "$ run.py run mock/transient",
        "",
        *live[2 * len(live) // 3].rstrip().splitlines(),
        "",
        "…",
        "",
        *end.rstrip().splitlines(),
    ]
    terminal = Console(record=True, width=COLUMNS, file=StringIO())
    for line in lines:
        terminal.print(Text.from_ansi(line), overflow="fold")
    svg = terminal.export_svg(title="run.py run mock/transient")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)  # no font is loaded
    path.write_text(re.sub(r"[ \t]+$", "", svg, flags=re.MULTILINE), "utf-8")


def draw_bench(trace: Trace, path: Path) -> None:
    """The bench on the left; on the right the signal of one approach, and where it stops."""
    figures = Figures(path.parent, simulated=True)
    layout: Any = {"width_ratios": [1.0, 1.7]}
    with figures.figure(3.0, rows=1, columns=2, **layout) as drawing:
        _bench(drawing.axes[0])
        _approach(drawing.axes[1], trace)
        drawing.figure.savefig(path, format="svg", metadata={"Date": None})
    path.write_text(re.sub(r"[ \t]+$", "", path.read_text("utf-8"), flags=re.MULTILINE), "utf-8")


def _bench(axes: Axes) -> None:
    axes.set_xlim(0.0, 10.0)
    axes.set_ylim(0.0, 10.0)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_title("an oscillating finger and a probe")
    axes.add_patch(Rectangle((0.3, 1.2), 4.4, 0.7, color=FAINT))
    axes.text(2.5, 0.5, "linear stage", ha="center")
    axes.add_patch(Rectangle((1.2, 1.9), 1.4, 3.6, facecolor="white", edgecolor=INK))
    axes.add_patch(Rectangle((2.6, 4.4), 1.0, 0.8, facecolor="white", edgecolor=PAPER))
    axes.text(2.8, 5.6, "load cell", color=PAPER)
    axes.plot([3.6, 5.6], [4.8, 4.8], color=INK, lw=2.0)
    axes.add_patch(FancyArrowPatch((3.9, 3.6), (5.6, 3.6), arrowstyle="->", mutation_scale=10.0, color=INK))
    axes.text(4.7, 2.9, "approach", ha="center")
    axes.plot([6.4, 6.4], [1.9, 7.9], color=OURS, lw=5.0, solid_capstyle="round")
    axes.plot([6.4, 6.9], [1.9, 1.2], color=OURS, lw=5.0, solid_capstyle="round")
    for side in (-1.0, 1.0):
        axes.add_patch(Arc((6.4 + 0.55 * side, 8.0), 0.9, 1.2, theta1=40, theta2=140, color=OURS))
    axes.text(6.4, 9.0, "28 Hz", ha="center", color=OURS)
    axes.text(7.1, 5.4, "touch\nstiffens it:\nfrequency\nrises", va="center", color=OURS)


def _approach(axes: Axes, trace: Trace) -> None:
    approach = trace.approach
    onset_s, detect_s = approach.onset_s or 0.0, approach.detect_s or 0.0
    inside = (trace.average_s > onset_s - 1.2) & (trace.average_s < detect_s + 0.2)
    axes.plot(trace.average_s[inside] - onset_s, trace.average_hz[inside], "o-", ms=3.0, color=OURS)
    axes.axhline(approach.threshold_hz or 0.0, color=TRUTH, ls=(0, (5, 2)), lw=0.9)
    axes.text(-1.15, approach.threshold_hz or 0.0, "threshold", color=TRUTH, va="bottom")
    axes.axvline(0.0, color=INK, lw=0.7, ls=(0, (4, 2)))
    axes.axvline(detect_s - onset_s, color=TRUTH, lw=1.0)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.14 * (high - low))
    axes.text(-0.02, high, "touch", ha="right", va="bottom")
    stop_ms = 1e3 * ((approach.standstill_s or detect_s) - detect_s)
    note = f"detected {approach.delay_s:.2f} s later;\nstands still after {stop_ms:.0f} ms"
    axes.text(detect_s - onset_s + 0.2, low + 0.25 * (high - low), note, va="center", color=TRUTH)
    axes.set_xlim(-1.2, detect_s - onset_s + 1.4)
    axes.set_xlabel("time since the touch (s)")
    axes.set_ylabel("filtered frequency (Hz)")
    axes.set_title("one approach, simulated, and its stop")


if __name__ == "__main__":
    main()
