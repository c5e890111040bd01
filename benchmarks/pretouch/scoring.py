"""From detectors' events to rates with intervals; independent of how passages are simulated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Contact, ContactHeld, ContactLost, Detected, PreTouch
from controller.reports.counts import wilson

Floats = NDArray[np.float64]

EARLY_S, LATE_S = 0.02, 0.5
"""A contact counts as felt if it is reported no sooner than this before the touch, and no later than this after it; its
end likewise. Assumption: half a second is a third of the hold."""


@dataclass(frozen=True)
class Rate:
    """A count out of a total."""

    count: int
    of: int

    @property
    def share(self) -> float:
        """0 to 1, NaN of none."""
        return self.count / self.of if self.of else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 %, Wilson."""
        return wilson(self.count, self.of)

    def __str__(self) -> str:
        if not self.of:
            return "–"
        low, high = self.interval
        return f"{100 * self.share:.1f} ({100 * low:.1f} to {100 * high:.1f})"


def rate(answers: Iterable[bool]) -> Rate:
    """Rate of the true ones."""
    known = list(answers)
    return Rate(sum(known), len(known))


def seen_at(events: Sequence[Detected], begun_s: float, until_s: float) -> float:
    """When pre-touch was first reported in an approach, else NaN; an earlier event that still stands does not count."""
    return next(
        (event.t_s for event in events if isinstance(event, PreTouch) and begun_s <= event.t_s <= until_s),
        math.nan,
    )


def alarmed(events: Sequence[Detected], kind: type[Detected]) -> bool:
    """Whether there is such an event."""
    return any(type(event) is kind for event in events)


@dataclass(frozen=True)
class ScoredTouch:
    """Score of one touch.

    Attributes:
        delay_s: From touch to `Contact`, NaN where it was not felt in time.
        early: Contact was reported before the touch.
        held: It was felt, reported to persist, and not revoked before the end.
        ended: It was felt, and its end was reported in time.
    """

    delay_s: float
    early: bool
    held: bool
    ended: bool


def touch(events: Sequence[Detected], touched_s: float, released_s: float) -> ScoredTouch:
    """Score the events of one touch."""
    begins = [event.t_s for event in events if isinstance(event, Contact)]
    early = any(t_s < touched_s - EARLY_S for t_s in begins)
    felt_s = next(
        (t_s for t_s in begins if touched_s - EARLY_S <= t_s <= min(released_s, touched_s + LATE_S)), math.nan
    )
    if math.isnan(felt_s):
        return ScoredTouch(math.nan, early, False, False)
    lost_s = next((e.t_s for e in events if isinstance(e, ContactLost) and e.t_s > felt_s), math.inf)
    held = any(isinstance(event, ContactHeld) and felt_s < event.t_s <= released_s for event in events)
    kept = lost_s >= released_s - EARLY_S
    return ScoredTouch(felt_s - touched_s, early, held and kept, kept and lost_s <= released_s + LATE_S)


def quantiles(values: Sequence[float]) -> dict[str, float | None]:
    """10, 50 and 90 % quantiles of the values that are not NaN."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return {"p10": None, "median": None, "p90": None}
    low, middle, high = (float(value) for value in np.quantile(known, (0.1, 0.5, 0.9)))
    return {"p10": low, "median": middle, "p90": high}


def figures(found: Rate) -> dict[str, Any]:
    """For the JSON file."""
    low, high = found.interval
    numbers = (found.share, low, high)
    share, low_n, high_n = (None if math.isnan(value) else value for value in numbers)
    return {"count": found.count, "of": found.of, "share": share, "low": low_n, "high": high_n}


def threshold_at(maxima: Sequence[float], true_negative_rate: float) -> float:
    """The least threshold at which the given share of passages without an event stays quiet.

    Args:
        maxima: Largest statistic in each; one may equal the threshold.
        true_negative_rate: 0 to 1.
    """
    ordered = np.sort(np.asarray(maxima))
    return float(ordered[min(len(ordered) - 1, math.ceil(true_negative_rate * len(ordered)) - 1)])
