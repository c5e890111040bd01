"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from markupsafe import Markup

from controller.measures.transient import ONSET_N
from controller.measures.truth import not_before
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
from controller.reports.run_account import acting_of, criterion_of, setting_of
from controller.reports.section import Block, Column, Figure, Kind, Printed, Result, Section, Text
from controller.reports.section_texts import SectionTexts
from controller.reports.settings import shown
from controller.reports.text import number, quantity, share, signed, spread, title
from controller.reports.transient_figures import (
    draw_locations,
    draw_speeds,
    draw_study,
    draw_trial,
    representative,
    trace_of,
)
from controller.scales import NOTHING, scale_of

TEXTS = SectionTexts("transient")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Tables and figures of all approaches of some runs of equal settings on one kind of bench."""
    approaches = read_approaches(runs)
    rows = table_rows(approaches)
    beside = compare_columns(approaches, rows)
    acting = acting_of(runs[0])
    outcomes = Counter(each.outcome for each in approaches).most_common()
    other = _Beside(rows, acting)
    n = len(approaches)
    body: list[Block] = [
        TEXTS.text(
            "intro",
            criterion=criterion_of(runs[0], acting),
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
        printed=SETTLE | _printed_of(runs[0]),
    )


def _printed_of(run: Run) -> dict[str, Printed]:
    """What the paper prints of its detector, by the path of the setting of each of that kind."""
    return {
        f"detectors.{detector}.{name}": printed
        for detector, table in (setting_of(run, "detectors") or {}).items()
        if table.get("kind") == "resonance.paper"
        for name, printed in RESONANCE.items()
    }


class _Beside:
    """Another detector that ran on the approaches of Table I, and its scores; `name` is "" without one."""

    def __init__(self, rows: Sequence[Row], acting: str) -> None:
        groups = [*(row.approaches for row in rows), [each for row in rows for each in row.approaches]]
        scores = [{each.name: each for each in score_detectors(group)} for group in groups]
        self.name = next((name for name in sorted(set().union(*scores)) if name != acting), "")
        *self.scores, self.all = (of.get(self.name) for of in scores)

    def columns(self, delay: str) -> list[Column]:
        """`delay` is what is printed of it: `delay_s` with its spread, or `mean_s`."""
        heads = (("n", "true", None), ("false", "false", None), ("", delay, 2)) if self.name else ()
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
        Column(head, f"{whose}.{each.name}", look=look, group=each.title)
        for each in COLUMNS
        for head, whose, look in (("here", "here", "mine"), ("paper", "paper", "theirs"), ("Δ", "off", ""))
    ]
    star = any(fitted(row, column) for row in rows for column in COLUMNS)
    asterisk = " An asterisk marks what the simulated finger was fitted to." if star else ""
    observer = TEXTS.sentence("beside", detector=other.name) if other.name else ""
    more += other.columns("delay_s")
    table = TEXTS.table("table_1", other.rows(rows), more, asterisk=asterisk, beside=observer, acting=acting)
    all_contacts = Row("", 0.0, plain, None)
    overall = [
        spread(all_contacts.mean(each.name), each.decimals, scale_of(each.name).factor) for each in COLUMNS
    ]
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
    noisy = sum(_onset_is_noise(each) for each in approaches)
    if noisy:
        results.append(
            Result(None, TEXTS.sentence("noisy", noisy=noisy, contacts=contacts, onset=f"{ONSET_N:g}"))
        )
    kind = Kind.PREDICTED if simulated else Kind.MEASURED
    results += [result for each in beside if each.worst for result in _compared(each, kind)]
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


def _onset_is_noise(each: ApproachedTrial) -> bool:
    """Whether the load cell reached its onset before the probe touched, where that is known."""
    onset_s, touch_s = each.onset_s, each.truth_contact_s
    return each.detected and onset_s is not None and touch_s is not None and not not_before(onset_s, touch_s)


def _compared(each: ColumnComparison, kind: Kind) -> Iterator[Result]:
    """A column beside Table I, and beside the bound that the paper states: one comparison, one verdict."""
    column = each.column
    name = column.title.capitalize()
    if each.effect is not None:
        agrees = each.effect.agrees
        scatter = {None: "", True: ", within the rows' scatter", False: ", beyond the rows' scatter"}[agrees]
        yield Result(
            kind, f"{name}: {each.effect.sentence(column.comparatives, 'Table I')}{scatter}.", agrees
        )
    bound = f"{beside_bound(each.value, column.bound)} the paper's {_printed(column, column.bound)}"
    text = f"{name} at detection: {column.over} {_printed(column, each.value)}, {bound} ({column.source})."
    yield Result(kind, text, each.met)


def _printed(column: PaperColumn, value: float) -> str:
    return quantity(column.name, value, column.decimals)


def _not_the_papers(run: Run) -> list[str]:
    speeds = [quantity("speed_m_s", row.speed_m_s[0], 3) for row in TABLE_1 if row.fitted]
    text = TEXTS.sentence("fitted", speeds=", ".join(speeds), rest=len(TABLE_1) - len(speeds))
    acting = acting_of(run)
    kind = setting_of(run, "detectors", acting, "kind")
    another = TEXTS.sentence("another", detector=acting, kind=kind)
    said = [another] * (kind != "resonance.paper") + [text] * run.simulated
    return [*said, *TEXTS.each("ours")]


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
        here, shape = row.mean(column.name), (column.decimals, scale_of(column.name).factor)
        theirs = getattr(paper, column.name) if paper else None
        printed = NOTHING if theirs is None else spread(Mean(theirs[0], theirs[1], 0), *shape)
        off = NOTHING if theirs is None else signed(here.mean - theirs[0], *shape)
        texts: dict[str, Any] = {
            "here": spread(here, *shape),
            "paper": printed,
            "off": off + " *" * fitted(row, column),
        }
        means = {"mean": here.mean, "printed": theirs[0] if theirs else None}
        cells |= {f"{whose}.{column.name}": value for whose, value in (texts | means).items()}
    return cells


def _bound(each: ColumnComparison) -> dict[str, Any]:
    column, worst = each.column, each.worst
    why = "No approach ended by a contact."
    if worst is not None:
        speed = quantity("speed_m_s", worst.speed_m_s)
        why = f"Largest: {_printed(column, getattr(worst, column.name))} in trial {worst.trial}, "
        why += f"location {worst.location} at {speed}."
        why += _filter_share(worst) if column.name == "delay_s" else ""
        if column.name == "force_n":
            why += f" Its instantaneous peak, stop included, is {quantity('force_peak_n', worst.force_peak_n, 3)}."
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
            speed=quantity("speed_m_s", example.speed_m_s, 3),
            delay=quantity("delay_s", example.delay_s),
            statistic=trace.label,
            onset=f"{ONSET_N:g}",
            force=quantity("force_n", example.force_n, 3),
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
        {name: cell.varied.get(name) for name in names}
        | {"delay_s": cell.delay_s, "false": share(cell.false_contacts, cell.n)}
        for cell in cells
    ]
    yield Text("What varied settings do", heading=True)
    yield TEXTS.table("study", rows, [Column(scale_of(name).label, name) for name in names])
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
    for name, key, digits in (
        ("detection to stop command", "to_command_s", 2),
        ("command to standstill", "to_standstill_s", 1),
        ("travel, detection to standstill", "stop_travel_m", 3),
        ("peak force of true contacts", "contact_peak_n", 3),
    ):
        known = sorted(values(rows, key))
        if known:
            high = known[min(len(known) - 1, int(0.95 * len(known)))]
            three = {"median": statistics.median(known), "high": high, "largest": known[-1]}
            _, unit, factor = scale_of(key)
            texts = {key: number(value, digits, factor) for key, value in three.items()}
            table.append({"name": f"{name}, {unit}"} | texts)
    yield Text("Stop certificates", heading=True)
    yield TEXTS.text("stops_text")
    if not table:
        yield Text("No approach ended at a detection.")
        return
    yield TEXTS.table("stops", table)
    yield TEXTS.table("every_stop", [row for row in rows if row["detect_s"] is not None])


def _span(start_s: float | None, end_s: float | None) -> float | None:
    return None if start_s is None or end_s is None else end_s - start_s
