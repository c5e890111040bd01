"""The numbers of A2: approaches read from runs, grouped, and compared with the paper's Table I, bounds and trends."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from controller.measures.trial import not_before
from controller.recording.reader import Run
from controller.reports.counts import (
    Comparison,
    Mean,
    Row,
    Trials,
    every,
    larger,
    mean_of,
    over_rows,
    within_scatter,
)
from controller.reports.papers import table
from controller.reports.settings import varied_of

TABLE_1 = table("backus_table_1")
"""Table I, in the paper's order."""

AT_F = [row for row in TABLE_1 if row["location"] == "f"]
"""Its rows by speed, in the middle of the pad (Fig. 9)."""

TRIALS = 3
"""Of each row of Table I. Not printed: three times each printed extent is an even multiple of a thousandth of an inch
(by chance one row in 17 is); twice, four and five times in six rows at most."""

BOUNDS = table("backus_bounds")
"""Columns of Table I (from onset to detection, and force at detection), each with the bound that the paper states."""

SPEED_TOLERANCE = 0.005
"""How near a trial's speed must be to a row's to belong to it, relative: half of Table I's last digit but one."""


def read_approaches(runs: Iterable[Run]) -> Trials:
    """Every trial of the runs, by run and number; `run` is its run, `varied` the settings it varied, by path."""
    return Trials(
        {**row, "run": run, "varied": varied_of(row)}
        for run in runs
        for row in sorted(Trials.of([run]), key=itemgetter("trial"))
    )


def stopped(row: Row) -> bool:
    """Whether it ended by a contact that was not seen to come before the touch, with a delay or without."""
    return bool(row["outcome"] == "contact")


def unjudged(row: Row) -> bool:
    """Whether nothing on its bench tells a true contact from a false one."""
    return stopped(row) and row.get("false_contacts") is None


def place_of(row: Row) -> str:
    """Letter of Fig. 6."""
    return str(row.get("location") or "f")


def speed_of(row: Row) -> float:
    """Of the probe, m/s; NaN where it is not known."""
    return math.nan if row.get("speed_m_s") is None else float(row["speed_m_s"])


class TableRow(NamedTuple):
    """The trials of one location and speed, with the paper's row where it has one."""

    location: str
    speed_m_s: float
    approaches: Trials
    paper: Row | None

    @property
    def contacts(self) -> Trials:
        """Those that ended by a true contact."""
        return self.approaches.where(stopped)

    def mean(self, column: str) -> Mean:
        """Mean of a column over the true contacts."""
        return self.contacts.mean(column)

    def fitted(self, bound: Row) -> bool:
        """Whether the simulated finger was fitted to this cell of Table I."""
        simulated = any(approach["run"].simulated for approach in self.approaches)
        return bool(simulated and self.paper and self.paper["fitted"] and bound["fitted"])


def table_rows(approaches: Trials) -> list[TableRow]:
    """Rows in the order of Table I, then those that the paper does not have, by location and speed; trials in which
    a setting was varied are in none."""
    found: dict[tuple[int, str, float], TableRow] = {}
    for each in approaches.where(varied={}):
        paper = row_of(each)
        place = TABLE_1.index(paper) if paper else len(TABLE_1)
        at = (paper["location"], paper["speed_m_s"]) if paper else (place_of(each), speed_of(each))
        found.setdefault((place, *at), TableRow(at[0], at[1], Trials(), paper)).approaches.append(each)
    return [found[key] for key in sorted(found)]


def row_of(approach: Row) -> dict[str, Any] | None:
    """The row of Table I that an approach belongs to."""
    for row in TABLE_1:
        times = speed_of(approach) / row["speed_m_s"]
        if place_of(approach) == row["location"] and abs(times - 1.0) <= SPEED_TOLERANCE:
            return row
    return None


def papers_mean(contacts: Trials, column: str, printed: float, source: str) -> tuple[float | None, str]:
    """The paper's mean that contacts stand beside, and where it stands.

    Returns:
        The printed one where each row of Table I has a contact, for it is over all of them; else that of the rows that
            have, each as often; None where a contact belongs to no row.
    """
    rows = [row_of(each) for each in contacts]
    known = [row for row in rows if row is not None]
    if not known or len(known) < len(rows):
        return None, ""
    if len({id(row) for row in known}) == len(TABLE_1):
        return printed, source
    return statistics.fmean(row[column] for row in known), "Table I, these rows"


class Bounded(NamedTuple):
    """A column of Table I over all true contacts, beside the paper.

    Attributes:
        bound: The paper's, of `BOUNDS`.
        beside: The largest, or the mean, beside the bound. Met where it is `kept`, and the rows no farther from the
            paper's than they scatter: kept because every row lies far below the paper's, it is no agreement (None).
        worst: The approach that has the largest; None where there is no contact.
        rows: Our rows beside the paper's, without those that the simulated finger was fitted to; None where no row has
            a contact.
        within, judged: How many of these lie within scatter (`within_scatter`), of those that have enough approaches.
        kept: Whether the bound alone is kept; None where too few approaches decide it.
    """

    bound: Row
    beside: Comparison
    worst: Row | None
    rows: Comparison | None
    within: int = 0
    judged: int = 0
    kept: bool | None = None

    @property
    def same(self) -> bool | None:
        """Whether it is the paper's: on average, and no more rows beyond scatter than chance has in 19 of 20 tables."""
        if self.rows is None or self.rows.met is None:
            return None
        from scipy.special import bdtrc

        off = self.judged - self.within
        return self.rows.met and (off == 0 or float(bdtrc(off - 1, self.judged, 0.05)) > 0.05)


def compare_columns(approaches: Trials, rows: Sequence[TableRow]) -> list[Bounded]:
    """Each column of Table I beside what the paper has; a mean is of the contacts that belong to its rows."""
    contacts = approaches.where(stopped, varied={})
    found = []
    for printed in BOUNDS:
        bound, column = printed, printed["column"]
        known = contacts.known(column)
        if bound["over"] == "mean":
            known, digits = known.where(row_of), len(f"{printed['bound']:g}".partition(".")[2])
            limit, source = papers_mean(known, column, printed["bound"], printed["source"])
            bound = printed | {"bound": math.nan if limit is None else limit, "source": source}
        worst = max(known, key=itemgetter(column), default=None)
        mean = known.mean(column)
        value = mean.mean if bound["over"] == "mean" else math.nan if worst is None else float(worst[column])
        own = [(row.mean(column), row.paper[column]) for row in rows if row.paper and not row.fitted(bound)]
        agree = over_rows((mean.mean, theirs) for mean, theirs in own)
        tests = [same for mean, theirs in own if (same := within_scatter(mean, theirs, TRIALS)) is not None]
        kept = every(sum(each > bound["bound"] for each in known.values(column)), len(known))
        if bound["over"] == "mean":
            kept = larger(Mean(bound["bound"] + 0.5 * 10.0**-digits, 0.0, 2), mean)
        met = kept if not kept else (agree and agree.met) or None
        beside = Comparison(value, bound["bound"], met, n=len(known))
        found.append(Bounded(bound, beside, worst, agree, sum(tests), len(tests), kept))
    return found


# --- the paper's trends ------------------------------------------------------------------------------


Correlation = tuple[float, int]
"""Spearman's rank correlation, NaN where fewer than three points or no spread; and of how many."""


def correlate(points: Sequence[tuple[float, float]]) -> Correlation:
    """Spearman's rank correlation of some points; without scipy.stats, which takes a tenth of a report to load."""
    if len(points) < 3 or min(len(set(each)) for each in zip(*points, strict=True)) < 2:
        return math.nan, len(points)
    ranks = []
    for column in np.array(points).T:
        _, places, counts = np.unique(column, return_inverse=True, return_counts=True)
        ranks.append((np.cumsum(counts) - 0.5 * (counts - 1))[places])  # equal ones share their mean rank
    return float(np.corrcoef(ranks)[0, 1]), len(points)


def trends(rows: Sequence[TableRow]) -> dict[str, tuple[Correlation, Correlation, Correlation]]:
    """Does force grow with speed at location f, and with nearness to the joint on pad and back? Ours over rows and over
    single approaches, and the paper's own rows."""
    found = {}
    for name, papers, along in (
        ("speed, at location f", AT_F, "speed_m_s"),
        ("nearness to the joint, pad", figure_rows("pad"), "micrometer_m"),
        ("nearness to the joint, back", figure_rows("back"), "micrometer_m"),
    ):
        mine = [
            (row.paper[along], row.contacts.values("force_n"))
            for row in rows
            if row.paper in papers and row.paper
        ]
        means = [(at, mean_of(forces_n).mean) for at, forces_n in mine if forces_n]
        single = [(at, force_n) for at, forces_n in mine for force_n in forces_n]
        printed = [(paper[along], paper["force_n"]) for paper in papers]
        found[name] = (correlate(means), correlate(single), correlate(printed))
    return found


def figure_rows(side: str) -> list[dict[str, Any]]:
    """Rows of the location study on one side (Fig. 7 the pad, Fig. 8 the back)."""
    return [row for row in TABLE_1 if row["study"] == "location" and row["side"] == side]


# --- other detectors --------------------------------------------------------------------------------


class DetectorScore(NamedTuple):
    """One detector over all approaches in which it ran, whether it stopped them or only observed.

    Attributes:
        n: How many approaches that tell a true contact from a false one.
        true: Contacts after the touch.
        delays_s: From onset, of each of them, by the approach's place; None where its onset is not known.
        false: Contacts before it.
        silent: Approaches that ended, stopped by another detector or at the limit, before it detected anything.
    """

    n: int
    true: int
    false: int
    silent: int
    delays_s: Mapping[int, float | None]

    @property
    def delay_s(self) -> Mean:
        """Over the true ones."""
        return mean_of(self.delays_s.values())


def score_detectors(approaches: Trials) -> Mapping[str, DetectorScore]:
    """First contact of each detector in each approach, against the truth where it is simulated, else the onset."""
    listening = {
        id(run): {str(e.get("detector")) for e in run.events if e["event"] in ("BaselineReady", "Contact")}
        for run in {id(each["run"]): each["run"] for each in approaches}.values()
    }
    scores = {}
    for name in sorted(set().union(*listening.values())):
        members = {
            place: each
            for place, each in enumerate(approaches)
            if name in listening[id(each["run"])] and not unjudged(each)
        }
        false, silent, delays_s = 0, 0, dict[int, float | None]()
        for place, each in members.items():
            t_s, onset_s, touch_s = _contact_s(each, name), each.get("onset_s"), each.get("truth_contact_s")
            touch_s = onset_s if touch_s is None else touch_s
            if t_s is None:
                silent += 1
            elif touch_s is None or not not_before(t_s, touch_s):
                false += 1
            else:
                delays_s[place] = None if onset_s is None else t_s - onset_s
        scores[name] = DetectorScore(len(members), len(delays_s), false, silent, delays_s)
    return scores


def _contact_s(approach: Row, detector: str) -> float | None:
    """Bench time of a detector's first contact in an approach; None where it reported none."""
    wanted = "Contact", "APPROACH", detector
    events = approach["run"].events_of(approach["trial"])
    own = (e for e in events if (e["event"], e.get("state"), e.get("detector")) == wanted)
    return next((float(e["t_s"]) for e in own), None)
