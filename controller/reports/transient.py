"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from controller.measures.transient import ONSET_N
from controller.measures.trial import not_before
from controller.recording.reader import Run
from controller.reports.approaches import (
    BOUNDS,
    NOISE,
    SAMPLE_HZ,
    TABLE_1,
    Approach,
    Bounded,
    Correlation,
    DetectorScore,
    TableRow,
    compare_columns,
    read_approaches,
    score_detectors,
    study_rows,
    table_rows,
    trends,
)
from controller.reports.counts import Mean, Row, number, quantity, share, signed, spread, title, under
from controller.reports.figures import Figures
from controller.reports.run_account import acting_of, criterion_of, setting_of
from controller.reports.section import Kind, Result, Section
from controller.reports.settings import shown
from controller.reports.transient_figures import (
    draw_locations,
    draw_speeds,
    draw_study,
    draw_trial,
    representative,
    trace_of,
)
from controller.scales import NOTHING, scale_of


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Tables and figures of all approaches of some runs of equal settings on one kind of bench."""
    approaches = read_approaches(runs)
    plain = [approach for approach in approaches if not approach.varied]
    rows = table_rows(approaches)
    bounded = compare_columns(approaches, rows)
    acting, scores = acting_of(runs[0]), score_detectors(plain)
    other = next((name for name in scores if name != acting), "")
    outcomes = Counter(str(each.row["outcome"]) for each in approaches).most_common()
    n = len(approaches)
    return Section(
        title="Stop at first contact (A2)",
        content={
            "kind": setting_of(runs[0], "detectors", acting, "kind"),
            "fitted": [quantity("speed_m_s", row["speed_m_s"], 3) for row in TABLE_1 if row["fitted"]],
            "unfitted": sum(not row["fitted"] for row in TABLE_1),
            "criterion": criterion_of(runs[0], acting),
            "acting": acting,
            "other": other,
            "onset": f"{ONSET_N:g}",
            "approaches": f"{n} {'approach' if n == 1 else 'approaches'}",
            "outcomes": ", ".join(f"{count} {title(name)}" for name, count in outcomes),
            "table_1": [_table_row(row, other) for row in rows],
            "foot": _foot(plain, other),
            "asterisk": any(row.fitted(bound) for row in rows for bound in BOUNDS),
            "bounds": [_bound(each) for each in bounded],
            "trends": [_trend(name, *found) for name, found in trends(rows).items()] if rows else [],
            "alarmed": share(sum(each.false_contacts for each in plain), len(plain)),
            "learned": _learned(runs[0], acting),
            "detectors": [_score(name, score) for name, score in scores.items()],
            "stops": list(_stops(approaches)),
            **_figures(figures, approaches, plain, rows),
            **_study(figures, study_rows(approaches)),
        },
        template="transient",
        paper="backus",
        summary=list(_summary(approaches, bounded, runs[0].simulated)),
        terminal=[_table_row(row, other, terminal=True) for row in rows],
    )


# --- tables ------------------------------------------------------------------------------------------


def _table_row(row: TableRow, other: str, terminal: bool = False) -> Row:
    """A row of Table I, with another detector on its approaches beside it; in a terminal without spreads."""
    paper = row.paper
    line: dict[str, Any] = {"where": f"{paper['side'] if paper else ''} {row.location}".strip()}
    if not terminal:
        line |= under("position_m", paper and paper["micrometer_m"], digits=2)
    line |= under("speed_m_s", row.speed_m_s, "" if terminal else None, 2 if terminal else 3)
    line |= {"n": len(row.contacts), "false": row.false_contacts}
    for bound in BOUNDS:
        column, digits, here = bound["column"], int(bound["decimals"]), row.mean(bound["column"])
        theirs = Mean(paper[column], paper[f"{column}.sd"], 0) if paper else Mean(math.nan, math.nan, 0)
        factor = scale_of(column).factor
        off = signed(here.mean - theirs.mean, digits, factor) + " *" * row.fitted(bound)
        texts = {"here": spread(here, digits, factor), "paper": spread(theirs, digits, factor), "Δ": off}
        if terminal:
            texts = {"here": number(here.mean, digits, factor), "paper": number(theirs.mean, digits, factor)}
        line[_heading(bound)] = texts
    if other:
        line[f"detector {other}"] = _other(score_detectors(row.approaches).get(other), terminal)
    return line


def _heading(bound: Row) -> str:
    return f"{bound['title']}, {scale_of(bound['column']).unit}"


def _other(score: DetectorScore | None, terminal: bool = False) -> Row:
    if score is None:
        return {"n": NOTHING, "false": NOTHING, "s": NOTHING}
    delay = number(score.delay_s.mean) if terminal else spread(score.delay_s)
    return {"n": score.true, "false": score.false, "s": delay}


def _foot(plain: Sequence[Approach], other: str) -> Row:
    every = TableRow("", 0.0, plain, None)
    foot: dict[str, Any] = {"where": "all true contacts"}
    for bound in BOUNDS:
        mean = spread(every.mean(bound["column"]), int(bound["decimals"]), scale_of(bound["column"]).factor)
        foot[_heading(bound)] = {"here": mean}
    return foot | ({f"detector {other}": _other(score_detectors(plain).get(other))} if other else {})


def _printed(bound: Row, value: float) -> str:
    return quantity(bound["column"], value, int(bound["decimals"]))


def _bound(each: Bounded) -> Row:
    bound, beside, worst, _ = each
    why = "No approach ended by a contact."
    if worst is not None:
        why = f"Largest: {_printed(bound, worst[bound['column']])} in trial {worst['trial']}, location "
        why += f"{worst.location} at {quantity('speed_m_s', worst.speed_m_s)}."
    return {
        "bound": f"{bound['over']} {bound['title']}",
        "paper": _printed(bound, beside.paper),
        "here": _printed(bound, beside.ours) if worst else NOTHING,
        "beside it": beside.times if worst else NOTHING,
        "verdict": beside.met,
        "why": why,
    }


def _trend(name: str, *found: Correlation) -> Row:
    heads = ("here, rows", "here, approaches", "paper, rows")
    texts = [f"{signed(rho)} (n = {n})" for rho, n in found]
    return {"force at detection against": name, **dict(zip(heads, texts, strict=True))}


def _score(name: str, score: DetectorScore) -> Row:
    return {
        "detector": name,
        "approaches": score.n,
        "true contacts": score.true,
        "false contacts": score.false,
        "silent to the end": score.silent,
        **under("delay_s", score.delay_s, "delay, mean (σ)"),
    }


def _stops(approaches: Sequence[Approach]) -> Iterator[Row]:
    """Median, 95th percentile by rank and largest of each span of the stop."""
    sent = [_span(each, "detect_s", "command_s") for each in approaches]
    still = [_span(each, "command_s", "standstill_s") for each in approaches]
    for name, column, digits, found in (
        ("detection to stop command", "to_command_s", 2, sent),
        ("command to standstill", "to_standstill_s", 1, still),
        (
            "travel, detection to standstill",
            "stop_travel_m",
            3,
            [each["stop_travel_m"] for each in approaches],
        ),
        (
            "peak force of true contacts",
            "force_peak_n",
            3,
            [each["force_peak_n"] for each in approaches if each.detected],
        ),
    ):
        known = sorted(value for value in found if value is not None)
        if known and any(value is not None for value in sent):
            high = known[min(len(known) - 1, int(0.95 * len(known)))]
            _, unit, factor = scale_of(column)
            three = {"median": statistics.median(known), "95th percentile": high, "largest": known[-1]}
            yield {"": f"{name}, {unit}"} | {
                head: number(value, digits, factor) for head, value in three.items()
            }


def _span(each: Approach, start: str, end: str) -> float | None:
    return None if each[start] is None or each[end] is None else each[end] - each[start]


# --- sentences ---------------------------------------------------------------------------------------


def _summary(approaches: Sequence[Approach], bounded: Sequence[Bounded], simulated: bool) -> Iterator[Result]:
    n = len(approaches)
    contacts = [each for each in approaches if each.detected]
    false = sum(each.false_contacts for each in approaches)
    rest = n - len(contacts) - false
    text = f"{n} {'approach' if n == 1 else 'approaches'}: {len(contacts)} stopped at a contact, {false} at a false "
    yield Result(None, f"{text}contact{f', {rest} otherwise' if rest > 0 else ''}.")
    if noisy := sum(_onset_is_noise(each) for each in contacts):
        text = f"In {noisy} of {len(contacts)} contacts the load cell's noise reached {ONSET_N:g} N before the probe "
        yield Result(None, f"{text}touched: time and extent count from there, and are too long.")
    kind = Kind.PREDICTED if simulated else Kind.MEASURED
    for each in bounded:
        yield from _beside_table_1(each, kind) if each.worst else ()
    if peaks := [each["force_peak_n"] for each in contacts if each["force_peak_n"] is not None]:
        text = "The instantaneous peak of the load cell, which the paper does not print, reaches "
        yield Result(None, f"{text}{number(max(peaks), 3)} N.")


def _onset_is_noise(each: Approach) -> bool:
    """Whether the load cell reached its onset before the probe touched, where that is known."""
    onset_s, touch_s = each["onset_s"], each["truth_contact_s"]
    return onset_s is not None and touch_s is not None and not not_before(onset_s, touch_s)


def _beside_table_1(each: Bounded, kind: Kind) -> Iterator[Result]:
    """A column beside Table I, and beside the bound that the paper states: one comparison, one verdict."""
    bound, beside, _, rows = each
    name = bound["title"].capitalize()
    if rows is not None:
        scatter = {None: "", True: ", within the rows' scatter", False: ", beyond the rows' scatter"}[
            rows.met
        ]
        how = (
            f"{rows.times.partition(' times')[0]} times {bound['more' if rows.ours > rows.paper else 'less']}"
        )
        yield Result(kind, f"{name}: {how} than Table I in {rows.same} of {rows.n} rows{scatter}.", rows.met)
    text = f"{name} at detection: {bound['over']} {_printed(bound, beside.ours)}, {beside.times} the paper's "
    yield Result(kind, f"{text}{_printed(bound, beside.paper)} ({bound['source']}).", beside.met)


def _learned(run: Run, acting: str) -> str:
    """How many independent values the detector's baseline holds: what its threshold rests on."""
    names = ("baseline_s", "average_samples", "sample_hz")
    baseline_s, samples, rate_hz = (setting_of(run, "detectors", acting, name) for name in names)
    if not (baseline_s and samples and rate_hz):
        return ""
    text = f"A baseline of {baseline_s:g} s of {samples}-sample averages at {rate_hz:g} a second holds some "
    return f"{text}{number(baseline_s * rate_hz / samples, 1)} independent values to learn mean and σ from."


# --- figures -----------------------------------------------------------------------------------------


def _figures(
    figures: Figures, approaches: Sequence[Approach], plain: Sequence[Approach], rows: Sequence[TableRow]
) -> dict[str, Any]:
    """Figures 5, 7, 8 and 9, each only where these runs have a point for it."""
    example = representative(plain) or representative(approaches)
    trace = trace_of(example) if example else None
    found: dict[str, Any] = {"figure_5": "", "figure_7": "", "figure_8": "", "figure_9": ""}
    if trace and example:
        found |= {"figure_5": draw_trial(figures, trace), "trace": trace, "trial": example["trial"]}
        found |= {"where": example.location, "speed": quantity("speed_m_s", example.speed_m_s, 3)}
        found |= {name: quantity(name, example[name], n) for name, n in (("delay_s", 2), ("force_n", 3))}
    papers = [row.paper for row in rows if row.paper and row.contacts]
    for name, side in (("figure_7", "pad"), ("figure_8", "back")):
        if any(paper["side"] == side and paper["study"] == "location" for paper in papers):
            found[name] = draw_locations(figures, rows, side)
    if any(paper["location"] == "f" for paper in papers):
        found["figure_9"] = draw_speeds(figures, rows)
    return found


MADE = ("delay_s", "false", "n")
"""What a row of the study has beside the settings that were varied."""


def _study(figures: Figures, cells: Sequence[Row]) -> dict[str, Any]:
    """What varied settings do: a table with a column for each, and a figure where noise and rate are among them."""
    names = list(dict.fromkeys(name for cell in cells for name in cell if name not in MADE))
    rows = []
    for cell in cells:
        line: dict[str, Any] = {}
        for name in names:
            line |= under(name, cell.get(name))
        line |= under("delay_s", cell["delay_s"], "delay, mean (σ)")
        rows.append(line | {"false contacts": share(cell["false"], cell["n"])})
    drawn = [
        (cell, {name: value for name, value in cell.items() if name not in (NOISE, SAMPLE_HZ, *MADE)})
        for cell in cells
        if NOISE in cell and SAMPLE_HZ in cell
    ]
    like = [cell for cell, rest in drawn if rest == drawn[0][1]]
    rest = ", ".join(f"{name} {shown(value)}" for name, value in drawn[0][1].items()) if drawn else ""
    return {
        "study": rows,
        "figure_study": draw_study(figures, like) if len(like) > 1 else "",
        "study_rest": rest,
    }
