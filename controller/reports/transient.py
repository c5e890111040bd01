"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from controller.measures.transient import ONSET_N
from controller.recording.reader import Run
from controller.reports.approaches import (
    NOISE,
    SAMPLE_HZ,
    Approach,
    Correlation,
    Held,
    Mean,
    Row,
    StudyCell,
    fitted,
    held,
    read_approaches,
    study_cells,
    table_rows,
    trends,
)
from controller.reports.counts import factor
from controller.reports.detector_scores import score_detectors
from controller.reports.figures import Figures
from controller.reports.paper import CITATION, COLUMNS, RESONANCE, SETTLE, TABLE_1, Column
from controller.reports.run_account import setting_of
from controller.reports.section import Kind, Result, Section
from controller.reports.settings import shown
from controller.reports.text import NOTHING, number, share, signed, spread, title
from controller.reports.transient_figures import (
    Trace,
    draw_locations,
    draw_speeds,
    draw_study,
    draw_trial,
    representative,
    trace_of,
)


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Tables and figures of all approaches of some runs of equal settings on one kind of bench."""
    approaches = read_approaches(runs)
    plain = [approach for approach in approaches if approach.plain]
    rows = table_rows(approaches)
    beside = held(approaches, rows)
    cells = study_cells(approaches)
    example = representative(plain) or representative(approaches)
    trace = trace_of(example) if example else None
    acting = str(setting_of(runs[0], "behavior", "detector") or "contact")
    return Section(
        title="Stop at first contact (A2)",
        template="transient.html.j2",
        citation=CITATION,
        summary=_summary(approaches, beside, runs[0].simulated),
        not_the_papers=_not_the_papers(runs[0], rows),
        printed=SETTLE | {f"detectors.{acting}.{name}": printed for name, printed in RESONANCE.items()},
        context={
            "trials": len(approaches),
            "outcomes": _outcomes(approaches),
            "onset_n": f"{ONSET_N:g}",
            "columns": COLUMNS,
            "rows": [_table_row(row) for row in rows],
            "fitted": any(fitted(row, column) for row in rows for column in COLUMNS),
            "overall": [spread(_overall(plain, each.name), each.decimals, each.scale) for each in COLUMNS],
            "bounds": [_bound(each) for each in beside],
            "trends": [
                (trend.name, _rho(trend.ours), _rho(trend.ours_trials), _rho(trend.paper))
                for trend in trends(rows)
            ],
            "false": share(sum(each.false_contacts for each in plain), len(plain)),
            "learned": _learned(runs[0], acting),
            "detectors": [
                (score.name, score.n, score.true, score.false, score.silent, spread(score.delay_s))
                for score in score_detectors(plain)
            ],
            "figure_5": Markup(draw_trial(figures, trace)) if trace else "",
            "figure_5_says": _figure_5_says(trace) if trace else "",
            **_row_figures(figures, rows),
            **_study(figures, cells),
            "stops": _stops(approaches),
            "stop_rows": [_stop_row(each) for each in approaches if each.detect_s is not None],
            "trial_rows": [_trial_row(each) for each in approaches],
            "many_runs": len(runs) > 1,
        },
    )


def _summary(approaches: Sequence[Approach], beside: Sequence[Held], simulated: bool) -> list[Result]:
    n = len(approaches)
    contacts = sum(each.detected for each in approaches)
    false = sum(each.false_contacts for each in approaches)
    said = [
        Result(
            None,
            f"{n} {'approach' if n == 1 else 'approaches'}: {contacts} stopped at a contact, {false} at a false contact"
            + (f", {n - contacts - false} otherwise." if n > contacts + false else "."),
        )
    ]
    said += [
        Result(Kind.PREDICTED if simulated else Kind.MEASURED, _compared(each), each.agrees)
        for each in beside
        if each.worst is not None
    ]
    peaks = [each.force_peak_n for each in approaches if each.detected and each.force_peak_n is not None]
    if peaks:
        said.append(
            Result(
                None,
                f"The instantaneous peak of the load cell, which the paper does not print, reaches "
                f"{number(max(peaks), 3)} N.",
            )
        )
    return said


def _compared(each: Held) -> str:
    """`Time: 2.5 times quicker than Table I in 14 of 14 rows; mean 0.12 s, 2.4 times below the paper's 0.30 s.`"""
    column = each.column
    bound = f"{column.over} {_printed(column, each.value)}, {factor(each.value, column.bound)} the paper's "
    bound += f"{_printed(column, column.bound)} ({column.source})"
    if each.effect is None:
        return f"{column.title.capitalize()} at detection: {bound}."
    scatter = {
        None: "",
        True: ", within the rows' scatter",
        False: ", beyond the rows' scatter",
    }[each.effect.agrees]
    return f"{column.title.capitalize()}: {each.effect.said(column.words, 'Table I')}{scatter}; {bound}."


def _printed(column: Column, value: float) -> str:
    return f"{number(value, column.decimals, column.scale)} {column.unit}"


def _not_the_papers(run: Run, rows: Sequence[Row]) -> list[str]:
    said = [
        "Zero of the micrometer is taken as distal, and f as the middle of the pad: both are inferred.",
        "The rate at which the frequency is sampled is not printed; here it is a setting.",
        "A contact before the probe touches is counted as false. The paper counts none.",
        "Force at detection is the load cell's mean over the last oscillation; the peak has a column of its own.",
    ]
    if run.simulated:
        speeds = [number(row.speed_m_s[0], 3, 1000.0) for row in TABLE_1 if row.fitted]
        said.insert(
            0,
            "The model is fitted to the paper's static facts and to one compliance, from force and extent at location "
            f"f at {', '.join(speeds)} mm/s: those forces are not held against the paper's. The other "
            f"{len(TABLE_1) - len(speeds)} rows of Table I set no number. They were not blind, though: the slow "
            "wander of the stiffness, an assumption that the delays depend on, was chosen with the table in view.",
        )
    return said


def _learned(run: Run, acting: str) -> str:
    """How many independent values the detector's baseline holds: what its threshold rests on."""
    baseline_s, samples, rate_hz = (
        setting_of(run, "detectors", acting, name) for name in ("baseline_s", "average_samples", "sample_hz")
    )
    if not (baseline_s and samples and rate_hz):
        return ""
    return (
        f"A baseline of {baseline_s:g} s of {samples}-sample averages at {rate_hz:g} a second holds some "
        f"{number(baseline_s * rate_hz / samples, 1)} independent values to learn mean and σ from."
    )


def _outcomes(approaches: Sequence[Approach]) -> str:
    counts: dict[str, int] = {}
    for each in approaches:
        counts[each.outcome] = counts.get(each.outcome, 0) + 1
    return ", ".join(
        f"{count} {title(name)}" for name, count in sorted(counts.items(), key=lambda item: -item[1])
    )


def _overall(approaches: Sequence[Approach], measure: str) -> Mean:
    return Row("", 0.0, approaches, None).mean(measure)


def _table_row(row: Row) -> dict[str, Any]:
    paper = row.paper
    cells = []
    for column in COLUMNS:
        ours, shape = row.mean(column.name), (column.decimals, column.scale)
        theirs = getattr(paper, column.name) if paper else None
        printed = NOTHING if theirs is None else spread(Mean(theirs[0], theirs[1], 0), *shape)
        difference = NOTHING if theirs is None else signed(ours.mean - theirs[0], *shape)
        cells.append(
            (spread(ours, *shape), printed, f"{difference} *" if fitted(row, column) else difference)
        )
    return {
        "side": paper.side if paper else "",
        "location": row.location,
        "position": number(paper.micrometer_m, 2, 1000.0) if paper else NOTHING,
        "speed": number(row.speed_m_s, 3, 1000.0),
        "n": len(row.contacts),
        "false": row.false_contacts,
        "cells": cells,
    }


def _bound(each: Held) -> dict[str, Any]:
    column, worst = each.column, each.worst
    why = "No approach ended by a contact."
    if worst is not None:
        speed = f"{number(worst.speed_m_s, 2, 1000.0)} mm/s"
        why = f"Largest: {_printed(column, getattr(worst, column.name))} in trial {worst.trial}, "
        why += f"location {worst.location} at {speed}."
        why += _filter_says(worst) if column.name == "delay_s" else ""
        if column.name == "force_n":
            why += f" Its instantaneous peak, stop included, is {number(worst.force_peak_n, 3)} N."
    return {
        "what": f"{column.over} {column.title}",
        "limit": _printed(column, column.bound),
        "value": _printed(column, each.value) if worst else NOTHING,
        "effect": factor(each.value, column.bound) if worst else NOTHING,
        "met": each.met,
        "why": why,
    }


def _filter_says(approach: Approach) -> str:
    """What of the delay is the filter's: how long a window of contact takes to fill."""
    samples = approach.setting("detectors", approach.acting, "average_samples")
    rate_hz = approach.setting("detectors", approach.acting, "sample_hz")
    if not samples or not rate_hz:
        return ""
    window = number(samples / rate_hz)
    return f" The filter averages {samples} samples at {rate_hz:g} a second: its window is {window} s."


def _study(figures: Figures, cells: Sequence[StudyCell]) -> dict[str, Any]:
    """What varied settings do: a table with a column for each, and a figure where noise and rate are among them."""
    names = list(dict.fromkeys(name for cell in cells for name in cell.varied))
    drawn = [cell for cell in cells if NOISE in cell.varied and SAMPLE_HZ in cell.varied]
    rest = [
        {name: value for name, value in cell.varied.items() if name not in (NOISE, SAMPLE_HZ)}
        for cell in drawn
    ]
    drawn = [cell for cell, others in zip(drawn, rest, strict=True) if others == rest[0]]
    return {
        "study_head": names,
        "study": [
            (
                *(shown(cell.varied.get(name)) for name in names),
                spread(cell.delay_s),
                share(cell.false_contacts, cell.n),
            )
            for cell in cells
        ],
        "figure_study": Markup(draw_study(figures, drawn)) if len(drawn) > 1 else "",
        "figure_study_rest": ", ".join(f"{name} {shown(value)}" for name, value in rest[0].items())
        if rest
        else "",
    }


def _rho(correlation: Correlation) -> str:
    text = signed(correlation.rho)
    return f"{text} (n = {correlation.n})" if text != NOTHING else f"{NOTHING} (n = {correlation.n})"


def _figure_5_says(trace: Trace) -> str:
    approach = trace.approach
    return (
        f"Trial {approach.trial}: location {approach.location}, {number(approach.speed_m_s, 3, 1000.0)} mm/s. "
        f"Detected {number(approach.delay_s)} s after the load cell reached {ONSET_N:g} N, "
        f"at {number(approach.force_n, 3)} N. "
        "The paper's example, at the distal end at 4.47 mm/s, took 0.5 s and 0.03 N."
    )


def _row_figures(figures: Figures, rows: Sequence[Row]) -> dict[str, Markup | str]:
    """Figures 7, 8 and 9, each only where this run has a point for it."""
    drawn: dict[str, Markup | str] = {"figure_7": "", "figure_8": "", "figure_9": ""}
    papers = [row.paper for row in rows if row.paper and row.contacts]
    for name, side in (("figure_7", "pad"), ("figure_8", "back")):
        if any(paper.side == side and paper.study == "location" for paper in papers):
            drawn[name] = Markup(draw_locations(figures, rows, side))
    if any(paper.location == "f" for paper in papers):
        drawn["figure_9"] = Markup(draw_speeds(figures, rows))
    return drawn


def _stops(approaches: Sequence[Approach]) -> list[tuple[str, ...]]:
    """Median, 95th percentile by rank and largest of each span of the stop."""
    spans = (
        (
            "detection to stop command, ms",
            2,
            1000.0,
            [_span(each.detect_s, each.command_s) for each in approaches],
        ),
        (
            "command to standstill, ms",
            1,
            1000.0,
            [_span(each.command_s, each.standstill_s) for each in approaches],
        ),
        ("travel, detection to standstill, mm", 3, 1000.0, [each.stop_travel_m for each in approaches]),
        ("peak force, N", 3, 1.0, [each.force_peak_n for each in approaches if each.detected]),
    )
    table = []
    for name, digits, scale, values in spans:
        known = sorted(value for value in values if value is not None)
        if known:
            high = known[min(len(known) - 1, int(0.95 * len(known)))]
            shown = (statistics.median(known), high, known[-1])
            table.append((name, *(number(value, digits, scale) for value in shown)))
    return table


def _span(start_s: float | None, end_s: float | None) -> float | None:
    return None if start_s is None or end_s is None else end_s - start_s


def _stop_row(each: Approach) -> list[str]:
    return [
        str(each.trial),
        number(each.detect_s, 4),
        number(_span(each.detect_s, each.command_s), 2, 1000.0),
        number(_span(each.command_s, each.standstill_s), 1, 1000.0),
        number(each.stop_travel_m, 3, 1000.0),
        number(each.force_peak_n, 3),
        each.acting,
    ]


def _trial_row(each: Approach) -> list[str]:
    return [
        str(each.trial),
        title(each.outcome),
        each.location,
        number(each.speed_m_s, 3, 1000.0),
        ", ".join(f"{name} {shown(value)}" for name, value in each.varied.items()),
        number(each.baseline_hz),
        number(each.threshold_hz),
        number(each.delay_s, 3),
        number(each.extent_m, 3, 1000.0),
        number(each.force_n, 4),
        number(each.force_peak_n, 4),
        str(each.false_contacts),
    ]
