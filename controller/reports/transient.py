"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from controller.measures.transient import ONSET_N
from controller.measures.trial import not_before
from controller.recording.reader import Run
from controller.reports.approaches import (
    AT_F,
    BOUNDS,
    NOISE,
    SAMPLE_HZ,
    TABLE_1,
    DetectorScore,
    TableRow,
    compare_columns,
    figure_rows,
    papers_mean,
    place_of,
    read_approaches,
    score_detectors,
    stopped,
    study_rows,
    table_rows,
    trends,
    unjudged,
)
from controller.reports.counts import (
    Mean,
    Row,
    Trials,
    larger,
    mean_of,
    number,
    quantity,
    share,
    signed,
    spread,
    title,
    under,
)
from controller.reports.figures import LOOKS, OURS, PAPER, Figures
from controller.reports.first_screen import kinds_in, listed
from controller.reports.papers import headlines
from controller.reports.run_account import acting_of, criterion_of, setting_of
from controller.reports.section import ROWS, Headline, Section, rows_where, told
from controller.reports.settings import shown
from controller.scales import NOTHING, scale_of

OFTEN = 0.9
"""Share of the contacts that a detector must have detected to be called sooner or later (assumption)."""

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
    both = _both(scores[other], scores[acting]) if other and acting in scores else []
    outcomes = Counter(str(each["outcome"]) for each in approaches).most_common()
    own = setting_of(run, "detectors", acting) or {}
    content = {
        "detector_kind": own.get("kind"),
        "fitted": [quantity("speed_m_s", row["speed_m_s"], 3) for row in TABLE_1 if row["fitted"]],
        "unfitted": sum(not row["fitted"] for row in TABLE_1),
        "criterion": criterion_of(run, acting),
        "acting": acting,
        "other": other,
        "both": list(map(mean_of, zip(*both, strict=True))),
        "often": OFTEN,
        "sooner": larger(mean_of(theirs_s - mine_s for mine_s, theirs_s in both), Mean(0.0, 0.0, 2)),
        "chosen": run.simulated and own.get("sigma_of") == "samples",
        "onset": f"{ONSET_N:g}",
        "n": len(approaches),
        "contacts": contacts,
        "alarms": approaches.total("false_contacts"),
        "unjudged": len(approaches.where(unjudged)),
        "without_delay": len(contacts) - len(contacts.values("delay_s")),
        "noisy": len(contacts.where(_onset_is_noise)),
        "scatter": _scatter(rows),
        "outcomes": ", ".join(f"{title(name)}: {count}" for name, count in outcomes),
        "table_1": [_table_row(row, other) for row in rows],
        "foot": _foot(plain, other),
        "asterisk": any(row.fitted(bound) for row in rows for bound in BOUNDS),
        "bounded": [each for each in compare_columns(approaches, rows) if each.worst is not None],
        "trends": [
            {"force at detection against": name}
            | {head: f"{signed(rho)} (n = {n})" for head, (rho, n) in zip(OVER, found, strict=True)}
            for name, found in (trends(rows) if rows else {}).items()
        ],
        "alarmed": share(plain.total("false_contacts"), len(plain) - len(plain.where(unjudged))),
        "baseline": own if all(map(own.get, ("baseline_s", "average_samples", "sample_hz"))) else None,
        "scores": scores,
        "place_of": place_of,
        "detectors": [
            {
                "detector": name,
                "approaches": score.n,
                "true contacts": score.true,
                "false contacts": score.false,
                "silent to the end": score.silent,
                **under("delay_s", score.delay_s, "delay, mean (σ)"),
            }
            for name, score in scores.items()
        ],
        "stops": list(_stops(approaches)),
        **_figures(figures, rows),
        **_study(figures, study_rows(approaches)),
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


def _foot(plain: Trials, other: str) -> Row:
    foot: dict[str, Any] = {"where": "all true contacts"}
    for bound in BOUNDS:
        mean, factor = plain.where(stopped).mean(bound["column"]), scale_of(bound["column"]).factor
        foot[_heading(bound)] = {"here": spread(mean, int(bound["decimals"]), factor)}
    return foot | _other(plain, other)


def _stops(approaches: Trials) -> Iterator[Row]:
    """Median, 95th percentile by rank and largest of what is of a stop; none where no stop was sent."""

    def spans(start: str, end: str) -> list[float]:
        known = approaches.known(start, end)
        return [row[end] - row[start] for row in known]

    to_command_s = spans("detect_s", "command_s")
    for name, column, digits, known in (
        ("detection to stop command", "to_command_s", 2, to_command_s),
        ("command to standstill", "to_standstill_s", 1, spans("command_s", "standstill_s")),
        ("travel, detection to standstill", "stop_travel_m", 3, approaches.values("stop_travel_m")),
        ("peak force of true contacts", "force_peak_n", 3, approaches.where(stopped).values("force_peak_n")),
    ):
        if known and to_command_s:
            high = sorted(known)[min(len(known) - 1, int(0.95 * len(known)))]
            cells = {"median": statistics.median(known), "95th percentile": high, "largest": max(known)}
            scale = scale_of(column)
            yield {"": f"{name}, {scale.unit}"} | {
                head: number(value, digits, scale.factor) for head, value in cells.items()
            }


# --- what sentences say ------------------------------------------------------------------------------


def _both(one: DetectorScore, other: DetectorScore) -> list[tuple[float, float]]:
    """The delays of two detectors where both detected after the same touch."""
    pairs = [(delay_s, other.delays_s.get(place)) for place, delay_s in one.delays_s.items()]
    return [(mine_s, theirs_s) for mine_s, theirs_s in pairs if mine_s is not None and theirs_s is not None]


def _scatter(rows: Sequence[TableRow]) -> Sequence[float] | None:
    """The scatter of the time within a row, ours and the paper's, s, which decides how mild the comparison is."""
    pairs = [(row.mean("delay_s").sigma, row.paper["delay_s.sd"]) for row in rows if row.paper]
    known = np.array([pair for pair in pairs if not math.isnan(pair[0])])
    return None if len(known) < 3 else np.sqrt(np.mean(known**2, axis=0)).tolist()


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


def _study(figures: Figures, cells: Sequence[Row]) -> dict[str, Any]:
    """What varied settings do: a table with a column for each, and a figure where noise and rate are among them."""
    made = ("delay_s", "false", "n")  # beside the settings that were varied
    names = list(dict.fromkeys(name for cell in cells for name in cell if name not in made))
    rows = []
    for cell in cells:
        line = {head: text for name in names for head, text in under(name, cell.get(name)).items()}
        line |= under("delay_s", cell["delay_s"], "delay, mean (σ)")
        rows.append(line | {"false contacts": share(cell["false"], cell["n"])})
    rests = [{name: cell[name] for name in cell if name not in (NOISE, SAMPLE_HZ, *made)} for cell in cells]
    drawn = [each for each in zip(cells, rests, strict=True) if NOISE in each[0] and SAMPLE_HZ in each[0]]
    like = [cell for cell, rest in drawn if rest == drawn[0][1]]
    said = ", ".join(f"{name} {shown(value)}" for name, value in drawn[0][1].items()) if drawn else ""
    drawing = _draw_study(figures, like) if len(like) > 1 else ""
    return {"study": rows, "figure_study": drawing, "study_rest": said}


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


def _draw_study(figures: Figures, cells: Sequence[Row]) -> str:
    """Delay and false contacts against noise, one line for each rate of frequency samples; all else alike."""
    rates, scales = (sorted({cell[name] for cell in cells}) for name in (SAMPLE_HZ, NOISE))
    with figures.figure(2.7, columns=2) as drawing:
        left, right = drawing.axes
        for index, rate in enumerate(rates):
            mine = [cell for cell in cells if cell[SAMPLE_HZ] == rate]
            x = np.array([cell[NOISE] for cell in mine]) * (1.0 + 0.03 * (index - (len(rates) - 1) / 2.0))
            look: Any = {"color": OURS, "alpha": 1.0 - 0.7 * index / len(rates), "marker": "os^Dv"[index % 5]}
            sigmas = np.nan_to_num([cell["delay_s"].sigma for cell in mine])
            delays_s = [cell["delay_s"].mean for cell in mine]
            left.errorbar(x, delays_s, sigmas, label=f"{rate:g} samples/s", **look)
            right.plot(x, [100.0 * cell["false"] / cell["n"] for cell in mine], **look)
        for axes, label in ((left, "delay (s), mean ± σ"), (right, "false contacts (%)")):
            axes.set(
                xscale="log" if min(scales) > 0.0 else "linear",
                xlabel="noise, relative to the plant's own",
                ylabel=label,
            )
            axes.set_xticks(scales, [f"{scale:g}" for scale in scales])
            axes.set_xticks([], minor=True)
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        drawing.legend(left, len(rates))
        return drawing.save("delay_noise_rate")
