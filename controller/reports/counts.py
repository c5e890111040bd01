"""What sections make of the rows of trials: sums, shares and rates with their 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scipy.stats import binomtest

from controller.reports.text import NOTHING, number


def rate(hits: int, of: int) -> str:
    """`96.1 % (94.9 to 97.1)`: a share with its 95 % interval (Wilson)."""
    if of == 0:
        return NOTHING
    low, high = binomtest(hits, of).proportion_ci(0.95, "wilson")
    return (
        f"{number(hits / of, 1, 100.0)} % ({number(float(low), 1, 100.0)} to {number(float(high), 1, 100.0)})"
    )


def total(rows: Sequence[Any], column: str) -> int:
    """Sum of a column over trials; empty cells count nothing."""
    return int(sum(row.get(column) or 0 for row in rows))


def values(rows: Sequence[Any], column: str) -> list[float]:
    """A column's numbers, empty cells left out."""
    return [float(row[column]) for row in rows if isinstance(row.get(column), int | float)]
