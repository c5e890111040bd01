"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from controller.measures.transient import ONSET_N
from controller.measures.trial import not_before
from controller.recording.reader import Run
from controller.reports.approaches import (
    AT_F,
    BOUNDS,
    TABLE_1,
    TableRow,
    compare_columns,
    figure_rows,
    papers_mean,
    place_of,
    read_approaches,
    score_detectors,
    stopped,
    table_rows,
    trends,
    unjudged,
)
from controller.reports.counts import (
    Mean,
    Row,
    Trials,
    number,
    quantity,
    share,
    signed,
    spread,
    tails,
    title,
    under,
    with_spread,
)
from controller.reports.figures import LOOKS, OURS, PAPER, Figures
from controller.reports.first_screen import kinds_in, listed
from controller.reports.papers import headlines
from controller.reports.run_account import acting_of, criterion_of, setting_of
from controller.reports.section import ROWS, Headline, Section, measured, rows_where, told
from controller.scales import NOTHING, scale_of

OVER = ("here, rows", "here, approaches", "paper, rows")
"""What `trends` correlates over."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Tables and figures of all approaches of some runs of equal settings on one kind of bench."""
    run, approaches = runs[0], read_approaches(runs)
    contacts, plain = approaches.where(stopped), approaches.where(varied={})
    rows = table_rows(approaches)
    acting, scores = acting_of(run), score_detectors(plain)
    others = [name for name in scores if name != acting]
    ours = (name for name in others if setting_of(run, "detectors", name, "kind") != "resonance.paper")
    other = next(ours, next(iter(others), ""))
    outcomes = Counter(str(each["outcome"]) for each in approaches).most_common()
    own = setting_of(run, "detectors", acting) or {}
    content = {
        "detector_kind": own.get("kind"),
        "fitted": [quantity("speed_m_s", row["speed_m_s"], 3) for row in TABLE_1 if row["fitted"]],
        "unfitted": sum(not row["fitted"] for row in TABLE_1),
        "criterion": criterion_of(run, acting),
        "acting": acting,
        "other": other,
        "chosen": run.simulated and own.get("sigma_of") == "samples",
        "onset": f"{ONSET_N:g}",
        "n": len(approaches),
        "contacts": contacts,
        "alarms": approaches.total("false_contacts"),
        "unjudged": len(approaches.where(unjudged)),
        "without_delay": len(contacts) - len(contacts.values("delay_s")),
        "noisy": len(contacts.where(_onset_is_noise)),
        "outcomes": ", ".join(f"{title(name)}: {count}" for name, count in outcomes),
        "table_1": [_table_row(row, other) for row in rows],
        "asterisk": any(row.fitted(bound) for row in rows for bound in BOUNDS),
        "bounded": [each for each in compare_columns(approaches, rows) if each.worst is not None],
        "trends": [
            {"force at detection against": name}
            | {head: f"{signed(rho)} (n = {n})" for head, (rho, n) in zip(OVER, found, strict=True)}
            for name, found in (trends(rows) if rows else {}).items()
        ],
        "place_of": place_of,
        "detectors": [
            {
                "detector": name,
                "approaches": score.n,
                "true contacts": score.true,
                "false contacts": score.false,
                "silent to the end": score.silent,
                "delay, s": with_spread(score.delay_s, 1.0),
            }
            for name, score in scores.items()
        ],
        "stops": _stops(approaches),
        **_figures(figures, rows),
        "study": _study(approaches),
    }
    terminal = [_table_row(row, other, terminal=True) for row in rows]
    more: dict[str, Any] = {"paper": "backus", "terminal": terminal, "headline": _headline(runs)}
    return told(runs, "Stop at first contact (A2)", "transient", content, **more)


def _headline(runs: Sequence[Run]) -> Headline | None:
    """The mean delay, beside the paper's of the same rows of Table I."""
    (line,), rows = headlines("transient"), Trials.of(runs)
    paper, source = papers_mean(rows.known("delay_s"), "delay_s", line["paper"], line["source"])
    return listed([{**line, "paper": paper, "source": source}], rows, kinds_in(runs))


# --- tables ------------------------------------------------------------------------------------------


def _table_row(row: TableRow, other: str, terminal: bool = False) -> Row:
    """A row of Table I, with another detector on its approaches beside it; in a terminal without spreads."""
    paper = row.paper or {}
    line: dict[str, Any] = {"where": f"{paper.get('side', '')} {row.location}".strip()}
    line[ROWS] = rows_where(row.approaches[0], "location", "speed_m_s")
    line |= {} if terminal else under("position_m", paper.get("micrometer_m"), digits=2)
    line |= under("speed_m_s", row.speed_m_s, "" if terminal else None, 2 if terminal else 3)
    judged = len(row.approaches) > len(row.approaches.where(unjudged))
    line |= {"n": len(row.contacts), "false": row.approaches.total("false_contacts") if judged else NOTHING}
    for bound in BOUNDS:
        column, digits, factor = bound["column"], int(bound["decimals"]), scale_of(bound["column"]).factor
        here = row.mean(column)
        theirs = Mean(paper.get(column, math.nan), paper.get(f"{column}.sd", math.nan), 0)
        off = signed(here.mean - theirs.mean, digits, factor) + " *" * row.fitted(bound)
        line[_heading(bound)] = {
            "here": _said(here, terminal, digits, factor),
            "paper": _said(theirs, terminal, digits, factor),
            **({} if terminal else {"Δ": off}),
        }
    return line | _other(row.approaches, other, terminal)


def _said(mean: Mean, terminal: bool, digits: int = 2, factor: float = 1.0) -> str:
    return number(mean.mean, digits, factor) if terminal else spread(mean, digits, factor)


def _heading(bound: Row) -> str:
    return f"{bound['title']}, {scale_of(bound['column']).unit}"


def _other(approaches: Trials, other: str, terminal: bool = False) -> dict[str, Any]:
    score = score_detectors(approaches).get(other)
    cells: Row = dict.fromkeys(("n", "false", "s"), NOTHING)
    if score is not None:
        cells = {"n": score.true, "false": score.false, "s": _said(score.delay_s, terminal)}
    return {f"detector {other}": cells} if other else {}


def _stops(approaches: Trials) -> list[Row]:
    """How long a stop took, how far the probe went in it, and the largest force of the whole approach."""
    rows = Trials(
        {
            **row,
            "detection_to_command_s": row["command_s"] - row["detect_s"],
            "command_to_standstill_s": row["standstill_s"] - row["command_s"],
        }
        for row in approaches.known("detect_s", "command_s", "standstill_s")
    )
    return tails(rows, "detection_to_command_s", "command_to_standstill_s", "stop_travel_m", "force_peak_n")


# --- what sentences say ------------------------------------------------------------------------------


def _onset_is_noise(each: Row) -> bool:
    """Whether the load cell reached its onset before the probe touched, where that is known."""
    onset_s, touch_s = each.get("onset_s"), each.get("truth_contact_s")
    return onset_s is not None and touch_s is not None and not not_before(onset_s, touch_s)


# --- figures -----------------------------------------------------------------------------------------

PLACE = "place on the {}, distal (0) to proximal (1)"

FIGURES: Sequence[Any] = (
    ("figure_7", "fig_7_pad", figure_rows("pad"), "micrometer_m", PLACE.format("pad"), (-0.08, 1.1)),
    ("figure_8", "fig_8_back", figure_rows("back"), "micrometer_m", PLACE.format("back"), (-0.08, 1.1)),
    ("figure_9", "fig_9_speed", AT_F, "speed_m_s", scale_of("speed_m_s").heading, (0.0, 13.5)),
)
"""The paper's Fig. 7 to 9: force and extent against where the finger is touched, and against speed. Key, file, rows of
Table I, and of the axis column, label and limits."""


def _figures(figures: Figures, rows: Sequence[TableRow]) -> dict[str, str]:
    """Each only where these runs have a point for it."""
    had = [row.paper for row in rows if row.contacts]
    return {
        key: _draw_pair(figures, rows, name, *axis) if any(paper in had for paper in axis[0]) else ""
        for key, name, *axis in FIGURES
    }


def _study(approaches: Trials) -> list[Row]:
    """What varied settings do; nothing where none was varied but speed and place."""
    varied = approaches.where(lambda row: row["varied"])
    names = sorted({name for row in varied for name in row["varied"]})
    groups = list(varied.by(*names).values())
    lines = measured(groups, names, ["delay_s"])
    counts = (share(own.total("false_contacts"), len(own)) for own in groups)
    return [{**line, "false contacts": count} for line, count in zip(lines, counts, strict=True)]


def _draw_pair(
    figures: Figures,
    rows: Sequence[TableRow],
    name: str,
    papers: Sequence[Row],
    column: str,
    heading: str,
    limits: tuple[float, float],
) -> str:
    """Force on the left, extent on the right, along a column of the paper's rows: the paper's means a little to the
    left of their place, this run's to the right, single approaches beside them."""
    places = column == "micrometer_m"  # as shares of the finger's length
    unit = 1.0 / max(float(paper[column]) for paper in papers) if places else scale_of(column).factor

    def along(paper: Row) -> float:
        return unit * float(paper[column])

    mine = [(along(row.paper), row) for row in rows if row.paper in papers and row.paper]
    shift = 0.009 * (limits[1] - limits[0])
    with figures.figure(2.8, columns=2) as drawing:
        for axes, what in zip(drawing.axes, ("force_n", "extent_m"), strict=True):
            scale = scale_of(what)
            theirs = np.array([(along(p), p[what], p[f"{what}.sd"]) for p in papers]).T
            squares: Any = {**LOOKS["paper"], "ls": "", "lw": 0.8, "label": "paper, mean ± σ"}
            axes.errorbar(theirs[0] - shift, theirs[1] * scale.factor, theirs[2] * scale.factor, **squares)
            means = [row.mean(what) for _, row in mine]
            sigmas = np.nan_to_num([mean.sigma for mean in means]) * scale.factor
            circles: Any = {**LOOKS["ours"], "ls": "", "label": "this run, mean ± σ"}
            heights = [mean.mean * scale.factor for mean in means]
            axes.errorbar([x + shift for x, _ in mine], heights, sigmas, **circles)
            known = [
                (x + 3.0 * shift, y * scale.factor) for x, own in mine for y in own.contacts.values(what)
            ]
            dots: Any = {"alpha": 0.45, "ms": 4.5, "mew": 0, "label": "this run, single approaches"}
            axes.plot(*zip(*known, strict=True), ".", color=OURS, **dots)
            at_detection = ", at detection" if what == "force_n" else ""
            axes.set(xlabel=heading, ylabel=f"{scale.heading}{at_detection}", xlim=limits)
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        for paper in papers if places else ():
            look: Any = {"ha": "center", "va": "bottom", "style": "italic", "color": PAPER}
            place = (along(paper), 1.0)
            drawing.axes[0].annotate(paper["location"], place, xycoords=("data", "axes fraction"), **look)
        drawing.legend(drawing.axes[0], 3)
        return drawing.save(name)
