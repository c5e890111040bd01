"""The part of the page on A2: stop at first contact, beside the paper's Table I."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
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
    Approach,
    Bounded,
    Correlation,
    DetectorScore,
    TableRow,
    compare_columns,
    figure_rows,
    read_approaches,
    score_detectors,
    study_rows,
    table_rows,
    trends,
)
from controller.reports.counts import (
    Mean,
    Row,
    mean_within,
    number,
    quantity,
    rate,
    share,
    signed,
    sized,
    spread,
    title,
    under,
)
from controller.reports.figures import OURS, PAPER, Figures
from controller.reports.run_account import acting_of, criterion_of, setting_of
from controller.reports.section import ROWS, Kind, Result, Section, judged, rows_where
from controller.reports.settings import shown
from controller.scales import NOTHING, scale_of


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Tables and figures of all approaches of some runs of equal settings on one kind of bench."""
    approaches = read_approaches(runs)
    plain = [approach for approach in approaches if not approach.varied]
    rows = table_rows(approaches)
    bounded = compare_columns(approaches, rows)
    acting, scores = acting_of(runs[0]), score_detectors(plain)
    others = [name for name in scores if name != acting]
    kinds = {name: setting_of(runs[0], "detectors", name, "kind") for name in others}
    other = next((name for name in others if kinds[name] != "resonance.paper"), next(iter(others), ""))
    outcomes = Counter(str(each.row["outcome"]) for each in approaches).most_common()
    chosen = runs[0].simulated and setting_of(runs[0], "detectors", acting, "sigma_of") == "samples"
    return Section(
        title="Stop at first contact (A2)",
        content={
            "kind": setting_of(runs[0], "detectors", acting, "kind"),
            "fitted": [quantity("speed_m_s", row["speed_m_s"], 3) for row in TABLE_1 if row["fitted"]],
            "unfitted": sum(not row["fitted"] for row in TABLE_1),
            "criterion": criterion_of(runs[0], acting),
            "acting": acting,
            "other": other,
            "chosen": chosen,
            "onset": f"{ONSET_N:g}",
            "approaches": _counted(approaches),
            "outcomes": ", ".join(f"{title(name)}: {count}" for name, count in outcomes),
            "table_1": [_table_row(row, other) for row in rows],
            "foot": _foot(plain, other),
            "asterisk": any(row.fitted(bound) for row in rows for bound in BOUNDS),
            "bounds": [_bound(each) for each in bounded],
            "trends": [_trend(name, *found) for name, found in trends(rows).items()] if rows else [],
            "alarmed": share(
                sum(each.false_contacts for each in plain), sum(not each.unjudged for each in plain)
            ),
            "learned": _learned(runs[0], acting),
            "detectors": [_score(name, score) for name, score in scores.items()],
            "stops": list(_stops(approaches)),
            **_figures(figures, rows),
            **_study(figures, study_rows(approaches)),
        },
        template="transient",
        paper="backus",
        summary=list(_summary(approaches, bounded, runs[0].simulated, scores, acting, other, chosen)),
        terminal=[_table_row(row, other, terminal=True) for row in rows],
    )


# --- tables ------------------------------------------------------------------------------------------


def _counted(approaches: Sequence[Approach]) -> str:
    return f"{len(approaches)} {'approach' if len(approaches) == 1 else 'approaches'}"


def _table_row(row: TableRow, other: str, terminal: bool = False) -> Row:
    """A row of Table I, with another detector on its approaches beside it; in a terminal without spreads."""
    paper = row.paper
    line: dict[str, Any] = {"where": f"{paper['side'] if paper else ''} {row.location}".strip()}
    line[ROWS] = rows_where(row.approaches[0].row, "location", "speed_m_s")
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
    every = TableRow("", 0.0, list(plain), None)
    foot: dict[str, Any] = {"where": "all true contacts"}
    for bound in BOUNDS:
        mean = spread(every.mean(bound["column"]), int(bound["decimals"]), scale_of(bound["column"]).factor)
        foot[_heading(bound)] = {"here": mean}
    return foot | ({f"detector {other}": _other(score_detectors(plain).get(other))} if other else {})


def _printed(bound: Row, value: float) -> str:
    return quantity(bound["column"], value, int(bound["decimals"]))


def _bound(each: Bounded) -> Row:
    bound, beside, worst = each.bound, each.beside, each.worst
    why = "No approach ended by a contact."
    if worst is not None:
        why = f"Largest: {_printed(bound, worst[bound['column']])} in trial {worst['trial']}, location "
        why += f"{worst.location} at {quantity('speed_m_s', worst.speed_m_s)}."
    return {
        "bound": f"{bound['over']} {bound['title']}",
        "paper": _printed(bound, beside.paper),
        "here": _printed(bound, beside.ours) if worst else NOTHING,
        "beside it": sized(beside.ours, beside.paper, scale_of(bound["column"]).unit) if worst else NOTHING,
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
    """Median, 95th percentile by rank and largest of what is of a stop; none where no stop was sent."""
    to_command_s = [each.span("detect_s", "command_s") for each in approaches]
    rows = (
        ("detection to stop command", "to_command_s", 2, to_command_s),
        (
            "command to standstill",
            "to_standstill_s",
            1,
            [e.span("command_s", "standstill_s") for e in approaches],
        ),
        ("travel, detection to standstill", "stop_travel_m", 3, [e["stop_travel_m"] for e in approaches]),
        (
            "peak force of true contacts",
            "force_peak_n",
            3,
            [e["force_peak_n"] for e in approaches if e.detected],
        ),
    )
    for name, column, digits, found in rows if any(each is not None for each in to_command_s) else ():
        known = sorted(value for value in found if value is not None)
        if known:
            high = known[min(len(known) - 1, int(0.95 * len(known)))]
            shown = {"median": statistics.median(known), "95th percentile": high, "largest": known[-1]}
            scale = scale_of(column)
            cells = {head: number(value, digits, scale.factor) for head, value in shown.items()}
            yield {"": f"{name}, {scale.unit}"} | cells


# --- sentences ---------------------------------------------------------------------------------------


def _summary(
    approaches: Sequence[Approach],
    bounded: Sequence[Bounded],
    simulated: bool,
    scores: Mapping[str, DetectorScore],
    acting: str,
    other: str,
    chosen: bool,
) -> Iterator[Result]:
    """First what a newcomer asks: is it the paper's, what is ours, what is left unexplained.

    Where rate and reading of sigma are `chosen` by Table I, its times and, speed times these, its extents were put in.
    """
    n = len(approaches)
    contacts = [each for each in approaches if each.detected]
    false = sum(each.false_contacts for each in approaches)
    rest = n - len(contacts) - false
    kind = Kind.PREDICTED if simulated else Kind.MEASURED
    for each in bounded:
        if each.worst and each.rows:
            own = chosen and each.bound["column"] in ("delay_s", "extent_m")
            yield _beside_table_1(each, Kind.FITTED if own else kind)
    text = f"{_counted(approaches)}: {len(contacts)} stopped at a contact, {false} at a false "
    unjudged = sum(each.unjudged for each in contacts)
    text += f"contact{f', {rate(false, n - unjudged)}' * (unjudged < n)}{f', {rest} otherwise' * (rest > 0)}"
    yield Result(None, text + ("; the paper reports no false one." if false else "."))
    if unjudged:
        text = f"{_without_delay(unjudged, len(contacts))}, and may be false: no load cell is read, or its noise alone "
        yield Result(None, f"{text}comes near the onset of {ONSET_N:g} N.")
    if lighter := sum(each["delay_s"] is None for each in contacts) - unjudged:
        text = _without_delay(lighter, len(contacts))
        yield Result(None, f"{text}: the load cell did not reach the onset of {ONSET_N:g} N before the end.")
    if other:
        yield from _sooner(scores, acting, other)
    for name in scores:
        if name not in (acting, other) and simulated and scores[name].n:
            false_rate = rate(scores[name].false, scores[name].n)
            yield Result(None, f"The detector “{name}” on the same approaches: {false_rate} false contacts.")
    yield from _scatter(table_rows(approaches), simulated)
    if noisy := sum(_onset_is_noise(each) for each in contacts):
        text = f"In {noisy} of {len(contacts)} contacts the load cell's noise reached {ONSET_N:g} N before the probe "
        yield Result(None, f"{text}touched: time and extent count from there, and are too long.")
    yield from (_beside_bound(each, kind) for each in bounded if each.worst)
    if peaks := [each["force_peak_n"] for each in contacts if each["force_peak_n"] is not None]:
        text = "The instantaneous peak of the load cell, which the paper does not print, reaches "
        yield Result(None, f"{text}{number(max(peaks), 3)} N.")


def _without_delay(some: int, contacts: int) -> str:
    return f"{some} of {contacts} {'contact has' if contacts == 1 else 'contacts have'} no delay"


def _sooner(scores: Mapping[str, DetectorScore], acting: str, other: str) -> Iterator[Result]:
    """The detector that only observed beside the one that stopped, on the same approaches."""
    if acting not in scores:
        return
    mine, stops = scores[other], scores[acting]
    if not (mine.true and stops.true and min(mine.delay_s.mean, stops.delay_s.mean) > 0.0):
        return
    times = stops.delay_s.mean / mine.delay_s.mean
    how = f"{max(times, 1.0 / times):.1f} times {'sooner' if times > 1.0 else 'later'}"
    text = f"The detector “{other}” is {how} on the same approaches: "
    text += f"{mean_within(mine.delay_s)} s, beside {mean_within(stops.delay_s)}; "
    yield Result(None, f"{text}false in {rate(mine.false, mine.n)}.")


def _scatter(rows: Sequence[TableRow], simulated: bool) -> Iterator[Result]:
    """The scatter within a row, which decides how mild the comparison is."""
    pairs = [(row.mean("delay_s").sigma, row.paper["delay_s.sd"]) for row in rows if row.paper]
    known = np.array([pair for pair in pairs if not math.isnan(pair[0])])
    if len(known) < 3:
        return
    ours, paper = np.sqrt(np.mean(known**2, axis=0))
    text = f"Within a row the time scatters by {number(ours)} s, in the paper by {number(paper)} s"
    why = ": unexplained; the simulated finger may bounce more erratically, or wander more, than theirs"
    yield Result(None, f"{text}{why if simulated and ours > 1.5 * paper else ''}.")


def _onset_is_noise(each: Approach) -> bool:
    """Whether the load cell reached its onset before the probe touched, where that is known."""
    onset_s, touch_s = each["onset_s"], each["truth_contact_s"]
    return onset_s is not None and touch_s is not None and not not_before(onset_s, touch_s)


def _beside_table_1(each: Bounded, kind: Kind) -> Result:
    """A column beside Table I, row by row and on average: one comparison, one verdict."""
    bound, rows = each.bound, each.rows
    assert rows is not None
    within = f"{each.within} of {each.judged} rows of Table I within scatter; " if each.judged else ""
    text = f"{bound['title'].capitalize()}: {within}"
    text += f"on average over {rows.n} rows {rows.ours / rows.paper:.2f} times the paper's"
    if not math.isnan(rows.low):
        low, high = (1.0 + end / rows.paper for end in (rows.low, rows.high))
        text += f" ({low:.2f} to {high:.2f})"
    return judged(
        kind,
        text + ", beyond chance" * (each.same is False),
        each.same,
        rows.n,
        better=rows.ours < rows.paper,
    )


def _beside_bound(each: Bounded, kind: Kind) -> Result:
    """A column beside the bound that the paper states."""
    bound, beside = each.bound, each.beside
    text = f"{bound['title'].capitalize()} at detection: {bound['over']} {_printed(bound, beside.ours)}, "
    text += f"the paper's {_printed(bound, beside.paper)} ({bound['source']}): "
    text += sized(beside.ours, beside.paper, scale_of(bound["column"]).unit)
    if each.kept is None:
        return judged(kind, text, None, beside.n, goal=True)
    return Result(kind, f"{text}.", beside.met, goal=True)


def _learned(run: Run, acting: str) -> str:
    """How many independent values the detector's baseline holds: what its threshold rests on."""
    names = ("baseline_s", "average_samples", "sample_hz", "sigma_of")
    baseline_s, samples, rate_hz, of = (setting_of(run, "detectors", acting, name) for name in names)
    if not (baseline_s and samples and rate_hz):
        return ""
    if of == "samples":
        count = f"{baseline_s * rate_hz:g}"
        return f"A baseline of {baseline_s:g} s holds {count} samples to learn mean and σ from."
    text = f"A baseline of {baseline_s:g} s of {samples}-sample averages at {rate_hz:g} a second holds some "
    return f"{text}{number(baseline_s * rate_hz / samples, 1)} independent values to learn mean and σ from."


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
            squares: Any = {"fmt": "s", "mfc": "white", "color": PAPER, "lw": 0.8, "label": "paper, mean ± σ"}
            axes.errorbar(theirs[0] - shift, theirs[1] * scale.factor, theirs[2] * scale.factor, **squares)
            means = [row.mean(what) for _, row in mine]
            sigmas = np.nan_to_num([mean.sigma for mean in means]) * scale.factor
            circles: Any = {"fmt": "o", "color": OURS, "lw": 1.0, "label": "this run, mean ± σ"}
            heights = [mean.mean * scale.factor for mean in means]
            axes.errorbar([x + shift for x, _ in mine], heights, sigmas, **circles)
            single = [(x + 3.0 * shift, each[what]) for x, row in mine for each in row.contacts]
            known = [(x, value * scale.factor) for x, value in single if value is not None]
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
            axes.set(xscale="log", xlabel="noise, relative to the plant's own", ylabel=label)
            axes.set_xticks(scales, [f"{scale:g}" for scale in scales])
            axes.set_xticks([], minor=True)
            axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        drawing.legend(left, len(rates))
        return drawing.save("delay_noise_rate")
