"""What sections make of the rows of trials: means, sums, shares and rates with 95 % intervals, as they are printed."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

import numpy as np

from controller.outcomes import UNMEASURED
from controller.recording.reader import Run
from controller.scales import NOTHING, figure, scale_of
from drivers.core.messages import Floats

if TYPE_CHECKING:
    from drivers.core.settings import Settings

Row = Mapping[str, Any]
"""A trial by its columns; or a line of a table, each cell under its heading."""

METHODS = {"paper": "the paper's", "ours": "ours"}
"""Whose detector: as columns end, and as it is printed."""


class Mean(NamedTuple):
    """Mean and standard deviation (n - 1) of some trials; NaN where there are too few."""

    mean: float
    sigma: float
    n: int


class Comparison(NamedTuple):
    """A figure of ours beside the paper's.

    Attributes:
        paper: The paper's, in the same unit.
        met: Whether ours comes out as the paper's; None where that is not judged.
        low, high: 95 % interval of ours, or over rows of the mean difference; NaN where there is too little data.
        n: Of how many.
    """

    ours: float
    paper: float
    met: bool | None = None
    low: float = math.nan
    high: float = math.nan
    n: int = 0

    @property
    def side(self) -> str:
        """Where ours lies."""
        return "below" if self.ours < self.paper else "above"

    def off(self, name: str, digits: int = 1) -> str:
        """`0.3 Hz below`: the difference in the unit of a column's name; `the same as` where it is rounded to zero."""
        difference = round(self.ours - self.paper, digits)
        return f"{quantity(name, abs(difference), digits)} {self.side}" if difference else "the same as"


def over_rows(pairs: Iterable[tuple[float, float]]) -> Comparison | None:
    """Rows of (ours, the paper's), which agree where their own scatter explains the difference (paired t); not judged
    for fewer than three. None without rows, or where a mean is not positive."""
    known = np.array([pair for pair in pairs if not any(map(math.isnan, pair))]).reshape(-1, 2)
    if not len(known) or known.mean(axis=0).min() <= 0.0:
        return None
    ours, paper = map(float, known.mean(axis=0))
    difference = known[:, 0] - known[:, 1]
    if len(known) < 3:
        return Comparison(ours, paper, n=len(known))
    mean = mean_of(difference.tolist())
    low, high = mean.mean - half_width(mean), mean.mean + half_width(mean)
    return Comparison(ours, paper, low <= 0.0 <= high, low, high, len(known))


def within_scatter(ours: Mean, paper: float, n: int) -> bool | None:
    """Whether the paper's mean of `n` trials lies where the mean of so many of ours does in 95 of 100 cases (Student's
    t, of our scatter); None for fewer than three of ours."""
    if ours.n < 3 or math.isnan(ours.mean):
        return None
    return abs(ours.mean - paper) <= half_width(ours) * math.sqrt(1.0 + ours.n / n)


def wilson(hits: int, of: int) -> tuple[float, float]:
    """The 95 % interval (Wilson) of `hits` out of `of`, 0 to 1; NaN out of none."""
    if of == 0:
        return math.nan, math.nan
    share, z = hits / of, NormalDist().inv_cdf(0.975)
    middle = share + 0.5 * z**2 / of
    half = z * math.sqrt(share * (1.0 - share) / of + (0.5 * z / of) ** 2)
    return max(0.0, (middle - half) / (1.0 + z**2 / of)), min(1.0, (middle + half) / (1.0 + z**2 / of))


def sure(yes: bool, no: bool) -> bool | None:
    """A verdict where the data decide it, else None."""
    return True if yes else False if no else None


def decided(hits: int, of: int, least: float) -> bool | None:
    """Whether a share is at least `least`, or below it: where its 95 % interval (Wilson) says so, else None."""
    low, high = wilson(hits, of)
    return sure(low >= least, high < least)


def paired(pairs: Iterable[Sequence[float]]) -> bool | None:
    """Whether the first of two hit more often in the same trials than the second: where the exact sign test over trials
    in which they differ (McNemar) says so at 95 % confidence, else None."""
    from scipy.special import bdtr

    found = list(pairs)
    first, second = sum(a > b for a, b in found), sum(a < b for a, b in found)
    told = float(bdtr(min(first, second), first + second, 0.5)) <= 0.025
    return sure(told and first > second, told and first < second)


def every(beyond: int, of: int) -> bool | None:
    """Whether every trial keeps a bound: not where one is beyond it; where none is, once that shows at 95 % confidence
    that nine in ten do (29 trials), else None."""
    return False if beyond else True if of and 0.05 ** (1.0 / of) >= 0.9 else None


def half_width(mean: Mean) -> float:
    """Half of the 95 % interval of a mean (Student's t); infinite for fewer than two trials."""
    if mean.n < 2:
        return math.inf
    from scipy.special import stdtrit  # a fifth of a second, for few

    return float(stdtrit(mean.n - 1, 0.975)) * mean.sigma / math.sqrt(mean.n)


def near(mean: Mean, aim: float, within: float) -> bool | None:
    """Whether a mean is within so much of what is aimed at: where its whole 95 % interval is, or none of it; else
    None."""
    off, half = abs(mean.mean - aim), half_width(mean)
    return sure(off + half <= within, off - half > within)


def median_within(ascending: Floats) -> tuple[float, float]:
    """The 95 % interval of a median, from ranks; from 0 to infinity where there are fewer than six values."""
    from scipy.special import bdtr

    n = len(ascending)
    # so many of the values on either side may be left out
    below = int((bdtr(np.arange(n), n, 0.5) <= 0.025).sum())
    return (float(ascending[below - 1]), float(ascending[n - below])) if below else (0.0, math.inf)


def larger(one: Mean, other: Mean) -> bool | None:
    """Whether a mean is larger than another: where the 95 % intervals of the two, added as independent errors are, do
    not reach from one to the other; else None."""
    off, half = one.mean - other.mean, math.hypot(half_width(one), half_width(other))
    return sure(off > half, -off > half)


def all_of(verdicts: Iterable[bool | None]) -> bool | None:
    """Whether all hold: one that does not decides it, one that is not decided leaves it open."""
    found = list(verdicts)
    return False if False in found else None if None in found or not found else True


def rate(hits: int, of: int) -> str:
    """`96.1 % (94.9 to 97.1)`: a share with its 95 % interval (Wilson)."""
    if of == 0:
        return NOTHING
    low, high = wilson(hits, of)
    return f"{percent(hits / of)} ({number(low, 1, 100.0)} to {number(high, 1, 100.0)})"


def percent(part: float) -> str:
    """`92.4 %`."""
    return f"{number(part, 1, 100.0)} %"


def within_all(n: int) -> str:
    """At least what share of trials lies within the largest of `n`, at 95 % confidence."""
    return f"{math.floor(100.0 * 0.05 ** (1.0 / n))} % or more"


def three(value: float) -> str:
    """Three significant digits: what a first look takes in."""
    return f"{value:,.0f}" if abs(value) >= 1000.0 else figure(float(f"{value:.3g}"))


def share(part: int, whole: int) -> str:
    """`3 of 42 (7 %)`."""
    return f"{part} of {whole} ({100.0 * part / whole:.0f} %)" if whole else "none of 0"


def mean_of(known: Iterable[float | None]) -> Mean:
    """Mean and standard deviation of what is not None."""
    found = [value for value in known if value is not None]
    mean = statistics.fmean(found) if found else math.nan
    return Mean(mean, statistics.stdev(found) if len(found) > 1 else math.nan, len(found))


def is_number(value: object) -> TypeGuard[float]:
    """Whether a cell holds a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _misplaced(name: str, cell: object) -> bool:
    return isinstance(cell, str) and bool(scale_of(name).unit)


def _numbers_first(cell: object) -> tuple[int, float, str]:
    return (0, float(cell), "") if is_number(cell) else (1, 0.0, str(cell))


class Trials(list[Row]):
    """Some trials, row by row, as sections count and average them; empty cells count nothing."""

    @classmethod
    def of(cls, runs: Iterable[Run], factors: type[Settings] | None = None) -> Trials:
        """All trials but those that were broken off; a factor that a trial does not vary is the behavior's default, and
        text in a column whose name has a unit an empty cell."""
        fields = factors.model_fields if factors else {}
        usual = {name: field.default for name, field in fields.items() if not field.is_required()}
        return cls(
            usual | {name: cell for name, cell in known.items() if cell is not None or name not in usual}
            for run in runs
            for row in run.trials
            if row.get("outcome") not in UNMEASURED
            for known in [{name: None if _misplaced(name, cell) else cell for name, cell in row.items()}]
        )

    def known(self, *columns: str) -> Trials:
        """Those that have all these cells."""
        return Trials(row for row in self if all(row.get(column) is not None for column in columns))

    def where(self, keep: Callable[[Row], object] = bool, /, **cells: object) -> Trials:
        """Those that are to be kept, and have these cells."""
        return Trials(row for row in self if keep(row) and all(row.get(k) == v for k, v in cells.items()))

    def by(self, *names: str, order: Callable[[Any], Any] = _numbers_first) -> dict[tuple[Any, ...], Trials]:
        """Trials of equal cells together, sorted by these (by `order` of each)."""

        def key(row: Row) -> tuple[Any, ...]:
            return tuple(order(row.get(name)) for name in names)

        groups = [Trials(group) for _, group in groupby(sorted(self, key=key), key=key)]
        return {tuple(group[0].get(name) for name in names): group for group in groups}

    def values(self, column: str) -> list[float]:
        """A column's numbers."""
        cells = (row.get(column) for row in self)
        return [float(cell) for cell in cells if isinstance(cell, int | float) and math.isfinite(cell)]

    def total(self, column: str) -> int:
        """Sum of a column."""
        return int(sum(self.values(column)))

    def median(self, column: str) -> float | None:
        """Of a column; None where all its cells are empty."""
        return statistics.median(found) if (found := self.values(column)) else None

    def mean(self, column: str) -> Mean:
        """Mean and standard deviation of a column."""
        return mean_of(self.values(column))


def pairs_of(first: Run, second: Run, one: Trials, other: Trials) -> list[tuple[Row, Row]]:
    """Of some trials of two runs those that have the same number and the same factors, of those that both runs have."""
    names = ["trial", *(name for name in first.factors if name in second.factors)]
    theirs = {tuple(row.get(name) for name in names): row for row in other}
    keys = [(row, tuple(row.get(name) for name in names)) for row in one]
    return [(row, theirs[key]) for row, key in keys if key in theirs]


def tails(rows: Trials, *columns: str) -> list[Row]:
    """A line for each column that has a number, of what must be small in every trial: how many, the median, the 95th
    percentile by rank, the largest."""
    lines: list[Row] = []
    for name in columns:
        if known := sorted(rows.values(name)):
            scale, high = scale_of(name), known[min(len(known) - 1, int(0.95 * len(known)))]
            ends = {"median": statistics.median(known), "95th percentile": high, "largest": known[-1]}
            cells = {head: scale.cell(value) for head, value in ends.items()}
            lines.append({"of a stop": scale.heading, "n": len(known), **cells})
    return lines


def missing(runs: Sequence[Run]) -> str:
    """Where trials are missing, how many; "" where all that were planned were measured.

    A trial that never began, or that an error ended, may be the one that would have missed: what was measured of a plan
    is reported, and not judged.
    """
    planned = sum(int(run.manifest.get("trials") or len(run.trials)) for run in runs)
    rows = [(place, row) for place, run in enumerate(runs) for row in run.trials]
    measured = len({(place, row["trial"]) for place, row in rows if row.get("outcome") not in UNMEASURED})
    if measured >= planned:
        return ""
    return f"{measured} of {planned} planned trials were measured: no verdict in these lines."


# --- as it is printed --------------------------------------------------------------------------------


def number(value: object, digits: int = 2, scale: float = 1.0) -> str:
    """A number times `scale` with a fixed number of decimals, without the sign of what is rounded to zero; a dash for
    None and NaN.
    """
    if not isinstance(value, int | float) or math.isnan(value):
        return NOTHING
    return f"{value * scale:z.{digits}f}".replace("-", "−")


def quantity(name: str, value: object, digits: int = 2) -> str:
    """A column's value with its unit, for a sentence: `3.81 mm`."""
    scale = scale_of(name)
    return f"{number(value, digits, scale.factor)} {scale.unit}".rstrip()


def sized(ours: float, paper: float, unit: str = "") -> str:
    """`12 times faster`, `8.5 % larger`: by how much ours differs from the paper's; "" where one of them is not
    positive."""
    if min(ours, paper) <= 0.0:
        return ""
    ratio = max(ours, paper) / min(ours, paper)
    by = (
        f"{three(float(f'{ratio:.2g}'))} times"
        if ratio >= 1.5
        else f"{100.0 * abs(ours / paper - 1.0):.2g} %"
    )
    words = ("faster", "slower") if unit in ("s", "ms") else ("smaller", "larger")
    return f"{by} {words[ours > paper]}"


def signed(value: float, digits: int = 2, scale: float = 1.0) -> str:
    """A difference, with its sign."""
    return "+" * (round(value * scale, digits) > 0.0) + number(value, digits, scale)


def spread(mean: Mean, digits: int = 2, scale: float = 1.0) -> str:
    """`mean (sigma)`, as Table I prints it."""
    if math.isnan(mean.mean):
        return NOTHING
    return f"{number(mean.mean, digits, scale)} ({number(mean.sigma, digits, scale)})"


def with_spread(mean: Mean, factor: float) -> str:
    """`0.1396 ± 0.021 (3)`: mean, standard deviation (n - 1), n."""
    if not mean.n:
        return NOTHING
    sigma = f" ± {mean.sigma * factor:.2g}" if mean.n > 1 else ""
    return f"{figure(mean.mean * factor)}{sigma} ({mean.n})"


def under(name: str, value: object, head: str | None = None, digits: int | None = None) -> dict[str, str]:
    """A cell of a table under its heading with the unit of a column's name: `{"delay, s": "0.33"}`.

    Args:
        name: Of the column: unit and scale are its name's.
        value: A number, or text, which is kept.
        head: In place of the name's label; "" is the unit alone.
        digits: Decimals; by default four significant digits.
    """
    scale = scale_of(name)
    label = scale.label if head is None else head
    plain = digits is None or isinstance(value, str)
    cell = scale.cell(value) if plain else number(value, digits or 0, scale.factor)
    return {", ".join(filter(None, (label, scale.unit))): cell}


def title(name: str) -> str:
    """An identifier as text: `no_contact` as `no contact`."""
    return name.replace("_", " ")
