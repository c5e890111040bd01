"""The contact study: `python -m benchmarks contact [--quick]`; writes results/contact.json and results/contact.md."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

from benchmarks.contact.holding import held
from benchmarks.contact.scenes import level
from benchmarks.contact.study import (
    EQUAL,
    IN_TIME_S,
    SEED_JUDGED,
    SEED_SET,
    Key,
    Told,
    batch,
    compared,
    joined,
    swept,
)
from benchmarks.results import FOLDER, save, table

CHUNK = 50

VIBRATION_M_S2 = 0.05
"""A fortieth of the oscillation, with the baseline at rest. Assumption."""

NUISANCES: Mapping[str, Mapping[str, float]] = {
    "none": {},
    "tendon friction of 50 uN m": {"tendon_friction_n_m": 5e-5},
    "ripple of 10 % at 100 Hz": {"drive_ripple": 0.1},
    "drift of the frequency by 1 % a minute": {"drift_1_s": 2.0 * 0.01 / 60.0},
    **{
        f"vibration at {hz:.0f} Hz": {"vibration_m_s2": VIBRATION_M_S2, "vibration_hz": hz}
        for hz in (5.0, 12.0, 28.0, 40.0)
    },
    "sliding probe, 0.3 times 8 mm": {"slide_m": 0.0024},
}
"""What a real finger has besides, one by one. Their sizes are assumptions."""

GROWN = (1.05, 1.1, 1.3)
"""Every noise is so many times that of the baseline from the approach's start on: no detector knows."""


class Task(NamedTuple):
    """Some approaches that one process generates and lets everybody hear."""

    scene: str
    seed: int
    first: int
    settings: Mapping[str, Any]
    more: Mapping[str, Any]


def main(quick: bool = False) -> None:
    """Run the study."""
    many, some = (100, 50) if quick else (1000, 50)
    tasks: list[Task] = []
    for name in ("printed", "hard"):
        for seed in (SEED_SET, SEED_JUDGED):
            tasks += [
                Task(name, seed, first, level(name).model_dump(), {}) for first in range(0, many, CHUNK)
            ]
    printed = level("printed").model_dump()
    for name, changed in NUISANCES.items():
        tasks += [
            Task(name, SEED_JUDGED, first, {**printed, **changed}, {}) for first in range(0, some, CHUNK)
        ]
    for factor in GROWN:
        more = {"noise": factor}
        tasks += [
            Task(f"noise times {factor}", SEED_JUDGED, first, printed, more)
            for first in range(0, some, CHUNK)
        ]
    parts: dict[tuple[str, int], list[Mapping[Key, Told]]] = {}
    # a fresh interpreter each: a fork of one that has loaded numba's threads may hang
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        for task, heard in zip(tasks, pool.map(_run, tasks), strict=True):
            parts.setdefault((task.scene, task.seed), []).append(heard)
        holds = {name: pool.submit(held, name, 2 * some) for name in ("printed", "hard")}
        found = figures({key: joined(each) for key, each in parts.items()})
        found["held"] = {name: future.result() for name, future in holds.items()}
    name = "contact_quick" if quick else "contact"
    save(name, found)
    (FOLDER / f"{name}.md").write_text(page(found), encoding="utf-8")


def _run(task: Task) -> Mapping[Key, Told]:
    return batch(task.settings, task.seed, range(task.first, task.first + CHUNK), **task.more)


def figures(told: Mapping[tuple[str, int], Mapping[Key, Told]]) -> dict[str, Any]:
    """All figures of the study but those of the hold."""
    levels = ("printed", "hard")
    scenes: Sequence[str] = [name for name, _ in told if name not in levels]
    return {
        "approaches": {
            name: [len(told[name, seed]["ours", "all"].before) for seed in (SEED_SET, SEED_JUDGED)]
            for name in levels
        },
        "levels": {name: compared(told[name, SEED_SET], told[name, SEED_JUDGED]) for name in levels},
        "curves": {name: swept(told[name, SEED_SET], told[name, SEED_JUDGED]) for name in levels},
        "nuisances": {name: compared(told["printed", SEED_SET], told[name, SEED_JUDGED]) for name in scenes},
        "each_nuisance": len(told["none", SEED_JUDGED]["ours", "all"].before),
    }


def page(found: Mapping[str, Any]) -> str:
    """The study in Markdown."""
    said = [INTRO]
    for name, title in (("printed", "As printed"), ("hard", "Hard")):
        setting, test = found["approaches"][name]
        said.append(f"## {title}\n\nThresholds from {setting} approaches, judged on {test} others.\n")
        said.append(
            table(
                (
                    "detector",
                    "best variant",
                    "false",
                    "within 70 ms",
                    "median, ms",
                    "95 %, ms",
                    "missed",
                    "force, N",
                ),
                [(each, *_row(row)) for each, row in found["levels"][name].items()],
            )
        )
    goals = [
        (
            name,
            f"{found['levels'][name]['ours']['false']:.0f} in {found['approaches'][name][1]}",
            f"{100 * found['levels'][name]['ours']['in_time']:.1f} %",
            f"{found['levels'][name]['ours']['force_max_n']:.3f} N",
            f"{100 * found['held'][name]['held']:.1f} % of {found['held'][name]['approaches']}",
        )
        for name in ("printed", "hard")
    ]
    head = ("finger", "false contacts", "within 70 ms", "largest force", "held")
    said.append(GOALS.format(rows=table(head, goals)))
    said.append(CURVES)
    for name in ("printed", "hard"):
        rows = [
            (each, *(f"{100 * row['in_time']:.1f} %; {_ms(row['median_s'])}" for row in curve))
            for each, curve in found["curves"][name].items()
        ]
        said.append(
            f"{name}:\n\n" + table(("detector", "1 in 10", "1 in 100", "1 in 1,000", "1 in 10,000"), rows)
        )
    said.append(HOLD)
    said.append(
        table(
            (
                "finger",
                "approaches",
                "false",
                "within 70 ms",
                "held",
                "longest gap, s",
                "end told",
                "after, s",
            ),
            [
                (
                    name,
                    row["approaches"],
                    row["false"],
                    f"{100 * row['in_time']:.1f} %",
                    f"{100 * row['held']:.1f} %",
                    f"{row['longest_gap_s']:.2f}",
                    f"{100 * row['end_told']:.0f} %",
                    f"{row['end_median_s']:.2f}" if row["end_told"] >= 0.5 else "more than 1",
                )
                for name, row in found["held"].items()
            ],
        )
    )
    said.append(BROKEN.format(n=found["each_nuisance"]))
    names = ("ours", "AR innovations", "Kalman on phase", "one period", "paper's criterion at its best")
    said.append(
        table(
            ("scene", *names),
            [
                (scene, *(f"{row[name]['false']:.0f}; {100 * row[name]['in_time']:.0f} %" for name in names))
                for scene, row in found["nuisances"].items()
            ],
        )
    )
    return "\n\n".join(each.strip() for each in said) + "\n"


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        row["variant"],
        f"{row['false']:.0f}",
        f"{100 * row['in_time']:.1f} %",
        _ms(row["median_s"]),
        _ms(row["p95_s"]),
        f"{row['missed']:.0f}",
        f"{row['force_max_n']:.3f}",
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}" if seconds < 10.0 else "never"


INTRO = f"""# Contact from the finger's resonance: ours, the paper's and its rivals

Made by `python -m benchmarks contact`; everything is simulated. The two fingers were chosen by what the paper
says in words, before a detector was run on them ([how](../../docs/explanation/finger_physics.md)). Approaches
are Table I's 14 rows in turn, with the gap drawn at random; every detector has the same baseline of 10 s and
the same rate of false contacts, {EQUAL:g} an approach by a fit to the tail of its own maxima, set on other
approaches than those judged. A rival's best variant is the one with most contacts within {1e3 * IN_TIME_S:.0f}
ms where thresholds are set. Missed: nothing within 0.6 s of the touch. Force: the largest mean over an
oscillation at detection, as in Table I."""

CURVES = """## Sensitivity against false contacts (A5)

The paper's future work: frequency, amplitude and phase beside one another. Share of contacts told within 70 ms,
and the median in ms, at thresholds of 1 false contact in 10 to 10,000 approaches."""

HOLD = """## Hold and end

The program's detector with default settings, events as a run has them. The probe stops 0.15 s after the touch,
stands for 1.5 s and retracts. Held: no gap longer than 0.1 s while the load cell feels more than 0.005 N. What
is heard ends 1 s after the retraction: an end that was not told by then counts as not told."""

GOALS = """## Goals

No false contact in 1,000, 95 % within 70 ms, all within 0.15 N; held without a gap of more than 0.1 s.

{rows}

A period is 36 ms: what is told before its end is told from part of one. How much sooner anyone could tell it is not
worked out here. How far the detector looks ahead and back was chosen on 200 other approaches of the hard finger."""

BROKEN = """## What is taken for granted, and what happens where it does not hold

The detector shares with the plant that one oscillation near a known frequency carries the contact, that noise
in the approach is that of the baseline, and that a contact makes the phase lead. Thresholds are those of the
finger as printed; {n} approaches each: false contacts, and share within 70 ms. Vibration is 0.05 m/s^2 and
begins with the motion. Not tried: a contact that softens the finger, and a wrong free frequency."""
