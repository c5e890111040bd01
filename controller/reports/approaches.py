"""The numbers of A2: approaches read from runs, grouped, averaged, compared with the paper's bounds and trends."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from controller.recording.reader import Run
from controller.reports.counts import Effect, effect
from controller.reports.paper import COLUMNS, TABLE_1, PaperColumn, PaperRow
from controller.reports.run_account import acting_of, setting_of
from controller.reports.settings import varied_of
from controller.reports.text import signed

SPEED_TOLERANCE = 0.005
"""How near a trial's speed must be to a row's to belong to it, relative: half of Table I's last digit but one."""

NOISE, SAMPLE_HZ = "plant.noise_scale", "detectors.contact.sample_hz"
BASELINE_S = "detectors.contact.baseline_s"
"""What the study of what the paper does not print varies."""


@dataclass(frozen=True, slots=True)
class ApproachedTrial:
    """One trial of A2, as trials.csv has it; None where not observed."""

    run: Run
    trial: int
    outcome: str
    location: str
    speed_m_s: float
    delay_s: float | None
    extent_m: float | None
    force_n: float | None
    force_peak_n: float | None
    false_contacts: int
    onset_s: float | None
    truth_contact_s: float | None
    detect_s: float | None
    command_s: float | None
    standstill_s: float | None
    stop_travel_m: float | None
    baseline_hz: float | None
    threshold_hz: float | None
    varied: Mapping[str, Any]
    """Settings of the profile that this trial varied, by path."""

    @property
    def detected(self) -> bool:
        """Whether it ended by a contact that was none before the touch."""
        return self.outcome == "contact" and self.delay_s is not None

    def setting(self, *path: str) -> Any:
        """A setting as this trial had it."""
        own = self.varied.get(".".join(path))
        return setting_of(self.run, *path) if own is None else own

    @property
    def acting(self) -> str:
        """Name of the detector that ends it."""
        return str(self.varied.get("behavior.detector") or acting_of(self.run))

    @property
    def plain(self) -> bool:
        """Whether nothing but speed and location was varied."""
        return not self.varied


def read_approaches(runs: Iterable[Run]) -> list[ApproachedTrial]:
    """Every trial of the runs, by run and number."""
    approaches = []
    for run in runs:
        for row in sorted(run.trials, key=lambda row: int(row["trial"] or 0)):
            cells = {**row, "noise_scale": row.get(NOISE), "sample_hz": row.get(SAMPLE_HZ)}
            cells["baseline_s"] = row.get(BASELINE_S)
            values: dict[str, Any] = {
                name: row.get(name) if isinstance(row.get(name), int | float) else None
                for name in ApproachedTrial.__dataclass_fields__
            }
            values |= {"run": run, "varied": varied_of(row), "outcome": str(row["outcome"])}
            values["location"] = str(row.get("location") or "f")
            values["speed_m_s"] = float(values["speed_m_s"] or math.nan)
            values["false_contacts"] = int(values["false_contacts"] or 0)
            approaches.append(ApproachedTrial(**values))
    return approaches


@dataclass(frozen=True, slots=True)
class Mean:
    """Mean and standard deviation (n - 1) of some trials; NaN where there are too few."""

    mean: float
    sigma: float
    n: int


def mean_of(values: Iterable[float | None]) -> Mean:
    """Mean and standard deviation of what is not None."""
    known = [value for value in values if value is not None]
    mean = statistics.fmean(known) if known else math.nan
    sigma = statistics.stdev(known) if len(known) > 1 else math.nan
    return Mean(mean, sigma, len(known))


@dataclass(frozen=True, slots=True)
class Row:
    """The trials of one location and speed, with the paper's row where it has one."""

    location: str
    speed_m_s: float
    approaches: Sequence[ApproachedTrial]
    paper: PaperRow | None

    @property
    def contacts(self) -> list[ApproachedTrial]:
        """Those that ended by a true contact."""
        return [approach for approach in self.approaches if approach.detected]

    @property
    def false_contacts(self) -> int:
        """How many alarmed before the touch."""
        return sum(approach.false_contacts for approach in self.approaches)

    def mean(self, measure: str) -> Mean:
        """Mean of a measure over the true contacts."""
        return mean_of(getattr(approach, measure) for approach in self.contacts)


def table_rows(approaches: Sequence[ApproachedTrial]) -> list[Row]:
    """Rows in the order of Table I, then those that the paper does not have, by location and speed."""
    rest = [approach for approach in approaches if approach.plain]
    rows = []
    for paper in TABLE_1:
        mine = [approach for approach in rest if _belongs(approach, paper)]
        rest = [approach for approach in rest if not _belongs(approach, paper)]
        if mine:
            rows.append(Row(paper.location, paper.speed_m_s[0], mine, paper))

    def key(approach: ApproachedTrial) -> tuple[str, float]:
        return approach.location, approach.speed_m_s

    for (location, speed_m_s), group in groupby(sorted(rest, key=key), key=key):
        rows.append(Row(location, speed_m_s, list(group), None))
    return rows


def _belongs(approach: ApproachedTrial, paper: PaperRow) -> bool:
    speed_m_s = paper.speed_m_s[0]
    return (
        approach.location == paper.location and abs(approach.speed_m_s / speed_m_s - 1.0) <= SPEED_TOLERANCE
    )


@dataclass(frozen=True, slots=True)
class ColumnComparison:
    """A column of Table I over all true contacts, beside the paper's bound and the paper's rows.

    Attributes:
        column: Which.
        value: What the bound is for: the largest, or the mean.
        worst: The approach that has the largest; None where there is no contact.
        effect: Our rows beside the paper's, without those that the simulated finger was fitted to; None where no row
            has a contact.
    """

    column: PaperColumn
    value: float
    worst: ApproachedTrial | None
    effect: Effect | None

    @property
    def agrees(self) -> bool | None:
        """Whether it is within the bound, and rows no farther from the paper's than they scatter; None where open."""
        if self.worst is not None and self.value > self.column.bound:
            return False
        return self.effect.agrees if self.effect is not None else None

    @property
    def met(self) -> bool | None:
        """Whether it is within the paper's bound, and its rows no farther from the paper's than they scatter.

        A bound that is met because every row lies far below the paper's is no agreement: None.
        """
        if self.worst is None:
            return None
        return False if self.value > self.column.bound else self.agrees or None


def compare_columns(approaches: Sequence[ApproachedTrial], rows: Sequence[Row]) -> list[ColumnComparison]:
    """Each column of Table I beside what the paper has."""
    contacts = [approach for approach in approaches if approach.detected and approach.plain]
    found = []
    for column in COLUMNS:
        known = [each for each in contacts if getattr(each, column.name) is not None]
        values = [float(getattr(each, column.name)) for each in known]
        worst = known[values.index(max(values))] if known else None
        value = mean_of(values).mean if column.over == "mean" else max(values, default=math.nan)
        pairs = [
            (row.mean(column.name).mean, getattr(row.paper, column.name)[0])
            for row in rows
            if row.paper and not fitted(row, column)
        ]
        found.append(ColumnComparison(column, value, worst, effect(pairs)))
    return found


def fitted(row: Row, column: PaperColumn) -> bool:
    """Whether the simulated finger was fitted to this cell of Table I."""
    simulated = any(approach.run.simulated for approach in row.approaches)
    return bool(simulated and row.paper and row.paper.fitted and column.fitted)


@dataclass(frozen=True, slots=True)
class Correlation:
    """Spearman's rank correlation; NaN where fewer than three points or no spread."""

    rho: float
    n: int

    def __str__(self) -> str:
        return f"{signed(self.rho)} (n = {self.n})"


@dataclass(frozen=True, slots=True)
class Trend:
    """Does force grow with something? Ours over rows and over single trials, and the paper's own rows."""

    name: str
    here: Correlation
    here_trials: Correlation
    paper: Correlation


def correlate(x: Sequence[float], y: Sequence[float]) -> Correlation:
    """Spearman's rank correlation of two equally long sequences."""
    if len(x) < 3 or len(set(x)) < 2 or len(set(y)) < 2:
        return Correlation(math.nan, len(x))
    from scipy.stats import spearmanr  # over half a second, for this part of the page alone

    return Correlation(float(spearmanr(x, y).statistic), len(x))


def trends(rows: Sequence[Row]) -> list[Trend]:
    """Force against speed at location f, and against nearness to the joint on pad and back."""

    def speed(row: PaperRow) -> float:
        return row.speed_m_s[0]

    def towards_joint(row: PaperRow) -> float:
        return row.micrometer_m

    paper_f = [row for row in TABLE_1 if row.location == "f"]
    return [
        _trend("speed, at location f", rows, paper_f, speed),
        *(
            _trend(f"nearness to the joint, {side}", rows, figure_rows(side), towards_joint)
            for side in ("pad", "back")
        ),
    ]


def figure_rows(side: str) -> list[PaperRow]:
    """Rows of the location study on one side (Fig. 7 the pad, Fig. 8 the back)."""
    return [row for row in TABLE_1 if row.study == "location" and row.side == side]


def _trend(
    name: str, rows: Sequence[Row], papers: Sequence[PaperRow], along: Callable[[PaperRow], float]
) -> Trend:
    mine = [(row, row.paper) for row in rows if row.paper in papers and row.mean("force_n").n]
    means = [(along(paper), row.mean("force_n").mean) for row, paper in mine if paper]
    single = [
        (along(paper), approach.force_n)
        for row, paper in mine
        if paper
        for approach in row.contacts
        if approach.force_n is not None
    ]
    printed = [(along(paper), paper.force_n[0]) for paper in papers]
    columns = [([x for x, _ in pairs], [y for _, y in pairs]) for pairs in (means, single, printed)]
    return Trend(name, *(correlate(x, y) for x, y in columns))


@dataclass(frozen=True, slots=True)
class StudyCell:
    """The trials in which the same settings were varied to the same values."""

    varied: Mapping[str, Any]
    delay_s: Mean
    false_contacts: int
    n: int


def study_cells(approaches: Sequence[ApproachedTrial]) -> list[StudyCell]:
    """Delay and false contacts by what was varied, sorted; empty where no run varied anything but speed and place."""

    def key(approach: ApproachedTrial) -> list[tuple[Any, ...]]:
        order = {BASELINE_S: 0, NOISE: 1, SAMPLE_HZ: 2}
        return sorted(
            (order.get(name, 3), name, value if isinstance(value, int | float) else math.inf, str(value))
            for name, value in approach.varied.items()
        )

    cells = []
    for _, group in groupby(sorted((each for each in approaches if each.varied), key=key), key=key):
        members = list(group)
        delay = mean_of(member.delay_s for member in members if member.detected)
        false = sum(member.false_contacts for member in members)
        cells.append(StudyCell(members[0].varied, delay, false, len(members)))
    return cells
