"""What good, regular and bad mean where slip detection is judged: by the study and by reports of runs.

Fixed before the study was first run, and not touched since. The paper (Table 1) gives one rating per sensor from one
run each, without a rule; the numbers are ours, with these reasons.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

VERDICTS: Mapping[str, Any] = {
    # a slip that is not reported by then counts as missed: the shortest that the paper shows lasts 0.75 s (Fig. 15)
    "missed_after_s": 0.75,
    # thresholds are set for one false alarm in an hour: a working day of eight hours interrupts the user eight times
    "false_alarm_interval_s": 3600.0,
    # the detector can be relied on; `missed`: one slip in twenty, the limit that a grip controller with a second line
    # of defence can bear; `median_s`: the paper promises one block of 64 ms, and a slip that starts in mid-block needs
    # up to two
    "good": {"missed": 0.05, "median_s": 0.128},
    # works, not every time ("still works properly"); `missed`: more often than one in five, it could not be said to;
    # `median_s`: human grip reflexes take 60 to 100 ms; four blocks are beyond them but within the shortest slip
    "regular": {"missed": 0.20, "median_s": 0.256},
    # bad: everything else
}

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
