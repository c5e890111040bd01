"""Results of the centering study, and its figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.centering.scoring import CenteringScore, score
from benchmarks.centering.search import Found, Tuning
from benchmarks.centering.study import MISMATCH_DB, CenteringSize, gamma

Repeats = Sequence[Sequence[Found]]


@dataclass(frozen=True)
class CenteringStudy:
    """Results; searches of the 85 repeat by repeat."""

    size: CenteringSize
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


def numbers(study: CenteringStudy) -> dict[str, Any]:
    """For results/centering.json; the page beside it is written by hand."""

    def row_of(found: CenteringScore) -> dict[str, Any]:
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
            {"method": name, "mismatch_db": db, "speed_m_s": speed} | row_of(score(repeats))
            for (name, db, speed), repeats in study.main.items()
        ],
        "otherwise": [
            {"method": name, "speed_m_s": speed} | row_of(score(repeats))
            for (name, speed), repeats in study.aside.items()
        ],
        "fingers_scatter": [
            {"each_db": db, "speed_m_s": speed} | row_of(score(repeats))
            for db, by_speed in study.scatter.items()
            for speed, repeats in by_speed.items()
        ],
        "objects": [
            {"object": name, "method": method, "speed_m_s": speed} | row_of(score([found]))
            for (name, method, speed), found in study.by_object.items()
        ],
        "papers_choices": [
            {
                "window_s": window_s,
                "distance_m": distance_m,
                "threshold": gamma(distance_m),
                "speed_m_s": speed,
            }
            | row_of(score([found]))
            for (window_s, distance_m), by_speed in study.papers_choices.items()
            for speed, found in by_speed.items()
        ],
        "our_choices": [
            {"level_fs": level_fs, "run_up": run_up, "speed_m_s": speed} | row_of(score([found]))
            for (level_fs, run_up), by_speed in study.our_choices.items()
            for speed, found in by_speed.items()
        ],
    }
