"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from markupsafe import Markup

from controller.measures.transient import ONSET_N
from controller.recording.reader import Run
from controller.reports.approaches import (
    NOISE,
    SAMPLE_HZ,
    ApproachedTrial,
    ColumnComparison,
    Mean,
    Row,
    StudyCell,
    compare_columns,
    fitted,
    read_approaches,
    study_cells,
    table_rows,
    trends,
)
from controller.reports.counts import beside_bound, values
from controller.reports.detector_scores import DetectorScore, score_detectors
from controller.reports.figures import Figures
from controller.reports.paper import CITATION, COLUMNS, RESONANCE, SETTLE, TABLE_1, PaperColumn
from controller.reports.run_account import setting_of
from controller.reports.section import Block, Column, Figure, Kind, Result, Section, Text
from controller.reports.section_texts import SectionTexts
from controller.reports.settings import shown
from controller.reports.text import NOTHING, number, share, signed, spread, title
from controller.reports.transient_figures import (
    draw_locations,
    draw_speeds,
    draw_study,
    draw_trial,
    representative,
    trace_of,
)

TEXTS = SectionTexts("transient")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Tables and figures of all approaches of some runs of equal settings on one kind of bench."""
    approaches = read_approaches(runs)
    rows = table_rows(approaches)
    beside = compare_columns(approaches, rows)
    acting = str(setting_of(runs[0], "behavior", "detector") or "contact")
    outcomes = Counter(each.outcome for each in approaches).most_common()
    other = _Beside(rows, acting)
    n = len(approaches)
    body: list[Block] = [
        TEXTS.text(
            "intro",
            onset=f"{ONSET_N:g}",
            approaches=f"{n} {'approach' if n == 1 else 'approaches'}",
            outcomes=", ".join(f"{count} {title(name)}" for name, count in outcomes),
        ),
        *(_beside_the_paper(runs[0], acting, approaches, rows, beside, other) if rows else ()),
        *_figures(figures, approaches, rows),
        *_study(figures, study_cells(approaches)),
        *_stops(approaches),
        TEXTS.table(
            "every_approach",
            [_by_name(each) for each in approaches],
            by_run=", run by run" if len(runs) > 1 else "",
        ),
    ]
    return Section(
        title="Stop at first contact (A2)",
        body=body,
        citation=CITATION,
        summary=_summary(approaches, beside, runs[0].simulated),
        not_the_papers=_not_the_papers(runs[0]),
        terminal=TEXTS.table("terminal", other.rows(rows), other.columns("mean_s")) if rows else None,
        printed=SETTLE | {f"detectors.{acting}.{name}": printed for name, printed in RESONANCE.items()},
    )


class _Beside:
    """Another detector that ran on the approaches of Table I, and its scores; `name` is "" without one."""

    def __init__(self, rows: Sequence[Row], acting: str) -> None:
        groups = [*(row.approaches for row in rows), [each for row in rows for each in row.approaches]]
        scores = [{each.name: each for each in score_detectors(group)} for group in groups]
        self.name = next((name for name in sorted(set().union(*scores)) if name != acting), "")
        *self.scores, self.all = (of.get(self.name) for of in scores)

    def columns(self, delay: str) -> list[Column]:
        """`delay` is what is printed of it: `delay_s` with its spread, or `mean_s`."""
        heads = (("n", "true", None), ("false", "false", None), ("s", delay, 2)) if self.name else ()
        return [
            Column(head, f"beside.{of}", decimals, group=f"detector {self.name}")
            for head, of, decimals in heads
        ]

    def rows(self, rows: Sequence[Row]) -> list[dict[str, Any]]:
        """Rows of Table I with its scores."""
        return [_table_row(row) | self._cells(score) for row, score in zip(rows, self.scores, strict=True)]

    @staticmethod
    def _cells(score: DetectorScore | None) -> dict[str, Any]:
        if score is None:
            return dict.fromkeys(("beside.true", "beside.false", "beside.delay_s", "beside.mean_s"))
        cells = {
            "true": score.true,
            "false": score.false,
            "delay_s": score.delay_s,
            "mean_s": score.delay_s.mean,
        }
        return {f"beside.{name}": value for name, value in cells.items()}


def _by_name(each: ApproachedTrial) -> dict[str, Any]:
    varied = ", ".join(f"{name} {shown(value)}" for name, value in each.varied.items())
    names = (
        "trial",
        "location",
        "speed_m_s",
        "baseline_hz",
        "threshold_hz",
        "delay_s",
        "extent_m",
        "force_n",
    )
    row = {name: getattr(each, name) for name in (*names, "force_peak_n", "false_contacts")}
    return row | {"outcome": title(each.outcome), "varied": varied}


def _beside_the_paper(
    run: Run,
    acting: str,
    approaches: Sequence[ApproachedTrial],
    rows: Sequence[Row],
    beside: Sequence[ColumnComparison],
    other: _Beside,
) -> Iterator[Block]:
    """Table I, its bounds and trends, and what of the contacts was false."""
    plain = [approach for approach in approaches if approach.plain]
    more = [
        Column(head, f"{each.name}.{whose}", look=look, group=f"{each.title}, {each.unit}")
        for each in COLUMNS
        for head, whose, look in (("here", "here", "mine"), ("paper", "paper", "theirs"), ("Δ", "off", ""))
    ]
    star = any(fitted(row, column) for row in rows for column in COLUMNS)
    asterisk = " An asterisk marks what the simulated finger was fitted to." if star else ""
    observer = TEXTS.sentence("beside", detector=other.name) if other.name else ""
    more += other.columns("delay_s")
    table = TEXTS.table("table_1", other.rows(rows), more, asterisk=asterisk, beside=observer)
    all_contacts = Row("", 0.0, plain, None)
    overall = [spread(all_contacts.mean(each.name), each.decimals, each.scale) for each in COLUMNS]
    foot = ["all true contacts", *[""] * 4, *(text for mean in overall for text in (mean, "", ""))]
    foot += [str(other.all.true), str(other.all.false), spread(other.all.delay_s)] if other.all else []
    yield replace(table, foot=foot)
    yield Text("The paper's bounds", heading=True)
    yield TEXTS.text("bounds_text")
    yield TEXTS.table("bounds", map(_bound, beside))
    yield Text("The paper's trends", heading=True)
    yield TEXTS.text("trends_text")
    yield TEXTS.table("trends", trends(rows))
    yield Text("False contacts and the detectors that only observed", heading=True)
    false = share(sum(each.false_contacts for each in plain), len(plain))
    yield TEXTS.text("false_text", false=false, learned=_learned(run, acting))
    scores = score_detectors(plain)
    if scores:
        yield TEXTS.table("detectors", scores)


def _summary(
    approaches: Sequence[ApproachedTrial], beside: Sequence[ColumnComparison], simulated: bool
) -> list[Result]:
    n = len(approaches)
    contacts = sum(each.detected for each in approaches)
    false = sum(each.false_contacts for each in approaches)
    results = [
        Result(
            None,
            f"{n} {'approach' if n == 1 else 'approaches'}: {contacts} stopped at a contact, {false} at a false contact"
            + (f", {n - contacts - false} otherwise." if n > contacts + false else "."),
        )
    ]
    results += [
        Result(Kind.PREDICTED if simulated else Kind.MEASURED, _compared(each), each.agrees)
        for each in beside
        if each.worst is not None
    ]
    peaks = [each.force_peak_n for each in approaches if each.detected and each.force_peak_n is not None]
    if peaks:
        results.append(
            Result(
                None,
                f"The instantaneous peak of the load cell, which the paper does not print, reaches "
                f"{number(max(peaks), 3)} N.",
            )
        )
    return results


def _compared(each: ColumnComparison) -> str:
    """`Time: 2.5 times quicker than Table I in 14 of 14 rows; mean 0.12 s, 2.4 times below the paper's 0.30 s.`"""
    column = each.column
    bound = (
        f"{column.over} {_printed(column, each.value)}, {beside_bound(each.value, column.bound)} the paper's "
    )
    bound += f"{_printed(column, column.bound)} ({column.source})"
    if each.effect is None:
        return f"{column.title.capitalize()} at detection: {bound}."
    scatter = {
        None: "",
        True: ", within the rows' scatter",
        False: ", beyond the rows' scatter",
    }[each.effect.agrees]
    return f"{column.title.capitalize()}: {each.effect.sentence(column.comparatives, 'Table I')}{scatter}; {bound}."


def _printed(column: PaperColumn, value: float) -> str:
    return f"{number(value, column.decimals, column.scale)} {column.unit}"


def _not_the_papers(run: Run) -> list[str]:
    speeds = [number(row.speed_m_s[0], 3, 1000.0) for row in TABLE_1 if row.fitted]
    text = TEXTS.sentence("fitted", speeds=", ".join(speeds), rest=len(TABLE_1) - len(speeds))
    return [*([text] if run.simulated else []), *TEXTS.each("ours")]


def _learned(run: Run, acting: str) -> str:
    """How many independent values the detector's baseline holds: what its threshold rests on."""
    names = ("baseline_s", "average_samples", "sample_hz")
    baseline_s, samples, rate_hz = (setting_of(run, "detectors", acting, name) for name in names)
    if not (baseline_s and samples and rate_hz):
        return ""
    independent = number(baseline_s * rate_hz / samples, 1)
    return TEXTS.sentence(
        "learned", baseline_s=baseline_s, samples=samples, rate_hz=rate_hz, independent=independent
    )


def _table_row(row: Row) -> dict[str, Any]:
    paper = row.paper
    cells: dict[str, Any] = {
        "where": f"{paper.side if paper else ''} {row.location}".strip(),
        "position_m": paper.micrometer_m if paper else None,
        "speed_m_s": row.speed_m_s,
        "n": len(row.contacts),
        "false_contacts": row.false_contacts,
    }
    for column in COLUMNS:
        here, shape = row.mean(column.name), (column.decimals, column.scale)
        theirs = getattr(paper, column.name) if paper else None
        printed = NOTHING if theirs is None else spread(Mean(theirs[0], theirs[1], 0), *shape)
        off = NOTHING if theirs is None else signed(here.mean - theirs[0], *shape)
        texts: dict[str, Any] = {
            "here": spread(here, *shape),
            "paper": printed,
            "off": off + " *" * fitted(row, column),
        }
        means = {"mean": here.mean, "printed": theirs[0] if theirs else None}
        cells |= {f"{column.name}.{whose}": value for whose, value in (texts | means).items()}
    return cells


def _bound(each: ColumnComparison) -> dict[str, Any]:
    column, worst = each.column, each.worst
    why = "No approach ended by a contact."
    if worst is not None:
        speed = f"{number(worst.speed_m_s, 2, 1000.0)} mm/s"
        why = f"Largest: {_printed(column, getattr(worst, column.name))} in trial {worst.trial}, "
        why += f"location {worst.location} at {speed}."
        why += _filter_share(worst) if column.name == "delay_s" else ""
        if column.name == "force_n":
            why += f" Its instantaneous peak, stop included, is {number(worst.force_peak_n, 3)} N."
    return {
        "what": f"{column.over} {column.title}",
        "limit": _printed(column, column.bound),
        "value": _printed(column, each.value) if worst else NOTHING,
        "effect": beside_bound(each.value, column.bound) if worst else NOTHING,
        "met": each.met,
        "why": why,
    }


def _filter_share(approach: ApproachedTrial) -> str:
    """What of the delay is the filter's: how long a window of contact takes to fill."""
    samples = approach.setting("detectors", approach.acting, "average_samples")
    rate_hz = approach.setting("detectors", approach.acting, "sample_hz")
    if not samples or not rate_hz:
        return ""
    window = number(samples / rate_hz)
    return f" The filter averages {samples} samples at {rate_hz:g} a second: its window is {window} s."


def _figures(figures: Figures, approaches: Sequence[ApproachedTrial], rows: Sequence[Row]) -> Iterator[Block]:
    """Figures 5, 7, 8 and 9, each only where these runs have a point for it."""
    example = representative([each for each in approaches if each.plain]) or representative(approaches)
    trace = trace_of(example) if example else None
    if trace and example:
        caption = TEXTS.sentence(
            "figure_5",
            trial=example.trial,
            location=example.location,
            speed=number(example.speed_m_s, 3, 1000.0),
            delay=number(example.delay_s),
            onset=f"{ONSET_N:g}",
            force=number(example.force_n, 3),
        )
        yield Figure(Markup(draw_trial(figures, trace)), caption)
    papers = [row.paper for row in rows if row.paper and row.contacts]
    for name, side in (("figure_7", "pad"), ("figure_8", "back")):
        if any(paper.side == side and paper.study == "location" for paper in papers):
            yield Figure(Markup(draw_locations(figures, rows, side)), TEXTS.sentence(name))
    if any(paper.location == "f" for paper in papers):
        yield Figure(Markup(draw_speeds(figures, rows)), TEXTS.sentence("figure_9"))


def _study(figures: Figures, cells: Sequence[StudyCell]) -> Iterator[Block]:
    """What varied settings do: a table with a column for each, and a figure where noise and rate are among them."""
    if not cells:
        return
    names = list(dict.fromkeys(name for cell in cells for name in cell.varied))
    rows = [
        {name: shown(cell.varied.get(name)) for name in names}
        | {"delay_s": cell.delay_s, "false": share(cell.false_contacts, cell.n)}
        for cell in cells
    ]
    yield Text("What varied settings do", heading=True)
    yield TEXTS.table("study", rows, [Column(name, name) for name in names])
    drawn = [
        (cell, {name: value for name, value in cell.varied.items() if name not in (NOISE, SAMPLE_HZ)})
        for cell in cells
        if NOISE in cell.varied and SAMPLE_HZ in cell.varied
    ]
    like = [cell for cell, rest in drawn if rest == drawn[0][1]]
    if len(like) > 1:
        rest = ", ".join(f"{name} {shown(value)}" for name, value in drawn[0][1].items())
        caption = TEXTS.sentence("figure_study", rest=f"; {rest}" if rest else "")
        yield Figure(Markup(draw_study(figures, like)), caption)


def _stops(approaches: Sequence[ApproachedTrial]) -> Iterator[Block]:
    """Median, 95th percentile by rank and largest of each span of the stop; and every stop."""
    rows = [
        {
            "trial": each.trial,
            "detect_s": each.detect_s,
            "to_command_s": _span(each.detect_s, each.command_s),
            "to_standstill_s": _span(each.command_s, each.standstill_s),
            "stop_travel_m": each.stop_travel_m,
            "force_peak_n": each.force_peak_n,
            "contact_peak_n": each.force_peak_n if each.detected else None,
            "acting": each.acting,
        }
        for each in approaches
    ]
    table = []
    for name, key, digits, scale in (
        ("detection to stop command, ms", "to_command_s", 2, 1000.0),
        ("command to standstill, ms", "to_standstill_s", 1, 1000.0),
        ("travel, detection to standstill, mm", "stop_travel_m", 3, 1000.0),
        ("peak force, N", "contact_peak_n", 3, 1.0),
    ):
        known = sorted(values(rows, key))
        if known:
            high = known[min(len(known) - 1, int(0.95 * len(known)))]
            three = {"median": statistics.median(known), "high": high, "largest": known[-1]}
            table.append({"name": name} | {key: number(value, digits, scale) for key, value in three.items()})
    yield Text("Stop certificates", heading=True)
    yield TEXTS.text("stops_text")
    if not table:
        yield Text("No approach ended at a detection.")
        return
    yield TEXTS.table("stops", table)
    yield TEXTS.table("every_stop", [row for row in rows if row["detect_s"] is not None])


def _span(start_s: float | None, end_s: float | None) -> float | None:
    return None if start_s is None or end_s is None else end_s - start_s
