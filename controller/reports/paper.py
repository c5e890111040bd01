"""What the paper prints, to stand beside what is measured here.

S. B. Backus, A. M. Dollar, "Robust, Inexpensive Resonant Frequency Based Contact Detection for Robotic
Manipulators". Sections, tables and figures below are the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass

from controller.reports.section import Kind, Printed

CITATION = (
    "S. B. Backus and A. M. Dollar, “Robust, Inexpensive Resonant Frequency Based Contact Detection for "
    "Robotic Manipulators”"
)


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One row of Table I: means, with the standard deviations that the paper prints in brackets.

    Attributes:
        side: "back" or "pad" of the distal link.
        location: Letter of Fig. 6.
        micrometer_m: Position along the link; zero is distal (inferred, the paper does not state it).
        speed_m_s: Speed of the probe.
        delay_s: From the load cell's 0.005 N to detection.
        extent_m: Travel of the probe in that time.
        force_n: Force at detection.
        study: Which figure draws it: "location" (Fig. 7 or 8) or "speed" (Fig. 9).
        fitted: Whether the simulated finger's compliance was fitted to its force and extent
            (docs/explanation/finger_physics.md).
    """

    side: str
    location: str
    micrometer_m: float
    speed_m_s: tuple[float, float]
    delay_s: tuple[float, float]
    extent_m: tuple[float, float]
    force_n: tuple[float, float]
    study: str
    fitted: bool = False


def _row(
    side: str,
    location: str,
    micrometer_mm: float,
    values: tuple[float, ...],
    study: str = "location",
    fitted: bool = False,
) -> PaperRow:
    speed, speed_sd, time, time_sd, extent, extent_sd, force, force_sd = values
    return PaperRow(
        side=side,
        location=location,
        micrometer_m=micrometer_mm / 1000.0,
        speed_m_s=(speed / 1000.0, speed_sd / 1000.0),
        delay_s=(time, time_sd),
        extent_m=(extent / 1000.0, extent_sd / 1000.0),
        force_n=(force, force_sd),
        study=study,
        fitted=fitted,
    )


TABLE_1 = (
    # speed mm/s, time s, extent mm, force N, each with its sigma, as printed
    _row("back", "a", 19.05, (3.785, 0.159, 0.33, 0.15, 1.372, 0.599, 0.111, 0.017)),
    _row("back", "b", 12.7, (3.691, 0.360, 0.23, 0.06, 0.864, 0.309, 0.073, 0.004)),
    _row("back", "c", 0.0, (4.919, 0.103, 0.20, 0.00, 1.067, 0.051, 0.057, 0.006)),
    _row("pad", "d", 0.0, (4.487, 0.117, 0.37, 0.06, 1.643, 0.280, 0.031, 0.007)),
    _row("pad", "e", 6.35, (4.885, 0.082, 0.43, 0.06, 2.252, 0.338, 0.050, 0.006)),
    _row("pad", "f", 12.7, (4.843, 0.163, 0.17, 0.12, 0.830, 0.645, 0.050, 0.006)),
    _row("pad", "g", 19.05, (4.555, 0.374, 0.37, 0.15, 1.710, 0.776, 0.075, 0.014)),
    _row("pad", "h", 25.4, (3.260, 0.389, 0.59, 0.09, 1.964, 0.192, 0.048, 0.015)),
    _row("pad", "f", 12.7, (2.540, 0.305, 0.20, 0.00, 0.576, 0.059, 0.038, 0.005), "speed", fitted=True),
    _row("pad", "f", 12.7, (4.513, 0.184, 0.40, 0.10, 1.761, 0.407, 0.036, 0.007), "speed"),
    _row("pad", "f", 12.7, (6.435, 0.249, 0.23, 0.06, 1.524, 0.440, 0.032, 0.007), "speed", fitted=True),
    _row("pad", "f", 12.7, (8.060, 1.042, 0.23, 0.12, 2.066, 1.042, 0.054, 0.005), "speed"),
    _row("pad", "f", 12.7, (10.685, 0.089, 0.17, 0.06, 1.880, 0.616, 0.072, 0.027), "speed"),
    _row("pad", "f", 12.7, (11.997, 2.351, 0.23, 0.06, 3.200, 0.748, 0.099, 0.031), "speed", fitted=True),
)
"""Table I, in the paper's order."""


@dataclass(frozen=True, slots=True)
class PaperColumn:
    """A column of Table I, with the bound that the paper states for it.

    Attributes:
        name: Of the measure, in trials.csv and in `PaperRow`.
        title: As it is printed.
        decimals: That it is printed with, in the unit of its name.
        comparatives: For less and for more than the paper's.
        bound: In SI units.
        over: What the bound holds for: "largest" or "mean" over all contacts.
        source: Of the bound.
        fitted: Whether the rows that the simulated finger was fitted to set it.
    """

    name: str
    title: str
    decimals: int
    comparatives: tuple[str, str]
    bound: float
    over: str
    source: str
    fitted: bool = False


COLUMNS = (
    PaperColumn("delay_s", "time", 2, ("quicker", "slower"), 0.3, "mean", "V.B"),
    PaperColumn("extent_m", "extent", 2, ("shorter", "longer"), 0.00381, "largest", "IV.B"),
    PaperColumn("force_n", "force", 3, ("lower", "higher"), 0.15, "largest", "IV.B", fitted=True),
)
"""Columns of Table I: from onset to detection (V.B: "on average 0.3 seconds"), and force at detection."""

STATIC_HZ = {"none": 28.0, "light": 30.0, "full": 50.0}
"""Dominant frequency without, with light and with full contact (IV.A: "approximately")."""

STATIC_TOLERANCE_HZ = {"none": 1.0, "light": 2.0, "full": 3.0}
"""How close counts as reproduced: ours, since the paper has only "approximately"."""

STATIC_KINDS = {"none": Kind.FITTED, "light": Kind.ASSUMED, "full": Kind.FITTED}
"""Both ends were fitted; light contact is where we put the probe, with a lock that was chosen to be erratic there
(docs/explanation/finger_physics.md)."""

SETTLE = {"behavior.settle_s": Printed(90.0, "III.B")}
"""Wait after power-on."""

RESONANCE = {
    "sample_hz": Printed("not printed; 15 at most", "V.B"),
    "average_samples": Printed(10, "III.B"),
    "baseline_s": Printed(1.0, "III.B"),
    "threshold_sigma": Printed(3.0, "III.B"),
}
"""The paper's detector."""
