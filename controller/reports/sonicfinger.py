"""What the paper on pre-touch prints, to stand beside what is measured here.

S. Rupavatharam et al., "SonicFinger: Pre-touch and Contact Detection Tactile Sensor for Reactive Pregrasping".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from controller.outcomes import UNMEASURED
from controller.recording.reader import Run
from controller.reports.run_account import setting_of
from controller.reports.section import Printed

CITATION = (
    "S. Rupavatharam, C. Escobedo, D. Lee, C. Prepscius, L. Jackel, R. Howard and V. Isler, “SonicFinger: "
    "Pre-touch and "
    "Contact Detection Tactile Sensor for Reactive Pregrasping”"
)

BEST_HZ = 40_000.0
"""Frequency that transfers best (III.A.2)."""

WORST_CENTERING_M = 0.008
"""Largest error of centering (IV.A.2, Fig. 8c)."""

WANTED_CENTERING_M = 0.0025
"""Largest error of centering that is aimed at here; ours, not the paper's."""

PRE_TOUCH = (0.924, 0.953)
"""True positive and true negative rate of pre-touch (IV.B.1)."""

CONTACT = (0.937, 0.987)
"""The same of contact (IV.B.3)."""

ASSUMED = (
    "Reflectivity, decay, absorption, noise and drift are assumptions: the paper prints none of them.",
)
"""What is assumed of a simulated finger."""

DETECTORS: Mapping[str, Mapping[str, Printed]] = {
    "pretouch.paper": {
        "window_s": Printed("alpha, not printed", "III.D"),
        "band_hz": Printed(100.0, "III.D"),
        "threshold": Printed("gamma, not printed", "III.D"),
    },
    "level.paper": {"threshold": Printed("gamma, not printed", "III.E")},
}
"""What the paper prints of its detectors, by kind and setting."""

METHOD_NAMES = {"paper": "the paper's", "ours": "ours"}


def rows_of(runs: Sequence[Run]) -> list[Any]:
    """All trials that were measured, of all runs."""
    return [row for run in runs for row in run.trials if row.get("outcome") not in UNMEASURED]


def printed_of(run: Run) -> Mapping[str, Printed]:
    """What the paper prints of the detectors in a profile, by the path of the setting."""
    return {
        f"detectors.{name}.{setting}": printed
        for name, table in (setting_of(run, "detectors") or {}).items()
        for setting, printed in DETECTORS.get(str(table.get("kind")), {}).items()
    }
