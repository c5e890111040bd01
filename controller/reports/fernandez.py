"""What Fernandez et al. print of their fingertip's calibration, to stand beside what is measured here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

CITATION = (
    "R. Fernandez, I. Payo, A. S. Vazquez and J. Becedas, “Micro-Vibration-Based Slip Detection in Tactile Force "
    "Sensors”, Sensors 2014, 14"
)


class PrintedFigure(NamedTuple):
    """A figure as it is printed: it stands for everything that is rounded to it.

    Attributes:
        value: The figure.
        half: Half a unit of its last digit.
    """

    value: float
    half: float

    def meets(self, low: float, high: float) -> bool:
        """Whether an interval holds a value that is printed so."""
        return low <= self.value + self.half and self.value - self.half <= high


@dataclass(frozen=True, slots=True)
class PaperBridge:
    """One bridge, as 4.2 and Fig. 6 have it.

    Attributes:
        force: What it reads.
        gauges: Which strain gauges it is made of.
        gain_v_n: V/N.
        hysteresis: Share of the full-scale output.
        resolution_n: N.
        top_n: Up to which force it was calibrated, N.
    """

    force: str
    gauges: str
    gain_v_n: PrintedFigure
    hysteresis: PrintedFigure
    resolution_n: PrintedFigure
    top_n: float


BRIDGES: Mapping[str, PaperBridge] = {
    "x": PaperBridge(
        "Fx", "12", PrintedFigure(0.0694, 5e-5), PrintedFigure(0.06, 5e-3), PrintedFigure(0.12, 5e-3), 7.0
    ),
    "y": PaperBridge(
        "Fy", "34", PrintedFigure(0.0326, 5e-5), PrintedFigure(0.048, 5e-4), PrintedFigure(0.12, 5e-3), 7.0
    ),
    "t": PaperBridge(
        "Ft", "56", PrintedFigure(1.0291, 5e-5), PrintedFigure(0.05, 5e-3), PrintedFigure(0.01, 5e-3), 1.0
    ),
}
"""Fig. 6 and section 4.2."""
