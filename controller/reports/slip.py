"""The part of the page on B1 to B5 and B8: slip with five sensors, beside the paper's figures and its Table 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from controller.detectors.calibration import poisson_interval
from controller.recording.reader import Run
from controller.reports.counts import total, values
from controller.reports.fernandez import CITATION
from controller.reports.figures import Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Section
from controller.reports.slip_figures import draw_fingertip_spectra, draw_run
from controller.reports.slip_verdicts import VERDICTS, verdict
from controller.reports.text import NOTHING, number

METHODS = {"paper": "the paper's", "ours": "ours"}


@dataclass(frozen=True, slots=True)
class PaperSensor:
    """A line of the paper's Table 1.

    Attributes:
        id: Of the experiment.
        name: In words.
        noise: The paper's word for it.
        verdict: The paper's word for its slip detection.
        dominant_hz: Frequency of the slip vibration, None where none stands out.
    """

    id: str
    name: str
    noise: str
    verdict: str
    dominant_hz: float | None


SENSORS: Mapping[str, PaperSensor] = {
    "fingertip": PaperSensor("B1", "fingertip", "medium", "good", 180.0),
    "flexible_finger": PaperSensor("B2", "flexible finger", "medium", "good", 125.0),
    "barrett_finger": PaperSensor("B3", "BarrettHand", "high", "regular", 375.0),
    "wrist": PaperSensor("B4", "wrist", "high", "bad", None),
    "dsa": PaperSensor("B5", "DSA matrix", "low", "bad", None),
}
"""Table 1 and sections 4.3, 5.1 to 5.4."""


@dataclass(frozen=True, slots=True)
class Score:
    """One detector on one sensor under one nuisance, over all trials."""

    sensor: str
    nuisance: str
    method: str
    slips: int
    missed: int
    early: int
    delays_s: Sequence[float]
    alarms: int
    heard_s: float
    verdict: str


def read_scores(runs: Sequence[Run]) -> list[Score]:
    """Every sensor, nuisance and detector of which there are trials."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for run in runs:
        for row in run.trials:
            if row.get("slips") is not None:
                groups.setdefault((str(row.get("sensor")), nuisance_of(run)), []).append(row)
    scores = []
    for sensor in SENSORS:
        for (name, nuisance), rows in sorted(groups.items()):
            if name != sensor:
                continue
            for method in METHODS:
                slips, missed = total(rows, "slips"), total(rows, f"{method}_missed")
                # A row holds the median of its trial's one or two slips: it stands for each of them that was told.
                delays_s = [
                    float(row[f"{method}_delay_s"] or 0.0)
                    for row in rows
                    for _ in range(int(row.get(f"{method}_detected") or 0))
                ]
                scores.append(
                    Score(
                        sensor,
                        nuisance,
                        method,
                        slips,
                        missed,
                        total(rows, f"{method}_early"),
                        delays_s,
                        total(rows, f"{method}_false_alarms"),
                        sum(values(rows, "quiet_s")),
                        _judged(missed, slips, delays_s),
                    )
                )
    return scores


def _judged(missed: int, slips: int, delays_s: Sequence[float]) -> str:
    """Good, regular or bad, a missed slip being one that is told never; nothing where there was no slip."""
    if not slips:
        return NOTHING
    told_s = [*delays_s, *[np.inf] * missed]
    return verdict(missed / slips, float(np.median(told_s)) if told_s else np.inf)


def nuisance_of(run: Run) -> str:
    """What shakes the tip beside slip and rolling."""
    said = []
    for key, words in (("bumps_hz", "bumps, {:g} a second"), ("loads_hz", "load steps, {:g} a second")):
        hz = setting_of(run, "plant", key)
        if isinstance(hz, int | float) and hz > 0.0:
            said.append(words.format(hz))
    return "; ".join(said) or "none"


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The comparison table and each sensor's run."""
    scores = read_scores(runs)
    nuisances = list(dict.fromkeys(score.nuisance for score in scores))
    drawn = _draw(runs, figures)
    return Section(
        title="Slip with five sensors (B1 to B5, B8)",
        template="plain.html.j2",
        citation=CITATION,
        summary=_summary(scores),
        not_the_papers=_not_the_papers(runs),
        context={
            "paragraphs": [
                "A tip touches a table, rolls on it and slips. Both detectors hear the same samples of the "
                "same sensor. "
                "A slip counts as missed where nothing was said of it within "
                f"{VERDICTS['missed_after_s']:g} s, as early where the detector called slip before it began; "
                "delays run from "
                "the first motion of the contact where that is known, else from the order to slide."
            ],
            "tables": [
                _table(scores, "none"),
                *(_table(scores, nuisance) for nuisance in nuisances if nuisance != "none"),
                _frequencies(runs),
                *_stops(runs),
            ],
            "figures": drawn,
            "notes": _disagreements(scores),
        },
    )


def _table(scores: Sequence[Score], nuisance: str) -> Mapping[str, Any]:
    body = []
    for score in scores:
        if score.nuisance != nuisance:
            continue
        paper = SENSORS[score.sensor]
        delays_ms = 1e3 * np.array(score.delays_s)
        body.append(
            [
                f"{paper.id} {paper.name}",
                METHODS[score.method],
                str(score.slips),
                f"{score.missed}",
                str(score.early),
                number(float(np.median(delays_ms)) if len(delays_ms) else None, 0),
                number(float(np.percentile(delays_ms, 95)) if len(delays_ms) else None, 0),
                interval(score.alarms, score.heard_s),
                score.verdict,
                paper.verdict if score.nuisance == "none" else NOTHING,
            ]
        )
    return {
        "caption": _caption(nuisance),
        "head": [
            *("sensor", "detector", "slips", "missed", "early", "median", "p95"),
            *("false-alarm interval", "verdict", "the paper's"),
        ],
        "rows": body,
        "left": 2,
    }


def _caption(nuisance: str) -> str:
    if nuisance != "none":
        return f"The same under a nuisance: {nuisance}. The thresholds are those of Table 1."
    good, regular = VERDICTS["good"], VERDICTS["regular"]
    return (
        f"Table 1, from our own measurements. Good: at most {good['missed']:.0%} missed and a median of "
        f"{1e3 * good['median_s']:g} ms; regular: {regular['missed']:.0%} and {1e3 * regular['median_s']:g} "
        "ms; bad: the rest; "
        "fixed before the first run. Delays in ms of the slips that were told (of two in one trial, their mean); the "
        "false-alarm interval from the alarms in all the time without slip, with its 95 % interval (Poisson)."
    )


def interval(alarms: int, heard_s: float) -> str:
    """`20 min (8 to 61)`: mean time between false alarms and its 95 % interval; how long there was none."""
    if heard_s <= 0.0:
        return NOTHING
    if alarms == 0:
        return f"none in {_minutes(heard_s)}"
    low, high = poisson_interval(alarms)
    return f"{_minutes(heard_s / alarms)} ({_minutes(heard_s / high)} to {_minutes(heard_s / low)})"


def _minutes(seconds: float) -> str:
    return f"{number(seconds, 0)} s" if seconds < 120.0 else f"{number(seconds / 60.0, 0)} min"


def _frequencies(runs: Sequence[Run]) -> Mapping[str, Any]:
    body = []
    for sensor, paper in SENSORS.items():
        rows = [
            row
            for run in runs
            if nuisance_of(run) == "none"
            for row in run.trials
            if row.get("sensor") == sensor
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
    return {
        "caption": "The paper's statistic on each sensor: frequency that dominates in slip, and the largest "
        "product of peak and "
        "frequency in slip and before it (medians over trials, in the sensor's own unit squared times Hz).",
        "head": ["sensor", "in slip, Hz", "the paper, Hz", "product in slip", "before", "pressed with, N"],
        "rows": body,
        "left": 1,
    }


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
            "until it stood, mm; samples lost of the arm's 500 Hz stream. On the emulated bench the arm's "
            "side of it is the "
            "emulated controller's behaviour, not a real controller's.",
            "head": ["bench", "stops", "p50", "p99", "max", "way, mm", "lost"],
            "rows": body,
            "left": 1,
        }
    ]


def _summary(scores: Sequence[Score]) -> list[tuple[bool | None, str]]:
    said: list[tuple[bool | None, str]] = []
    for score in scores:
        if score.nuisance != "none" or not score.slips:
            continue
        paper = SENSORS[score.sensor]
        if score.method == "paper":
            said.append(
                (
                    score.verdict == paper.verdict,
                    f"{paper.id} {paper.name}: the paper's detector comes out {score.verdict}; the paper says "
                    f"{paper.verdict}.",
                )
            )
    for sensor, paper in SENSORS.items():
        found = {
            (score.nuisance, score.method): score
            for score in scores
            if score.sensor == sensor and score.slips
        }
        for nuisance in dict.fromkeys(key[0] for key in found):
            ours, theirs = found.get((nuisance, "ours")), found.get((nuisance, "paper"))
            if nuisance != "none" and ours is not None and theirs is not None:
                said.append(
                    (
                        None,
                        f"{paper.id} under {nuisance}: ours misses {ours.missed} of {ours.slips} with "
                        f"{ours.alarms} false "
                        f"alarms in {_minutes(ours.heard_s)}, the paper's {theirs.missed} with {theirs.alarms}.",
                    )
                )
    return said


def _disagreements(scores: Sequence[Score]) -> list[str]:
    """Where a verdict is not the paper's, and why."""
    notes = []
    for score in scores:
        paper = SENSORS[score.sensor]
        if score.method != "paper" or score.nuisance != "none" or score.verdict in (paper.verdict, NOTHING):
            continue
        median_ms = 1e3 * float(np.median(score.delays_s)) if score.delays_s else float("nan")
        notes.append(
            f"{paper.id} comes out {score.verdict} where the paper says {paper.verdict}: {score.missed} of "
            f"{score.slips} slips "
            f"missed, median {number(median_ms, 0)} ms. The paper's verdict rests on one run and one look at "
            "its figure; the noise "
            "of this sensor is not printed and is assumed here."
        )
    return notes


def _not_the_papers(runs: Sequence[Run]) -> list[str]:
    return [
        "The arm's own tool force (500 Hz) is heard in the place of the JR3 wrist sensor (1 kHz).",
        "Friction, roughness, damping and the noise of all but the fingertip are assumptions; rolling is "
        "fitted to printed spectra.",
        *(
            [
                "Contact and stop on the wire rest on behaviour of the arm's controller that was never "
                "measured on a real one."
            ]
            if any(run.manifest.get("bench") == "emulated" for run in runs)
            else []
        ),
    ]


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
                    for row in run.trials
                    if row.get("sensor") == sensor and row.get("slips") and int(row["trial"] or 0) in recorded
                ),
                None,
            )
            if row is None or nuisance_of(run) != "none":
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
