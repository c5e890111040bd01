"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from controller.recording.reader import Run
from controller.reports.approaches import (
    Approach,
    Bound,
    Correlation,
    Mean,
    Row,
    bounds,
    read_approaches,
    study_cells,
    table_rows,
    trends,
)
from controller.reports.detector_scores import score_detectors
from controller.reports.figures import Figures
from controller.reports.paper import CITATION, DELAY_BOUND_S, SETTLE_S
from controller.reports.run_account import setting_of
from controller.reports.section import Section
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

MEASURES = (("delay_s", 2, 1.0), ("extent_m", 2, 1000.0), ("force_n", 3, 1.0))
"""Columns of Table I: attribute, decimals, factor from SI to what is printed (s, mm, N)."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Tables and figures of all approaches of some runs on one kind of bench."""
    approaches = read_approaches(runs)
    plain = [approach for approach in approaches if approach.plain]
    rows = table_rows(approaches)
    held = bounds(approaches)
    cells = study_cells(approaches)
    example = representative(plain) or representative(approaches)
    trace = trace_of(example) if example else None
    return Section(
        title="Stop at first contact (A2)",
        template="transient.html.j2",
        citation=CITATION,
        summary=_summary(approaches, held),
        not_the_papers=_not_the_papers(runs),
        context={
            "trials": len(approaches),
            "outcomes": _outcomes(approaches),
            "rows": [_table_row(row) for row in rows],
            "overall": {
                name: spread(_overall(plain, name), digits, scale) for name, digits, scale in MEASURES
            },
            "bounds": [_bound(bound) for bound in held],
            "trends": [
                (trend.name, _rho(trend.ours), _rho(trend.ours_trials), _rho(trend.paper))
                for trend in trends(rows)
            ],
            "false": share(sum(each.false_contacts for each in plain), len(plain)),
            "baseline_s": number(setting_of(runs[-1], "detectors", "contact", "baseline_s"), 0),
            "detectors": [
                (score.name, score.n, score.true, score.false, score.silent, spread(score.delay_s))
                for score in score_detectors(plain)
            ],
            "figure_5": Markup(draw_trial(figures, trace)) if trace else "",
            "figure_5_says": _figure_5_says(trace) if trace else "",
            **_row_figures(figures, rows),
            "study": [
                (
                    f"{c.noise_scale:g}",
                    f"{c.sample_hz:g}",
                    f"{c.baseline_s:g}",
                    spread(c.delay_s),
                    share(c.false_contacts, c.n),
                )
                for c in cells
            ],
            "figure_study": Markup(draw_study(figures, cells)) if cells else "",
            "stops": _stops(approaches),
            "stop_rows": [_stop_row(each) for each in approaches if each.detect_s is not None],
            "trial_rows": [_trial_row(each) for each in approaches],
            "many_runs": len(runs) > 1,
        },
    )


def _summary(approaches: Sequence[Approach], held: Sequence[Bound]) -> list[tuple[bool | None, str]]:
    n = len(approaches)
    contacts = sum(each.detected for each in approaches)
    false = sum(each.false_contacts for each in approaches)
    said: list[tuple[bool | None, str]] = [
        (
            None,
            f"{n} approaches: {contacts} stopped at a contact, {false} at a false contact"
            + (f", {n - contacts - false} otherwise." if n > contacts + false else "."),
        )
    ]
    names = {"force": "Force at detection", "extent": "Extent at detection", "delay": "Mean delay"}
    for bound in held:
        shown = _bound(bound)
        if bound.worst is not None:
            verdict = "within" if bound.met else "beyond"
            said.append(
                (bound.met, f"{names[bound.name]} {shown['value']}: {verdict} the paper's {shown['limit']}.")
            )
    peaks = [each.force_peak_n for each in approaches if each.detected and each.force_peak_n is not None]
    if peaks:
        said.append(
            (
                None,
                f"The instantaneous peak of the load cell, which the paper does not print, reaches "
                f"{number(max(peaks), 3)} N.",
            )
        )
    return said


def _not_the_papers(runs: Sequence[Run]) -> list[str]:
    said = [
        "Zero of the micrometer is taken as distal, and f as the middle of the pad: both are inferred.",
        "The rate at which the frequency is sampled is not printed; here it is a setting, and its effect is shown.",
        "A contact before the probe touches is counted as false. The paper counts none.",
        "Force at detection is the load cell's mean over the last oscillation; the peak has a column of its own.",
    ]
    if runs[0].simulated:
        said.insert(
            0,
            "The model is fitted to the paper's static facts and to one compliance, at location f at 2.54, 6.435 and "
            "11.997 mm/s. The other eleven rows of Table I set no number. They were not blind, though: the slow "
            "wander of the stiffness, an assumption that the delays depend on, was chosen with the table in view.",
        )
    for run in runs:
        settle_s = setting_of(run, "behavior", "settle_s")
        if isinstance(settle_s, int | float) and settle_s != SETTLE_S:
            said.append(
                f"{run.folder.path.name}: {number(settle_s, 1)} s of settling after power-on "
                f"instead of the paper's {SETTLE_S:g} s."
            )
    return said


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
    for name, digits, scale in MEASURES:
        ours = row.mean(name)
        theirs = getattr(paper, name) if paper else None
        printed = NOTHING if theirs is None else spread(Mean(theirs[0], theirs[1], 0), digits, scale)
        difference = NOTHING if theirs is None else signed(ours.mean - theirs[0], digits, scale)
        cells.append((spread(ours, digits, scale), printed, difference))
    return {
        "side": paper.side if paper else "",
        "location": row.location,
        "position": number(paper.micrometer_m, 2, 1000.0) if paper else NOTHING,
        "speed": number(row.speed_m_s, 3, 1000.0),
        "n": len(row.contacts),
        "false": row.false_contacts,
        "cells": cells,
    }


def _bound(bound: Bound) -> dict[str, Any]:
    digits, scale, unit = {"force": (3, 1.0, "N"), "extent": (2, 1000.0, "mm"), "delay": (2, 1.0, "s")}[
        bound.name
    ]
    worst = bound.worst
    why = "No approach ended by a contact."
    if worst is not None:
        speed = f"{number(worst.speed_m_s, 2, 1000.0)} mm/s"
        extent = f"{number(worst.extent_m, 2, 1000.0)} mm"
        reached = f"{number(worst.force_n, 3)} N after {number(worst.delay_s)} s and {extent}"
        why = f"Worst: trial {worst.trial}, location {worst.location} at {speed}, detected at {reached}."
        if bound.name == "force":
            why += (
                f" The instantaneous peak of that trial, stop included, is {number(worst.force_peak_n, 3)} N."
            )
        if bound.name == "delay":
            why = f"Largest: {number(worst.delay_s)} s in trial {worst.trial}, location {worst.location} at {speed}."
            why += _filter_says(worst)
    return {
        "what": {
            "force": "largest force at detection",
            "extent": "largest extent, onset to detection",
            "delay": "mean time, onset to detection",
        }[bound.name],
        "limit": f"{number(bound.limit, 1 if bound.limit == DELAY_BOUND_S else 2, scale)} {unit}",
        "value": f"{number(bound.value, digits, scale)} {unit}",
        "met": bound.met,
        "why": why,
    }


def _filter_says(approach: Approach) -> str:
    """What of the delay is the filter's: how long a window of contact takes to fill."""
    detector = str(setting_of(approach.run, "behavior", "detector") or "contact")
    samples = setting_of(approach.run, "detectors", detector, "average_samples")
    rate_hz = approach.sample_hz or setting_of(approach.run, "detectors", detector, "sample_hz")
    if not samples or not rate_hz:
        return ""
    window = number(samples / rate_hz)
    return f" The filter averages {samples} samples at {rate_hz:g} a second: its window is {window} s."


def _rho(correlation: Correlation) -> str:
    text = signed(correlation.rho)
    return f"{text} (n = {correlation.n})" if text != NOTHING else f"{NOTHING} (n = {correlation.n})"


def _figure_5_says(trace: Trace) -> str:
    approach = trace.approach
    return (
        f"Trial {approach.trial}: location {approach.location}, {number(approach.speed_m_s, 3, 1000.0)} mm/s. "
        f"Detected {number(approach.delay_s)} s after the load cell reached 0.005 N, "
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
        str(setting_of(each.run, "behavior", "detector") or "contact"),
    ]


def _trial_row(each: Approach) -> list[str]:
    varied = [f"noise × {each.noise_scale:g}" if each.noise_scale is not None else ""]
    varied.append(f"{each.sample_hz:g} samples/s" if each.sample_hz is not None else "")
    varied.append(f"baseline {each.baseline_s:g} s" if each.baseline_s is not None else "")
    return [
        str(each.trial),
        title(each.outcome),
        each.location,
        number(each.speed_m_s, 3, 1000.0),
        ", ".join(text for text in varied if text),
        number(each.baseline_hz),
        number(each.threshold_hz),
        number(each.delay_s, 3),
        number(each.extent_m, 3, 1000.0),
        number(each.force_n, 4),
        number(each.force_peak_n, 4),
        str(each.false_contacts),
    ]
