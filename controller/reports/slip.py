"""The part of the page on B1 to B5 and B8: slip with five sensors, beside the paper's figures and its Table 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from typing import Any

import numpy as np

from controller.detectors.calibration import poisson_interval
from controller.recording.reader import Run
from controller.reports.counts import values, wilson
from controller.reports.fernandez import CITATION
from controller.reports.figures import Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Kind, Printed, Result, Section
from controller.reports.slip_figures import draw_fingertip_spectra, draw_run
from controller.reports.slip_scores import (
    METHODS,
    PLAIN,
    SENSORS,
    TABLE_1,
    Condition,
    Score,
    condition_of,
    measured_rows,
    read_scores,
)
from controller.reports.slip_verdicts import LEAST, NOT_JUDGED, VERDICTS
from controller.reports.text import NOTHING, number


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The comparison table and each sensor's run."""
    scores = read_scores(runs)
    conditions = sorted(
        dict.fromkeys(score.condition for score in scores), key=lambda each: (each.nuisance != PLAIN, each)
    )
    ids = [paper.id for name, paper in SENSORS.items() if any(score.sensor == name for score in scores)]
    return Section(
        title=f"Slip ({', '.join([*ids, 'B8'])})",
        template="plain.html.j2",
        citation=CITATION,
        summary=_summary(scores, runs[0].simulated),
        not_the_papers=_not_the_papers(runs[0], {score.sensor for score in scores}),
        printed=_printed(runs[0]),
        context={
            "paragraphs": [
                "A tip touches a table, rolls on it and slips. Both detectors hear the same samples of the same "
                f"sensor. A slip counts as missed where nothing was said of it within "
                f"{VERDICTS['missed_after_s']:g} s, as early where the detector called slip before it began; "
                "delays run from the first motion of the contact where that is known, else from the order to "
                "slide. A slip that a stop of the arm cut short before it was told is none of these, and trials "
                "that an error or a pause ended are left out."
            ],
            "tables": [
                *(table for condition in conditions for table in _tables(scores, condition)),
                *_frequencies(runs),
                *_stops(runs),
            ],
            "figures": _draw(runs, figures),
            "notes": [*_disagreements(scores), *_too_slow(scores, runs)],
        },
    )


def _tables(scores: Sequence[Score], condition: Condition) -> Sequence[Mapping[str, Any]]:
    """Slips, and false alarms, of every sensor and detector under one condition."""
    told, alarms = [], []
    for score in scores:
        if score.condition != condition:
            continue
        paper = SENSORS[score.sensor]
        who = [f"{paper.id} {paper.name}", METHODS[score.method]]
        delays_ms = 1e3 * np.array(score.delays_s)
        if score.slips:
            told.append(
                [
                    *who,
                    f"{score.early} of {score.slips}",
                    _missed(score),
                    number(float(np.median(delays_ms)) if len(delays_ms) else None, 0),
                    number(float(np.percentile(delays_ms, 95)) if len(delays_ms) else None, 0),
                    _said(score),
                    *([paper.verdict] if condition == TABLE_1 else []),
                ]
            )
        alarms.append(
            [
                *who,
                str(score.alarms),
                _minutes(score.heard_s),
                interval(score.alarms, score.heard_s),
                f"{score.touch_alarms} in {score.touches}" if score.touches else NOTHING,
            ]
        )
    slips = {
        "caption": _caption(condition),
        "head": [
            *("sensor", "detector", "early", "missed (95 %)", "median", "p95"),
            *(("verdict", "the paper's") if condition == TABLE_1 else ("verdict",)),
        ],
        "rows": told,
        "left": 2,
    }
    quiet = {
        "caption": _alarm_caption(condition),
        "head": ["sensor", "detector", "false alarms", "in", "mean interval (95 %)", "at touches"],
        "rows": alarms,
        "left": 2,
    }
    return [slips, quiet] if told else [quiet]


def _missed(score: Score) -> str:
    """`1 of 20 (1 to 24 %)`: how many of those told or missed, and the 95 % interval of that share."""
    if not score.scored:
        return NOTHING
    low, high = wilson(score.missed, score.scored)
    return f"{score.missed} of {score.scored} ({number(low, 0, 100.0)} to {number(high, 0, 100.0)} %)"


def _said(score: Score) -> str:
    """The verdict, with what it must not be read without."""
    if score.verdict == NOT_JUDGED:
        return f"{NOT_JUDGED} ({score.scored} of {score.slips})"
    return f"{score.verdict} (too slow)" if score.too_slow else score.verdict


def _caption(condition: Condition) -> str:
    if condition != TABLE_1:
        return f"{_under(condition)}: columns as in Table 1, thresholds as in the profile." + (
            " What the stop cuts short is not scored, and there is no verdict on the other detector."
            if condition.reflex
            else ""
        )
    good, regular = VERDICTS["good"], VERDICTS["regular"]
    return (
        f"Table 1, from our own measurements. Good: at most {good['missed']:.0%} missed and a median of "
        f"{1e3 * good['median_s']:g} ms; regular: {regular['missed']:.0%} and {1e3 * regular['median_s']:g} ms; "
        f"bad: the rest; fixed before the first run. Judged are slips told or missed, at least {LEAST} of them; "
        "those called early are a failure beside the verdict. Delays in ms of the slips that were told (of two "
        "in one trial, their median). Intervals: Wilson. Not at equal false alarms, but at the thresholds in the table "
        "of settings; the study in benchmarks/results/slip.md compares at equal ones."
    )


def _alarm_caption(condition: Condition) -> str:
    return (
        f"False alarms. {_under(condition)}. Counted in the time without slip in which the detector could have "
        "alarmed: from when it had learned, without descent and pressing, whose alarms stand in the last column "
        "(a dash: nobody listened yet). Mean interval: that time over the alarms; where there was none, the "
        "lower end alone is known (Poisson)."
    )


def _under(condition: Condition) -> str:
    """`With bumps, 1 a second; the arm stops when ours tells slip`."""
    nuisance = "As in Table 1" if condition.nuisance == PLAIN else f"With {condition.nuisance}"
    return (
        f"{nuisance}; the arm stops when {METHODS[condition.reflex]} tells slip"
        if condition.reflex
        else nuisance
    )


def interval(alarms: int, heard_s: float) -> str:
    """`20 min (8 to 61)`: mean time between false alarms and its 95 % interval; `over 4 min` where there was none."""
    if heard_s <= 0.0:
        return NOTHING
    low, high = poisson_interval(alarms)
    if alarms == 0:
        return f"over {_minutes(heard_s / high)}"
    return f"{_minutes(heard_s / alarms)} ({_minutes(heard_s / high)} to {_minutes(heard_s / low)})"


def _minutes(seconds: float) -> str:
    return (
        f"{number(seconds, 0 if seconds >= 10.0 else 1)} s"
        if seconds < 120.0
        else f"{number(seconds / 60.0, 0)} min"
    )


def _frequencies(runs: Sequence[Run]) -> Sequence[Mapping[str, Any]]:
    body = []
    for sensor, paper in SENSORS.items():
        rows = [
            row
            for run in runs
            for row in measured_rows(run)
            if row.get("sensor") == sensor and condition_of(run, row).nuisance == PLAIN
        ]
        if not rows:
            continue

        def median(column: str, rows: Sequence[Any] = rows) -> str:
            found = values(rows, column)
            return f"{float(np.median(found)):.3g}" if found else NOTHING

        body.append(
            [
                f"{paper.id} {paper.name}",
                median("dominant_hz"),
                number(paper.dominant_hz, 0) if paper.dominant_hz else "none stands out",
                median("peak_product"),
                median("peak_product_before"),
                median("press_n"),
            ]
        )
    if not body:
        return []
    return [
        {
            "caption": "The paper's statistic on each sensor: frequency that dominates in slip, and the largest "
            "product of peak and "
            "frequency in slip and before it (medians over trials, in the sensor's own unit squared times Hz).",
            "head": [
                "sensor",
                "in slip, Hz",
                "the paper, Hz",
                "product in slip",
                "before",
                "pressed with, N",
            ],
            "rows": body,
            "left": 1,
        }
    ]


def _stops(runs: Sequence[Run]) -> list[Mapping[str, Any]]:
    """From the sample that told slip to the arm being told to stop; by the wall clock where devices are on the wire."""
    body = []
    for bench in sorted({str(run.manifest.get("bench")) for run in runs}):
        rows = [row for run in runs if run.manifest.get("bench") == bench for row in run.trials]
        latencies_ms = 1e3 * np.array(values(rows, "slip_to_stop_s"))
        if not len(latencies_ms):
            continue
        lost = [run.manifest.get("loss") or {} for run in runs if run.manifest.get("bench") == bench]
        forces = sum(int(loss.get("arm.force", 0)) for loss in lost)
        body.append(
            [
                bench,
                str(len(latencies_ms)),
                *(number(float(np.percentile(latencies_ms, share)), 1) for share in (50, 99, 100)),
                number(1e3 * float(np.median(values(rows, "stop_travel_m") or [np.nan])), 2),
                str(forces),
            ]
        )
    if not body:
        return []
    return [
        {
            "caption": "Slip told, arm told to stop: from the time of the deciding sample to the command's "
            "last byte, ms; the tool's way "
            "until it stood, mm; samples lost of the arm's force stream. On the emulated bench the arm's "
            "side of it is the "
            "emulated controller's behaviour, not a real controller's.",
            "head": ["bench", "stops", "p50", "p99", "max", "way, mm", "lost"],
            "rows": body,
            "left": 1,
        }
    ]


def _summary(scores: Sequence[Score], simulated: bool) -> list[Result]:
    plain = [score for score in scores if score.condition == TABLE_1 and score.slips]
    said = [_held_against_the_paper(score, simulated) for score in plain if score.method == "paper"]
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
                stops = f"the arm stops when {METHODS[condition.reflex]} tells slip"
                said.append(Result(None, f"{names}: {stops}; {other} detector is not judged."))
            continue
        for sensor, paper in SENSORS.items():
            if (sensor, "ours") in found:
                ours, theirs = _tally(found[sensor, "ours"]), _tally(found[sensor, "paper"])
                words = f"{paper.id} with {condition.nuisance}: ours {ours}; the paper's {theirs}."
                said.append(Result(Kind.ASSUMED if simulated else Kind.MEASURED, words))
    return said


def _held_against_the_paper(score: Score, simulated: bool) -> Result:
    """The verdict on the paper's detector beside the paper's own; good news only where it leaves nothing out."""
    paper = SENSORS[score.sensor]
    kind = paper.kind if simulated else Kind.MEASURED
    early = f"{score.early} of {score.slips} slips were called before they began"
    if score.verdict == NOT_JUDGED:
        why = f"it told or missed {score.scored} of {score.slips} slips, and {LEAST} are the least"
        words = f"{paper.id} {paper.name}: the paper's detector is not judged: {why}"
        return Result(kind, words + (f"; {early}." if score.early else "."))
    median = (
        f"median {number(1e3 * float(np.median(score.delays_s)), 0)} ms" if score.delays_s else "tells none"
    )
    words = (
        f"{paper.id} {paper.name}: the paper's detector misses {score.missed} of {score.scored}, "
        f"{median}: {score.verdict}; the paper says {paper.verdict}."
    )
    agrees = score.verdict == paper.verdict
    if not score.early:
        return Result(kind, words, agrees)
    return Result(kind, f"{words} Beside that, {early}.", None if agrees else False)


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


def _tally(score: Score) -> str:
    """`misses 1 of 6 with 2 false alarms in 15 min, 1 early`."""
    early = f", {score.early} early" if score.early else ""
    return (
        f"misses {score.missed} of {score.scored}{early}, with {score.alarms} false alarms in "
        f"{_minutes(score.heard_s)} and {score.touch_alarms} at touch"
    )


def _disagreements(scores: Sequence[Score]) -> list[str]:
    """Where a verdict is not the paper's, and why."""
    notes = []
    for score in scores:
        paper = SENSORS[score.sensor]
        if score.method != "paper" or score.condition != TABLE_1:
            continue
        if score.verdict in (paper.verdict, NOTHING, NOT_JUDGED):
            continue
        median_ms = 1e3 * float(np.median(score.delays_s)) if score.delays_s else float("nan")
        notes.append(
            f"{paper.id} comes out {score.verdict} where the paper says {paper.verdict}: {score.missed} of "
            f"{score.scored} slips missed, median {number(median_ms, 0)} ms. The paper's verdict rests on one run "
            "and one look at its figure; the noise of this sensor is not printed and is assumed here."
        )
    return notes


def _too_slow(scores: Sequence[Score], runs: Sequence[Run]) -> list[str]:
    """Where ours cannot be in time at its threshold: its verdict was settled before the run."""
    notes = {}
    for score in scores:
        if not score.too_slow:
            continue
        names = {setting_of(run, "behavior", "sensors", score.sensor, "ours") for run in runs}
        thresholds = {setting_of(run, "detectors", str(name), "threshold") for run in runs for name in names}
        at = " or ".join(f"{value:g}" for value in thresholds if isinstance(value, int | float))
        notes[score.sensor] = (
            f"{SENSORS[score.sensor].id}: at its threshold ({at} nats) ours takes at least "
            f"{score.least_delay_s:.2f} s, for no sample is worth more than one knock; a slip counts as missed "
            f"after {VERDICTS['missed_after_s']:g} s. That it misses was settled before the run: it says nothing "
            "about slip on this sensor."
        )
    return list(notes.values())


def _not_the_papers(run: Run, sensors: Set[str]) -> list[str]:
    said = []
    if "wrist" in sensors:
        said.append(
            "The arm's own tool force is heard in the place of the JR3 wrist sensor (the paper's, 1 kHz)."
        )
    if run.simulated:
        said.append(
            "Friction, roughness, damping and the noise of all but the fingertip are assumptions; rolling is "
            "fitted to printed spectra."
        )
    if run.manifest.get("bench") == "emulated":
        said.append(
            "Contact and stop on the wire rest on behaviour of the arm's controller that was never measured on "
            "a real one."
        )
    return said


def _draw(runs: Sequence[Run], figures: Figures) -> list[Mapping[str, Any]]:
    """One figure a sensor, from its first recorded trial without other nuisance."""
    drawn: list[Mapping[str, Any]] = []
    captions = {
        "fingertip": "Fig. 8, 10, 11. Strain-gauge fingertip: forces, angle, and the paper's statistic at each block.",
        "flexible_finger": "Fig. 13. Flexible finger.",
        "barrett_finger": "Fig. 15. BarrettHand finger torque.",
        "wrist": "Fig. 17. Wrist force: the arm's own, in the JR3's place.",
        "dsa": "Fig. 19. DSA matrix: the texel that is loaded most, and the statistic of the one that decides.",
    }
    for sensor, caption in captions.items():
        for run in runs:
            recorded = set(run.recorded_trials)
            row = next(
                (
                    row
                    for row in measured_rows(run)
                    if row.get("sensor") == sensor
                    and row["slips"]
                    and int(row["trial"]) in recorded
                    and condition_of(run, row).nuisance == PLAIN
                ),
                None,
            )
            if row is None:
                continue
            svg = draw_run(figures, run, row, sensor)
            if svg is not None:
                note = " Shaded: slip. Time as in the paper's run. Circles: our detector's words; crosses: the paper's."
                drawn.append({"svg": svg, "caption": caption + note})
            if sensor == "fingertip":
                spectra = draw_fingertip_spectra(figures, run, row)
                if spectra is not None:
                    drawn.append(
                        {
                            "svg": spectra,
                            "caption": "Fig. 9. Power spectrum of Ft: before contact, rolling, slipping, at rest.",
                        }
                    )
            break
    return drawn
