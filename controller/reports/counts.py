"""What sections make of the rows of trials: sums, shares and rates with their 95 % intervals, and what is missing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from controller.outcomes import UNMEASURED
from controller.recording.reader import Run
from controller.reports.text import number
from controller.scales import NOTHING

if TYPE_CHECKING:
    from drivers.core.settings import Settings


def wilson(hits: int, of: int) -> tuple[float, float]:
    """The 95 % interval (Wilson) of `hits` out of `of`, 0 to 1; NaN out of none."""
    if of == 0:
        return math.nan, math.nan
    share, z = hits / of, NormalDist().inv_cdf(0.975)
    middle = share + 0.5 * z**2 / of
    half = z * math.sqrt(share * (1.0 - share) / of + (0.5 * z / of) ** 2)
    return max(0.0, (middle - half) / (1.0 + z**2 / of)), min(1.0, (middle + half) / (1.0 + z**2 / of))


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


def factor_of(row: Mapping[str, Any], name: str, factors: type[Settings]) -> Any:
    """A trial's factor; the behavior's default where the trials do not vary it."""
    value = row.get(name)
    return factors.model_fields[name].default if value is None else value


def of_benches(runs: Sequence[Run], stream: str) -> Iterator[tuple[str, Sequence[Run], int]]:
    """Each bench, its runs, and how many samples of a stream were lost in them."""
    for bench in sorted({str(run.manifest.get("bench")) for run in runs}):
        own = [run for run in runs if str(run.manifest.get("bench")) == bench]
        yield bench, own, sum(int((run.manifest.get("loss") or {}).get(stream, 0)) for run in own)


def percentiles(spans_s: Sequence[float]) -> dict[str, float | int]:
    """How many, their median, 99th percentile and largest, by `n`, `p50.to_stop_s`, `p99.` and `p100.`."""
    spans = {f"p{p}.to_stop_s": float(np.percentile(spans_s, p)) for p in (50, 99, 100)}
    return {"n": len(spans_s)} | spans


class Effect(NamedTuple):
    """How far rows lie from the paper's.

    Attributes:
        ratio: Mean of ours over mean of the paper's.
        same: In how many rows ours lies on that side of the paper's.
        n: How many rows there are.
        low_high: 95 % interval of the mean difference, ours less the paper's (paired t); NaN for fewer than three rows.
    """

    ratio: float
    same: int
    n: int
    low_high: tuple[float, float]

    @property
    def agrees(self) -> bool | None:
        """Whether the rows' own scatter explains the difference; None for fewer than three rows."""
        low, high = self.low_high
        return None if math.isnan(low) else low <= 0.0 <= high

    def sentence(self, comparatives: tuple[str, str], than: str) -> str:
        """`2.5 times quicker than Table I in 14 of 14 rows`, by the comparative for less or for more."""
        times = f"{max(self.ratio, 1.0 / self.ratio):.1f} times"
        return f"{times} {comparatives[self.ratio > 1.0]} than {than} in {self.same} of {self.n} rows"


def effect(pairs: Sequence[tuple[float, float]]) -> Effect | None:
    """Effect over rows of (ours, the paper's); None without rows, or where a mean is not positive."""
    known = np.array([pair for pair in pairs if not any(map(math.isnan, pair))]).reshape(-1, 2)
    if not len(known) or known.mean(axis=0).min() <= 0.0:
        return None
    ours, paper = known.mean(axis=0)
    difference = known[:, 0] - known[:, 1]
    same = int((np.sign(difference) == np.sign(ours - paper)).sum())
    low, high = math.nan, math.nan
    if len(known) > 2:
        from scipy.special import stdtrit  # a fifth of a second, for few

        half = float(stdtrit(len(known) - 1, 0.975) * difference.std(ddof=1) / math.sqrt(len(known)))
        low, high = float(difference.mean()) - half, float(difference.mean()) + half
    return Effect(float(ours / paper), same, len(known), (low, high))


def beside_bound(value: float, bound: float) -> str:
    """`1.9 times below` or `1.2 times above`: a value beside a bound."""
    if not value > 0.0:
        return "below"
    return f"{bound / value:.1f} times below" if value <= bound else f"{value / bound:.1f} times above"


def missing(runs: Sequence[Run]) -> str:
    """Where trials are missing, how many; "" where all that were planned were measured.

    A trial that never began, or that an error ended, may be the one that would have missed: what was measured of a plan
    is reported, and not judged.
    """
    planned = sum(int(run.manifest.get("trials") or len(run.trials)) for run in runs)
    measured = sum(
        len({row["trial"] for row in run.trials if row.get("outcome") not in UNMEASURED}) for run in runs
    )
    if measured >= planned:
        return ""
    return f"{measured} of {planned} planned trials were measured: no verdict in these lines."
