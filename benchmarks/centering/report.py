"""The study as a page and as numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.centering.scoring import Score, score
from benchmarks.centering.search import Found, Tuning
from benchmarks.centering.study import (
    LEAST_GAP_M,
    MISMATCH_DB,
    SPEEDS_M_S,
    Size,
    gamma,
    object_reach_m,
)
from benchmarks.results import table
from drivers.mock.physics.aura_objects import SIX

Repeats = Sequence[Sequence[Found]]


@dataclass(frozen=True)
class Study:
    """All that was found; searches of the 85 repeat by repeat."""

    size: Size
    tunings: Mapping[str, Tuning]
    object_tunings: Mapping[str, Tuning]
    gains: tuple[float, float]
    gains_alike: tuple[float, float]
    main: Mapping[tuple[str, float, float], Repeats]
    aside: Mapping[tuple[str, float], Repeats]
    scatter: Mapping[float, Mapping[float, Repeats]]
    by_object: Mapping[tuple[str, str, float], Sequence[Found]]
    papers_choices: Mapping[tuple[float, float], Mapping[float, Sequence[Found]]]
    our_choices: Mapping[tuple[float, bool], Mapping[float, Sequence[Found]]]
    wall_s: float = math.nan


def numbers(study: Study) -> dict[str, Any]:
    """The page's figures, for machines."""

    def told(found: Score) -> dict[str, Any]:
        return {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in found._asdict().items()
        } | {"centred": found.centred}

    return {
        "simulated": True,
        "size": asdict(study.size),
        "wall_s": round(study.wall_s, 1),
        "detectors": {name: asdict(tuning) for name, tuning in study.tunings.items()},
        "detectors_objects": {name: asdict(tuning) for name, tuning in study.object_tunings.items()},
        "gains_right_left": {"0 dB": study.gains_alike, f"{MISMATCH_DB:g} dB": study.gains},
        "eighty_five": [
            {"method": name, "mismatch_db": db, "speed_m_s": speed} | told(score(repeats))
            for (name, db, speed), repeats in study.main.items()
        ],
        "otherwise": [
            {"method": name, "speed_m_s": speed} | told(score(repeats))
            for (name, speed), repeats in study.aside.items()
        ],
        "fingers_scatter": [
            {"each_db": db, "speed_m_s": speed} | told(score(repeats))
            for db, by_speed in study.scatter.items()
            for speed, repeats in by_speed.items()
        ],
        "objects": [
            {"object": name, "method": method, "speed_m_s": speed} | told(score([found]))
            for (name, method, speed), found in study.by_object.items()
        ],
        "papers_choices": [
            {
                "window_s": window_s,
                "distance_m": distance_m,
                "threshold": gamma(distance_m),
                "speed_m_s": speed,
            }
            | told(score([found]))
            for (window_s, distance_m), by_speed in study.papers_choices.items()
            for speed, found in by_speed.items()
        ],
        "our_choices": [
            {"level_fs": level_fs, "run_up": run_up, "speed_m_s": speed} | told(score([found]))
            for (level_fs, run_up), by_speed in study.our_choices.items()
            for speed, found in by_speed.items()
        ],
    }


HEAD = ("m/s", "worst, mm", "largest of all", "mean", "sd", "median size", "skewness")
COUNTS = ("seen at, mm", "touched", "false contact", "not seen", "s")


def document(study: Study) -> str:
    """The page."""
    parts = [_opening(study), _main(study), _asides(study), _scatter(study), _objects(study), _choices(study)]
    return "\n\n".join(parts) + "\n"


def _mm(value_m: float) -> str:
    return "-" if math.isnan(value_m) else f"{1e3 * value_m:.2f}"


def _row(found: Score) -> list[str]:
    """From the worst error to the time."""
    between = ""
    if not math.isnan(found.worst_lo_m):
        between = f" ({_mm(found.worst_lo_m)} to {_mm(found.worst_hi_m)})"
    share = 100.0 / found.searches
    return [
        _mm(found.worst_m) + between,
        _mm(found.largest_m),
        _mm(found.mean_m),
        _mm(found.sd_m),
        _mm(found.median_m),
        "-" if math.isnan(found.skewness) else f"{found.skewness:+.1f}",
        _mm(found.seen_m),
        f"{share * found.touched:.1f} %",
        f"{share * found.stopped:.1f} %",
        f"{share * found.unseen:.1f} %",
        "-" if math.isnan(found.search_s) else f"{found.search_s:.1f}",
    ]


def _opening(study: Study) -> str:
    return f"""# Centering without touching (C3)

All of it is simulated: the mock bench's own plant, arm and detectors in a closed loop, without drivers and recorder
(`benchmarks/centering`; a test holds it against the loop itself). {study.size.repeats} repeats of 85 searches for
the pipe: 29 begin near
the right finger, 27 near the middle, 29 near the left one, each repeat at places of its own. An error is where the
middle was found
against where the object stands. `worst` is the mean over the repeats of the largest error of 85, with its 95 %
interval (Student's t).

A search that touched the object is counted and its error left out: a finger pushes the pipe along, and the middle
of two touches is the
middle of itself. So read `worst` beside `touched`. `false contact` is a search that the contact detectors ended
although nothing was
touched. The study took {study.wall_s:.0f} s on a machine that others were using too."""


def _main(study: Study) -> str:
    rows = [
        [name, f"{mismatch_db:g}", f"{speed_m_s:g}", *_row(score(repeats))]
        for (name, mismatch_db, speed_m_s), repeats in study.main.items()
    ]
    paper, ours = study.tunings["paper"], study.tunings["ours"]
    right, left = study.gains
    return f"""## The 85

{table(("", "fingers apart, dB", *HEAD, *COUNTS), rows)}

The paper's own bench: worst 8 mm, skewed to the negative side, no speed given (Fig. 8c, IV.A.2). A prototype
simulation of other
assumptions had 4 to 6 mm at 0.01 m/s and 10 to 23 at 0.03 for the paper's algorithm, 1.8 to 3.2 for level crossings.

The paper's detector: alpha {paper.finder["window_s"]:g} s, gamma {paper.finder["threshold"]:g} (neither is printed;
see Choices). Ours: the matched filter's
amplitude crosses {ours.finder["level_fs"]:g} full scales, with a run-up. Calibrated gains: {right:.4f} right,
{left:.4f} left, measured at 8 mm from the pipe in the middle.

![Histograms of the error](../figures/centering.png)

Why ours does so well here: the two fingers of this plant differ by `mismatch_db` and by their noise alone. Whatever
else changes from trial
to trial (reflectivity 1 dB, phase 0.5 rad) changes both alike, and falls out of a middle. Real fingers do not
oblige; "Fingers that change"
says what it costs."""


def _asides(study: Study) -> str:
    rows = [
        [name, f"{speed_m_s:g}", *_row(score(repeats))] for (name, speed_m_s), repeats in study.aside.items()
    ]
    return f"""## Otherwise

{study.size.aside} repeats, fingers alike.

{table(("", *HEAD, *COUNTS), rows)}

Without the run-up the left finger's way may be as short as the 5 mm that the detector needs, the right one's never
is, and the memory of the
fit (8 mm) makes the amplitude depend on that: the error has a mean. The run-up costs the time of one more way."""


def _scatter(study: Study) -> str:
    rows = [
        [f"{db:g}", f"{speed_m_s:g}", *_row(score(repeats))]
        for db, by_speed in study.scatter.items()
        for speed_m_s, repeats in by_speed.items()
    ]
    return f"""## Fingers that change from search to search

Ours, {study.size.aside} repeats; each finger's sensitivity is drawn anew for each search, with this standard
deviation. No calibration helps against it.

{table(("each finger, dB", *HEAD, *COUNTS), rows)}"""


def _objects(study: Study) -> str:
    rows = [
        [name.replace("_", " "), method, f"{speed_m_s:g}", *_row(score([found]))]
        for (name, method, speed_m_s), found in study.by_object.items()
    ]
    reach = ", ".join(f"{name.replace('_', ' ')} {1e3 * object_reach_m(name):g}" for name in SIX)
    ours, paper = study.object_tunings["ours"].finder, study.object_tunings["paper"].finder
    return f"""## The six objects

{study.size.objects} searches each; the worst of all of them. They begin anywhere up to so many mm from the middle:
{reach}; none nearer than
{1e3 * LEAST_GAP_M:g} mm to a finger. One amplitude for all six ({ours["level_fs"]:g} full scales), one gamma
({paper["threshold"]:g}).

{table(("object", "", *HEAD, *COUNTS), rows)}"""


def _choices(study: Study) -> str:
    papers = [
        [f"{window_s:g}", f"{1e3 * distance_m:g}", f"{gamma(distance_m):.2g}", *_brief(by_speed)]
        for (window_s, distance_m), by_speed in study.papers_choices.items()
    ]
    ours = [
        [f"{level_fs:g}", "yes" if run_up else "no", *_brief(by_speed)]
        for (level_fs, run_up), by_speed in study.our_choices.items()
    ]
    head = [f"{what}, {speed_m_s:g} m/s" for speed_m_s in SPEEDS_M_S for what in ("worst", "lost")]
    return f"""## Choices

Fingers alike, some 40 searches of their own a cell; worst error in mm of those that touched nothing, and share of
those that touched, saw nothing or were
ended.

The paper's alpha and gamma. Gamma belongs to a distance: it is half the square of the amplitude that the pipe sends
back from there. What
is in a window is less than that, for the wave's mean goes away with the window's.

{table(("alpha, s", "gamma's distance, mm", "gamma", *head), papers)}

Our amplitude. At 0 the detector speaks when it is sure that something is there, from wherever that is: good for a
warning, useless for a middle.

{table(("full scales", "run-up", *head), ours)}"""


def _brief(by_speed: Mapping[float, Sequence[Found]]) -> list[str]:
    cells = []
    for speed_m_s in SPEEDS_M_S:
        found = score([by_speed[speed_m_s]])
        cells += [_mm(found.worst_m), f"{100.0 - 100.0 * found.centred / found.searches:.0f} %"]
    return cells
