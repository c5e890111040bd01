"""What good, regular and bad mean where slip detection is judged: by the study and by reports of runs."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

FILE = Path(__file__).with_suffix(".toml")
"""Fixed before anything was judged by it."""

VERDICTS: Mapping[str, Any] = tomllib.loads(FILE.read_text(encoding="utf-8"))
"""`missed_after_s`, `false_alarm_interval_s`, and for `good` and `regular` the largest `missed` (share) and
`median_s`."""

NOT_JUDGED = "not judged"

LEAST = 3
"""With fewer slips detected or missed there is no verdict: the median would be the delay of a single slip."""


def verdict_of(delays_s: ArrayLike) -> str:
    """good, regular or bad; `NOT_JUDGED` where fewer than `LEAST` slips are left.

    Args:
        delays_s: Of the slips that were detected or missed, infinite where missed, shape (n,). A slip that was called
            before it began is neither: a failure of its own, reported beside the verdict.
    """
    delays = np.asarray(delays_s, dtype=np.float64)
    if len(delays) < LEAST:
        return NOT_JUDGED
    return verdict(float(np.mean(np.isinf(delays))), float(np.median(delays)))


def verdict(missed: float, median_s: float) -> str:
    """good, regular or bad.

    Args:
        missed: Share of slips that were not reported within `missed_after_s`; NaN where there was none.
        median_s: Median delay, infinite where half or more are missed; NaN where there was no slip.
    """
    for grade in ("good", "regular"):
        limit = VERDICTS[grade]
        if missed <= limit["missed"] and median_s <= limit["median_s"]:
            return grade
    return "bad"
