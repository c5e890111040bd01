"""The part of the page on B1 to B5 and B8: slip with five sensors, beside the paper's figures and its Table 1."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from controller.detectors.calibration import poisson_interval
from controller.recording.reader import Run
from controller.reports.counts import of_benches, percentiles, values, wilson
from controller.reports.fernandez import CITATION
from controller.reports.figures import Figures
from controller.reports.run_account import setting_of
from controller.reports.section import (
    Block,
    Column,
    Figure,
    Kind,
    Notes,
    Printed,
    ReportTable,
    Result,
    Section,
)
from controller.reports.section_texts import SectionTexts
from controller.reports.slip_figures import draw_fingertip_spectra, draw_run
from controller.reports.slip_scores import (
    METHODS,
    PLAIN,
    SENSORS,
    TABLE_1,
    Condition,
    SensorScore,
    condition_of,
    measured_rows,
    read_scores,
)
from controller.reports.slip_verdicts import LEAST, NOT_JUDGED, VERDICTS
from controller.reports.text import number, quantity
from controller.scales import NOTHING

TEXTS = SectionTexts("slip")
FIGURES = TEXTS.named("figures")

SAME_RATE = 0.01
"""Sample rates nearer than that give one vibration the same power: a block's power grows with its number of samples."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The comparison table and each sensor's run."""
    scores = read_scores(runs)
    conditions = sorted(
        dict.fromkeys(score.condition for score in scores), key=lambda each: (each.nuisance != PLAIN, each)
    )
    ids = [paper.id for name, paper in SENSORS.items() if any(score.sensor == name for score in scores)]
    notes = [*_disagreements(scores), *_too_slow(scores, runs)]
    body: list[Block] = [TEXTS.text("intro", missed_after_s=VERDICTS["missed_after_s"])]
    body += [table for condition in conditions for table in _tables(scores, condition)]
    for name, rows in (("frequencies", _frequencies(runs)), ("stops", _stops(runs))):
        body += [TEXTS.table(name, rows)] if rows else []
    body += _draw(runs, figures)
    body += [Notes(notes)] if notes else []
    ours = {
        "wrist": any(score.sensor == "wrist" for score in scores),
        "simulated": runs[0].simulated,
        "emulated": runs[0].manifest.get("bench") == "emulated",
    }
    return Section(
        title=f"Slip ({', '.join([*ids, 'B8'])})",
        body=body,
        citation=CITATION,
        summary=_summary(scores, runs[0].simulated),
        not_the_papers=[TEXTS.sentence(name) for name, holds in ours.items() if holds],
        printed=_printed(runs[0]),
    )


def _tables(scores: Sequence[SensorScore], condition: Condition) -> Iterator[ReportTable]:
    """Slips, and false alarms, of every sensor and detector under one condition."""
    rows = [_row(score) for score in scores if score.condition == condition]
    slips = [row for row in rows if row["slips"]]
    papers = [Column("the paper's", "paper")] if condition == TABLE_1 else []
    if slips:
        yield TEXTS.table("slips", slips, papers, caption=_caption(condition))
    yield TEXTS.table("alarms", rows, under=_under(condition))


def _row(score: SensorScore) -> dict[str, Any]:
    paper = SENSORS[score.sensor]
    return {
        "sensor": f"{paper.id} {paper.name}",
        "detector": METHODS[score.method],
        "slips": score.slips,
        "early": f"{score.early} of {score.slips}",
        "missed": _missed(score),
        "median_s": float(np.median(score.delays_s)) if score.delays_s else None,
        "p95_s": float(np.percentile(score.delays_s, 95)) if score.delays_s else None,
        "verdict": _verdict(score),
        "paper": paper.verdict,
        "alarms": score.alarms,
        "quiet": _minutes(score.quiet_s),
        "interval": interval(score.alarms, score.quiet_s),
        "touches": f"{score.touch_alarms} in {score.touches}" if score.touches else NOTHING,
    }


def _missed(score: SensorScore) -> str:
    """`1 of 20 (1 to 24 %)`: how many of those detected or missed, and the 95 % interval of that share."""
    if not score.scored:
        return NOTHING
    low, high = wilson(score.missed, score.scored)
    return f"{score.missed} of {score.scored} ({number(low, 0, 100.0)} to {number(high, 0, 100.0)} %)"


def _verdict(score: SensorScore) -> str:
    """The verdict with its qualification."""
    if score.verdict == NOT_JUDGED:
        return f"{NOT_JUDGED} ({score.scored} of {score.slips})"
    return f"{score.verdict} (too slow)" if score.too_slow else score.verdict


def _caption(condition: Condition) -> str:
    if condition != TABLE_1:
        cut = TEXTS.sentence("cut") if condition.reflex else ""
        return TEXTS.sentence("other", under=_under(condition), cut=cut)
    limits = {f"{grade}_missed": VERDICTS[grade]["missed"] for grade in ("good", "regular")}
    limits |= {f"{grade}_s": VERDICTS[grade]["median_s"] for grade in ("good", "regular")}
    return TEXTS.sentence("table_1", least=LEAST, **limits)


def _under(condition: Condition) -> str:
    """`With bumps, 1 a second; the arm stops when ours detects slip`."""
    nuisance = "As in Table 1" if condition.nuisance == PLAIN else f"With {condition.nuisance}"
    return (
        f"{nuisance}; the arm stops when {METHODS[condition.reflex]} detects slip"
        if condition.reflex
        else nuisance
    )


def interval(alarms: int, quiet_s: float) -> str:
    """`20 min (8 to 61)`: mean time between false alarms and its 95 % interval; `over 4 min` where there was none."""
    if quiet_s <= 0.0:
        return NOTHING
    low, high = poisson_interval(alarms)
    if alarms == 0:
        return f"over {_minutes(quiet_s / high)}"
    return f"{_minutes(quiet_s / alarms)} ({_minutes(quiet_s / high)} to {_minutes(quiet_s / low)})"


def _minutes(seconds: float) -> str:
    return (
        f"{number(seconds, 0 if seconds >= 10.0 else 1)} s"
        if seconds < 120.0
        else f"{number(seconds / 60.0, 0)} min"
    )


def _frequencies(runs: Sequence[Run]) -> list[dict[str, Any]]:
    found = []
    for sensor, paper in SENSORS.items():
        rows = [
            row
            for run in runs
            for row in measured_rows(run)
            if row.get("sensor") == sensor and condition_of(run, row).nuisance == PLAIN
        ]
        if not rows:
            continue
        medians = {
            column: float(np.median(known)) if (known := values(rows, column)) else None
            for column in ("dominant_hz", "peak_product", "peak_product_before", "press_n")
        }
        unit, factor, why = _signal_scale(runs, sensor)
        for name in ("peak_product", "peak_product_before"):
            product = medians.pop(name)
            medians[name] = product and product * factor**2
        printed = number(paper.dominant_hz, 0) if paper.dominant_hz else "none stands out"
        named = {"sensor": f"{paper.id} {paper.name}", "paper_hz": printed, "unit": f"{unit}² Hz"}
        found.append(named | {"paper_product": paper.product, "why": why} | medians)
    return found


def _signal_scale(runs: Sequence[Run], sensor: str) -> tuple[str, float, str]:
    """Unit that a signal is shown in, the factor to it, and whether the product's scale is the paper's."""
    paper = SENSORS[sensor]
    run, row = next(_drawable(runs, sensor), (None, None))
    recording = run.readable(int(row["trial"])) if run is not None and row is not None else None
    if run is None or recording is None:
        return "signal", 1.0, "unknown: no trial in slip is recorded"
    series = recording.stream(str(setting_of(run, "behavior", "sensors", sensor, "stream")))
    rate_hz = 1.0 / float(np.median(np.diff(series.times_s))) if len(series) > 1 else paper.rate_hz
    unit, factor = paper.drawn_in(series.unit)
    if unit != paper.signal:
        return unit, factor, f"no: the paper's signal is in {paper.signal}"
    if abs(rate_hz / paper.rate_hz - 1.0) > SAME_RATE:
        return unit, factor, f"no: {rate_hz:.0f} Hz here, the paper {paper.rate_hz:.0f} Hz"
    return unit, factor, "yes"


def _stops(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """From the sample that showed slip to the arm's stop command; by the wall clock where devices are on the wire."""
    found = []
    for bench, own, lost in of_benches(runs, "arm.force"):
        rows = [row for run in own for row in run.trials]
        if waits_s := values(rows, "slip_to_stop_s"):
            way_m = float(np.median(values(rows, "stop_travel_m") or [np.nan]))
            found.append({"bench": bench, "way_m": way_m, "lost": lost} | percentiles(waits_s))
    return found


def _summary(scores: Sequence[SensorScore], simulated: bool) -> list[Result]:
    plain = [score for score in scores if score.condition == TABLE_1 and score.slips]
    results = [_compared_with_the_paper(score, simulated) for score in plain if score.method == "paper"]
    for condition in dict.fromkeys(score.condition for score in scores):
        if condition == TABLE_1:
            continue
        found = {
            (each.sensor, each.method): each for each in scores if each.condition == condition and each.slips
        }
        if condition.reflex:
            names = ", ".join(SENSORS[sensor].id for sensor, method in found if method == condition.reflex)
            other = next(METHODS[method] for method in METHODS if method != condition.reflex)
            if names:
                stops = f"the arm stops when {METHODS[condition.reflex]} detects slip"
                results.append(Result(None, f"{names}: {stops}; {other} detector is not judged."))
            continue
        for sensor, paper in SENSORS.items():
            if (sensor, "ours") in found:
                ours, theirs = _tally(found[sensor, "ours"]), _tally(found[sensor, "paper"])
                text = f"{paper.id} with {condition.nuisance}: ours {ours}; the paper's {theirs}."
                results.append(Result(Kind.ASSUMED if simulated else Kind.MEASURED, text))
    return results


def _compared_with_the_paper(score: SensorScore, simulated: bool) -> Result:
    """The verdict on the paper's detector beside the paper's own; good news only where it leaves nothing out."""
    paper = SENSORS[score.sensor]
    kind = paper.kind if simulated else Kind.MEASURED
    early = f"{score.early} of {score.slips} slips were called before they began"
    if score.verdict == NOT_JUDGED:
        why = f"it detected or missed {score.scored} of {score.slips} slips, and {LEAST} are the least"
        text = f"{paper.id} {paper.name}: the paper's detector is not judged: {why}"
        return Result(kind, text + (f"; {early}." if score.early else "."))
    median = (
        f"median {quantity('delay_s', float(np.median(score.delays_s)), 3)}"
        if score.delays_s
        else "none detected"
    )
    text = (
        f"{paper.id} {paper.name}: the paper's detector misses {score.missed} of {score.scored}, "
        f"{median}: {score.verdict}; the paper says {paper.verdict}."
    )
    agrees = score.verdict == paper.verdict
    if not score.early:
        return Result(kind, text, agrees)
    return Result(kind, f"{text} Beside that, {early}.", None if agrees else False)


def _printed(run: Run) -> Mapping[str, Printed]:
    """What the paper prints of its detector on each sensor of a profile, by the path of the setting."""
    found: dict[str, Printed] = {}
    for sensor, table in (setting_of(run, "behavior", "sensors") or {}).items():
        paper = SENSORS.get(sensor)
        name = table.get("paper") if isinstance(table, Mapping) else None
        if paper is not None and setting_of(run, "detectors", str(name)):
            threshold = "not printed" if paper.threshold is None else paper.threshold
            found[f"detectors.{name}.block_s"] = Printed(paper.block_s, paper.source)
            found[f"detectors.{name}.threshold"] = Printed(threshold, paper.source)
    return found


def _tally(score: SensorScore) -> str:
    """`misses 1 of 6 with 2 false alarms in 15 min, 1 early`."""
    early = f", {score.early} early" if score.early else ""
    return (
        f"misses {score.missed} of {score.scored}{early}, with {score.alarms} false alarms in "
        f"{_minutes(score.quiet_s)} and {score.touch_alarms} at touch"
    )


def _disagreements(scores: Sequence[SensorScore]) -> list[str]:
    """Where a verdict is not the paper's, and why."""
    notes = []
    for score in scores:
        paper = SENSORS[score.sensor]
        if score.method != "paper" or score.condition != TABLE_1:
            continue
        if score.verdict in (paper.verdict, NOTHING, NOT_JUDGED):
            continue
        median_s = float(np.median(score.delays_s)) if score.delays_s else float("nan")
        facts = {"id": paper.id, "verdict": score.verdict, "paper": paper.verdict, "scored": score.scored}
        notes.append(
            TEXTS.sentence("disagrees", missed=score.missed, median=quantity("delay_s", median_s, 3), **facts)
        )
    return notes


def _too_slow(scores: Sequence[SensorScore], runs: Sequence[Run]) -> list[str]:
    """Where ours cannot be in time at its threshold: its verdict was settled before the run."""
    notes = {}
    for score in scores:
        if not score.too_slow:
            continue
        names = {setting_of(run, "behavior", "sensors", score.sensor, "ours") for run in runs}
        thresholds = {setting_of(run, "detectors", str(name), "threshold") for run in runs for name in names}
        at = " or ".join(f"{value:g}" for value in thresholds if isinstance(value, int | float))
        notes[score.sensor] = TEXTS.sentence(
            "too_slow",
            id=SENSORS[score.sensor].id,
            at=at,
            least=score.least_delay_s,
            missed_after_s=VERDICTS["missed_after_s"],
        )
    return list(notes.values())


def _draw(runs: Sequence[Run], figures: Figures) -> Iterator[Figure]:
    """One figure a sensor, from its first recorded trial without other nuisance."""
    for sensor, caption in FIGURES.items():
        run, row = next(_drawable(runs, sensor), (None, None))
        if run is None or row is None:
            continue
        svg = draw_run(figures, run, row, sensor)
        if svg is not None:
            yield Figure(svg, caption + TEXTS.sentence("shaded"))
        spectra = draw_fingertip_spectra(figures, run, row) if sensor == "fingertip" else None
        if spectra is not None:
            yield Figure(spectra, TEXTS.sentence("spectra"))


def _drawable(runs: Sequence[Run], sensor: str) -> Iterator[tuple[Run, Any]]:
    for run in runs:
        for row in measured_rows(run):
            plain = row.get("sensor") == sensor and condition_of(run, row).nuisance == PLAIN
            if plain and row["slips"] and int(row["trial"]) in run.recorded_trials:
                yield run, row
