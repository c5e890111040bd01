"""Scores of a set of searches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.centering.search import Found


class CenteringScore(NamedTuple):
    """Of one or more repeats of the 85.

    Attributes:
        worst_m: Mean over the repeats of the largest error in each.
        worst_lo_m, worst_hi_m: Its 95 % interval (Student's t over the repeats); NaN for a single repeat.
        largest_m: The largest error of all.
        mean_m, sd_m: Of the errors, signed.
        median_m: Of their sizes.
        skewness: Third standardised moment of the errors.
        searches: How many there were.
        unseen, stopped, touched: How many saw nothing, were ended by the contact detectors, really touched the object.
        seen_m: Median distance at which the object was seen.
        search_s: Median time.
    """

    worst_m: float
    worst_lo_m: float
    worst_hi_m: float
    largest_m: float
    mean_m: float
    sd_m: float
    median_m: float
    skewness: float
    searches: int
    unseen: int
    stopped: int
    touched: int
    seen_m: float
    search_s: float

    @property
    def centred(self) -> int:
        """How many found the middle without touching the object."""
        return self.searches - self.unseen - self.stopped - self.touched


def clean(found: Sequence[Found]) -> list[Found]:
    """Searches that found the middle without a touch: if a finger pushes the object, the middle of two touches is the
    object's anyway."""
    return [one for one in found if one.outcome == "found" and not one.touches]


def score(repeats: Sequence[Sequence[Found]]) -> CenteringScore:
    """Score repeats of the same set."""
    every = [one for repeat in repeats for one in repeat]
    good = clean(every)
    errors_m = np.array([one.error_m for one in good])
    worst = [max(abs(one.error_m) for one in clean(repeat)) for repeat in repeats if clean(repeat)]
    mean, lo, hi = interval(worst)
    nan = math.nan
    spread = float(errors_m.std()) if len(good) else nan
    return CenteringScore(
        worst_m=mean,
        worst_lo_m=lo,
        worst_hi_m=hi,
        largest_m=max(worst, default=nan),
        mean_m=float(errors_m.mean()) if len(good) else nan,
        sd_m=spread,
        median_m=float(np.median(np.abs(errors_m))) if len(good) else nan,
        skewness=float(np.mean((errors_m - errors_m.mean()) ** 3) / spread**3) if spread > 0.0 else nan,
        searches=len(every),
        unseen=sum(one.outcome == "unseen" and not one.touches for one in every),
        stopped=sum(one.outcome == "contact" and not one.touches for one in every),
        touched=sum(one.touches > 0 for one in every),
        seen_m=float(np.median([one.seen_m for one in good])) if good else nan,
        search_s=float(np.median([one.search_s for one in good])) if good else nan,
    )


def interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Mean and its 95 % interval by Student's t."""
    if not values:
        return math.nan, math.nan, math.nan
    mean, n = float(np.mean(values)), len(values)
    if n < 2:
        return mean, math.nan, math.nan
    from scipy.stats import t

    half = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / math.sqrt(n))
    return mean, mean - half, mean + half
