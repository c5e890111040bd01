"""What sections make of the rows of trials: sums, shares and rates with their 95 % intervals, and what is missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from scipy.stats import binomtest

from controller.recording.reader import Run
from controller.reports.text import NOTHING, number

_NOT_MEASURED = ("guard", "fault", "aborted")


def wilson(hits: int, of: int) -> tuple[float, float]:
    """The 95 % interval (Wilson) of `hits` out of `of`, 0 to 1; NaN out of none."""
    if of == 0:
        return math.nan, math.nan
    low, high = binomtest(hits, of).proportion_ci(0.95, "wilson")
    return float(low), float(high)


def rate(hits: int, of: int) -> str:
    """`96.1 % (94.9 to 97.1)`: a share with its 95 % interval (Wilson)."""
    if of == 0:
        return NOTHING
    low, high = wilson(hits, of)
    return f"{percent(hits / of)} ({number(low, 1, 100.0)} to {number(high, 1, 100.0)})"


def percent(share: float) -> str:
    """`92.4 %`."""
    return f"{number(share, 1, 100.0)} %"


def total(rows: Sequence[Any], column: str) -> int:
    """Sum of a column over trials; empty cells count nothing."""
    return int(sum(row.get(column) or 0 for row in rows))


def values(rows: Sequence[Any], column: str) -> list[float]:
    """A column's numbers, empty cells left out."""
    return [float(row[column]) for row in rows if isinstance(row.get(column), int | float)]


def judged(runs: Sequence[Run], summary: Sequence[tuple[bool | None, str]]) -> list[tuple[bool | None, str]]:
    """A section's summary, without its verdicts where trials are missing, and then with how many.

    A trial that never began, or that an error ended, may be the one that would have missed: what was measured of a plan
    is told, and not judged.
    """
    planned = sum(int(run.manifest.get("trials") or len(run.trials)) for run in runs)
    measured = sum(
        len({row["trial"] for row in run.trials if row.get("outcome") not in _NOT_MEASURED}) for run in runs
    )
    if measured >= planned:
        return list(summary)
    missing = f"{measured} of {planned} planned trials were measured: no verdict in these lines."
    return [(None, missing), *((None, sentence) for _, sentence in summary)]
