"""Figures at print quality: one style, saved as SVG, which is also inside the page; as PDF and PNG on request."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import matplotlib as mpl

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from controller.recording.reader import Run

OURS, PAPER, FALSE, GOOD, RIVAL = "#0072b2", "#5b5b5b", "#d55e00", "#009e73", "#cc79a7"
"""Ours, the paper's, false contacts and the truth, what is met, and rivals: distinct to the colour-blind (Okabe and
Ito), by lightness and by marker as well."""

TRUTH = FALSE

INK, FAINT = "#1a1a1a", "#b9bcc2"

LOOKS: Mapping[str, Mapping[str, Any]] = {
    "ours": {"color": OURS, "marker": "o"},
    "paper": {"color": PAPER, "marker": "s", "mfc": "white"},
    "rival": {"color": RIVAL, "marker": "^"},
    "truth": {"color": TRUTH, "marker": "x"},
}
"""How each is drawn, in reports, benchmarks and README alike."""

_THEMED = {
    OURS: "ours",
    PAPER: "paper-s",
    FALSE: "truth",
    GOOD: "good",
    RIVAL: "rival",
    INK: "ink",
    FAINT: "faint",
}
"""Colour → the page's name for it, which light and dark fill in."""

WIDTH_IN = 7.16
"""Two columns of a two-column page (IEEE), inches."""

_STYLE: Any = {
    "font.family": "DejaVu Serif",  # matplotlib ships it; the widest that a page may fall back to
    "mathtext.fontset": "stix",
    "font.size": 9.5,
    "axes.titlesize": 9.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handletextpad": 0.4,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "lines.linewidth": 1.0,
    "lines.markersize": 4.5,
    "errorbar.capsize": 2.0,
    "figure.constrained_layout.use": True,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",  # text stays text: a search and a screen reader find it
    "path.simplify_threshold": 0.4,  # points; a line on paper is twice as wide
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "svg.hashsalt": "touchbench",  # the same identifiers in every run
    "pdf.fonttype": 42,
}


@dataclass
class Figures:
    """Saves figures into a run's `figures/` and hands each back as SVG for the page.

    Args:
        folder: None writes none.
        simulated: What marks every figure: "simulated", "partly simulated", or "" for none.
        prefix: Begins the identifiers of its SVG elements: no two on one page are alike.
        also: Formats beside SVG, such as "pdf"; each costs as much again.
        page: The runs of the whole page, by which its trials are named; of a part of it alone, none.
    """

    folder: Path | None
    _: KW_ONLY
    simulated: str = ""
    prefix: str = "s"
    also: Sequence[str] = ()
    page: Sequence[Run] = ()
    _count: int = field(default=0, init=False)

    @contextmanager
    def figure(self, height_in: float, rows: int = 1, columns: int = 1, **layout: Any) -> Iterator[Drawing]:
        """A figure of `rows` x `columns` axes in the house's style."""
        from matplotlib.figure import Figure

        with mpl.rc_context(_STYLE):
            figure = Figure(figsize=(WIDTH_IN, height_in))
            axes = figure.subplots(rows, columns, squeeze=False, **layout)
            yield Drawing(self, figure, list(axes.flat))

    @contextmanager
    def panels(self, count: int, columns: int, height_in: float, **layout: Any) -> Iterator[Drawing]:
        """A figure of `count` axes in rows of `columns`, each row `height_in` high."""
        rows = -(-count // columns)
        with self.figure(height_in * rows + 0.5, rows=rows, columns=columns, **layout) as drawing:
            for axes in drawing.axes[count:]:
                axes.set_visible(False)
            drawing.axes, drawing.columns = drawing.axes[:count], columns
            yield drawing

    def save(self, figure: Figure, name: str) -> str:
        """Write it; returns the SVG element, with identifiers that no other figure has."""
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        if self.simulated:
            # A line of small print above the axes, where no legend is that makes room for it.
            strip = 0.0 if figure.legends else 0.17 / figure.get_size_inches()[1]
            figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - strip))
            look: Any = {"fontsize": 8, "color": FALSE, "style": "italic", "alpha": 0.9}
            figure.text(1.0, 1.0, self.simulated, ha="right", va="top", **look)
        # drawn in memory first: a full disk is then one plain error, not one from the inside of a writer
        buffer = io.StringIO()
        # the canvas lays out and draws once, where `savefig` does it twice
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})  # type: ignore[no-untyped-call]
        text = buffer.getvalue()
        if self.folder:
            self.folder.mkdir(parents=True, exist_ok=True)
            for kind in self.also:
                picture, dates = io.BytesIO(), {"CreationDate": None} if kind == "pdf" else None
                figure.savefig(picture, format=kind, dpi=300, metadata=dates)
                (self.folder / f"{name}.{kind}").write_bytes(picture.getvalue())
            (self.folder / f"{name}.svg").write_text(text, "utf-8")
        self._count += 1
        return _inline(text, f"{self.prefix}f{self._count}-")


@dataclass
class Drawing:
    """A figure being drawn."""

    figures: Figures
    figure: Figure
    axes: Sequence[Axes]
    columns: int = 1

    def label_outside(self, x: str, y: str) -> None:
        """Name the axes of panels that have no other below or on their left."""
        for axes in self.axes[-self.columns :]:
            axes.set_xlabel(x)
        for axes in self.axes[:: self.columns]:
            axes.set_ylabel(y)

    def legend(self, axes: Axes, columns: int) -> None:
        """One legend for all panels, above them, of what one of them shows."""
        found = axes.get_legend_handles_labels()
        self.figure.legend(*found, loc="outside upper left", ncols=columns, borderaxespad=0.0)

    def save(self, name: str) -> str:
        """Save it, its panels with letters where there are several; returns the SVG element."""
        if len(self.axes) > 1:
            for letter, axes in zip(ascii_lowercase, self.axes, strict=False):
                title = axes.get_title(loc="left") or axes.get_title()
                axes.set_title("", loc="center")
                axes.set_title(rf"$\bf{{{letter}}}$  {title}".rstrip(), loc="left")
        return self.figures.save(self.figure, name)


def _inline(text: str, prefix: str) -> str:
    """The `<svg>` element alone, scaling with the page, its identifiers made unique on it."""
    svg = text[text.index("<svg") :]
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r'\1 role="group"', svg, count=1)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}\1"', svg)
    svg = re.sub(r"fill: #ffffff(?=[^-])", "fill: var(--paper)", svg)
    for colour, name in _THEMED.items():
        svg = svg.replace(colour, f"var(--{name})")
    svg = re.sub(
        r"'(?:STIXGeneral|DejaVu Serif)'[^;\"']*|STIXGeneral",
        "STIXGeneral, 'STIX Two Text', Charter, Georgia, 'DejaVu Serif', serif",
        svg,
    )
    return re.sub(r'(xlink:href="#|href="#|url\(#)(?!' + prefix + ")", rf"\1{prefix}", svg)
