"""The centering study (C3): `python -m benchmarks centering [--quick]`."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

from benchmarks.centering.numbers import CenteringStudy, numbers
from benchmarks.centering.search import Found
from benchmarks.centering.study import (
    FULL,
    MISMATCH_DB,
    QUICK,
    SCATTERS_DB,
    SEED_SCATTER,
    SEED_TEST,
    SPEEDS_M_S,
    CenteringSize,
    Method,
    eighty_five,
    gains_of,
    gamma,
    made,
    methods,
    our_choices,
    papers_choices,
    with_object,
)
from benchmarks.results import progress, save, workers
from config.assemble import Table
from config.profile import load_profile
from drivers.mock.physics.aura_objects import SIX

WAVES = ((0.125, 0.0125), (0.5, 0.015))
"""The paper's alpha (s) and distance of gamma (m) tried beside the profile's."""


def main(quick: bool = False) -> None:
    """Run the study, print the worst of the 85; writes results/centering.json."""
    started_s, size = time.perf_counter(), QUICK if quick else FULL
    with workers() as pool:
        study = _study(size, pool)
    study = replace(study, wall_s=time.perf_counter() - started_s)
    save("centering", numbers(study), quick=quick)


def _study(size: CenteringSize, pool: ProcessPoolExecutor) -> CenteringStudy:
    pipe = methods(load_profile("mock/centering", {}, table=Table()))
    objects = methods(load_profile("mock/centering_objects", {}, table=Table()))
    gains = gains_of(MISMATCH_DB, pipe["ours"])
    alike = gains_of(0.0, pipe["ours"])
    main_rows = _main(pipe, gains, size, pool)
    progress("the 85")
    aside = _aside(pipe, size, pool)
    scatter = {
        db: _eighty_fives(pipe["ours"], size.aside, pool, seed=SEED_SCATTER, finger_db=db)
        for db in SCATTERS_DB
    }
    progress("the 85 otherwise")
    by_object = {
        (name, method, speed_m_s): made(
            [(place, objects[method]) for place in with_object(name, size.objects, speed_m_s)], pool
        )
        for name in SIX
        for method in ("paper", "ours")
        for speed_m_s in SPEEDS_M_S
    }
    progress("the six objects")
    return CenteringStudy(
        size=size,
        tunings={name: method.tuning for name, method in pipe.items()},
        object_tunings={name: method.tuning for name, method in objects.items()},
        gains=gains,
        gains_alike=alike,
        main=main_rows,
        aside=aside,
        scatter=scatter,
        by_object=by_object,
        papers_choices=papers_choices(pipe["paper"], size, pool),
        our_choices=our_choices(pipe["ours"], size, pool),
    )


def _main(
    pipe: dict[str, Method], gains: tuple[float, float], size: CenteringSize, pool: ProcessPoolExecutor
) -> dict[tuple[str, float, float], list[list[Found]]]:
    """By method, mismatch and speed: repeat by repeat."""
    ours = pipe["ours"]
    calibrated = ours._replace(tuning=replace(ours.tuning, gains=gains))
    rows = [
        ("paper", pipe["paper"], 0.0),
        ("ours", ours, 0.0),
        ("paper", pipe["paper"], MISMATCH_DB),
        ("ours", ours, MISMATCH_DB),
        ("ours, gains calibrated", calibrated, MISMATCH_DB),
    ]
    found: dict[tuple[str, float, float], list[list[Found]]] = {}
    for name, method, mismatch_db in rows:
        by_speed = _eighty_fives(method, size.repeats, pool, mismatch_db=mismatch_db)
        found |= {(name, mismatch_db, speed_m_s): repeats for speed_m_s, repeats in by_speed.items()}
        progress(f"{name}, {mismatch_db:g} dB")
    return found


def _aside(
    pipe: dict[str, Method], size: CenteringSize, pool: ProcessPoolExecutor
) -> dict[tuple[str, float], list[list[Found]]]:
    """Other methods, fingers alike."""
    paper, ours = pipe["paper"], pipe["ours"]
    rows = {
        f"paper, alpha {window_s:g} s": paper._replace(
            tuning=replace(
                paper.tuning,
                finder=dict(paper.tuning.finder) | {"window_s": window_s, "threshold": gamma(distance_m)},
            )
        )
        for window_s, distance_m in WAVES
    }
    rows["ours, no run-up"] = ours._replace(course=replace(ours.course, run_up=False))
    found: dict[tuple[str, float], list[list[Found]]] = {}
    for name, method in rows.items():
        by_speed = _eighty_fives(method, size.aside, pool)
        found |= {(name, speed_m_s): repeats for speed_m_s, repeats in by_speed.items()}
    return found


def _eighty_fives(
    method: Method,
    repeats: int,
    pool: ProcessPoolExecutor,
    *,
    mismatch_db: float = 0.0,
    seed: int = SEED_TEST,
    finger_db: float = 0.0,
) -> dict[float, list[list[Found]]]:
    found = {}
    for speed_m_s in SPEEDS_M_S:
        places = [
            place for repeat in range(repeats) for place in eighty_five(seed, repeat, speed_m_s, mismatch_db)
        ]
        places = [place._replace(finger_db=finger_db) for place in places]
        outcomes = made([(place, method) for place in places], pool)
        found[speed_m_s] = [outcomes[first : first + 85] for first in range(0, len(outcomes), 85)]
    return found
