"""The part of the page on C3: how well the middle is found, beside the paper's Fig. 8c."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from behaviors.centering_settings import CenteringFactors
from controller.recording.reader import Run
from controller.reports.counts import factor as beside_bound
from controller.reports.counts import total, values
from controller.reports.figures import FALSE, INK, OURS, PAPER, Figures
from controller.reports.section import Kind, Result, Section
from controller.reports.sonicfinger import (
    ASSUMED,
    CITATION,
    METHOD_NAMES,
    WANTED_CENTERING_M,
    WORST_CENTERING_M,
    printed_of,
    rows_of,
)
from controller.reports.text import number, share, title

Key = tuple[str, str, float]


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Errors by method, object and speed; the histogram."""
    groups = _groups(rows_of(runs))
    return Section(
        title="Centering without touching (C3)",
        template="plain.html.j2",
        citation=CITATION,
        summary=_summary(groups, runs[0].simulated),
        not_the_papers=[
            *(ASSUMED if runs[0].simulated else ()),
            "Only the finger ahead of the motion is heeded: the other one, from which the object moves away, "
            "would spoil "
            "the average that the paper takes.",
        ],
        printed=printed_of(runs[0]),
        context={
            "paragraphs": [
                "The arm moves until the finger ahead sees the object, then the other way until the other "
                "finger does, and goes "
                "to the middle of the two places. The error is where it came to stand less where the object is."
            ],
            "tables": [
                {
                    "caption": "Errors of the middle, mm; positive is too far forward. “Worst” is the largest "
                    "of either sign.",
                    "head": [
                        *("object", "method", "speed, m/s", "trials", "no middle"),
                        *("worst", "mean", "sigma", "median |error|"),
                    ],
                    "rows": [_errors_row(key, rows) for key, rows in groups.items()],
                    "left": 2,
                },
                {
                    "caption": "Search and grasp: how long the search took (median); how often something was touched "
                    "during it, which simulation alone knows; in how many of the grasps both fingers said contact.",
                    "head": [
                        "object",
                        "method",
                        "speed, m/s",
                        "search, s",
                        "touched before",
                        "contact by both",
                    ],
                    "rows": [_grasps_row(key, rows) for key, rows in groups.items()],
                    "left": 2,
                },
                *_stops(runs),
            ],
            "figures": [
                {
                    "svg": _draw(groups, figures),
                    "caption": "Fig. 8c. Errors of centering; the dashed lines are the paper's worst, "
                    f"{number(WORST_CENTERING_M, 0, 1e3)} mm.",
                }
            ]
            if any(values(rows, "error_m") for rows in groups.values())
            else [],
            "notes": [],
        },
    )


def factor(row: Mapping[str, Any], name: str) -> Any:
    """A trial's factor; the behavior's default where the trial does not vary it."""
    value = row.get(name)
    return CenteringFactors.model_fields[name].default if value is None else value


def _groups(rows: Sequence[Any]) -> Mapping[Key, Sequence[Any]]:
    groups: dict[Key, list[Any]] = {}
    for row in rows:
        key = (
            str(factor(row, "object")),
            str(factor(row, "method")),
            float(factor(row, "speed_m_s")),
        )
        groups.setdefault(key, []).append(row)
    return dict(sorted(groups.items()))


def _summary(groups: Mapping[Key, Sequence[Any]], simulated: bool) -> list[Result]:
    """Each method's worst error; of ours also beside the paper's way on the same bench."""
    worst_m = {key: max(map(abs, values(rows, "error_m")), default=None) for key, rows in groups.items()}
    said = []
    for key, rows in groups.items():
        thing, method, speed_m_s = key
        what = f"{title(thing).capitalize()}, {METHOD_NAMES[method]}, {speed_m_s:g} m/s"
        kind = Kind.PREDICTED if simulated else Kind.MEASURED
        own_m, found = worst_m[key], len(values(rows, "error_m"))
        if own_m is None:
            said.append(Result(kind, f"{what}: never centred.", False))
            continue
        lost = f"; {len(rows) - found} of {len(rows)} found no middle" if found < len(rows) else ""
        trials = f"worst error {number(own_m, 2, 1e3)} mm in {found} {'trial' if found == 1 else 'trials'}"
        rival_m = worst_m.get((thing, "paper", speed_m_s)) if method == "ours" else None
        bound_m = WANTED_CENTERING_M if method == "ours" else WORST_CENTERING_M
        whose = f"{number(bound_m, 1, 1e3)} mm {'aimed at' if method == 'ours' else 'that the paper has'}"
        beside = f"{beside_bound(own_m, bound_m)} the {whose}"
        if rival_m:
            beside = f"{rival_m / own_m:.1f} times smaller than the paper's way on this bench, {beside}"
        # that the paper's way stays below the paper's own worst says nothing of ours, and little of the bench
        good = own_m <= bound_m and not lost
        said.append(
            Result(kind, f"{what}: {beside}: {trials}{lost}.", good if method == "ours" or not good else None)
        )
    return said


def _names(key: Key) -> list[str]:
    thing, method, speed_m_s = key
    return [title(thing), METHOD_NAMES[method], f"{speed_m_s:g}"]


def _errors_row(key: Key, rows: Sequence[Any]) -> list[str]:
    errors_m = np.array(values(rows, "error_m"))
    figures = (
        [
            number(float(np.abs(errors_m).max()), 2, 1e3),
            number(float(errors_m.mean()), 2, 1e3),
            number(float(errors_m.std(ddof=1)) if len(errors_m) > 1 else float("nan"), 2, 1e3),
            number(float(np.median(np.abs(errors_m))), 2, 1e3),
        ]
        if len(errors_m)
        else ["–"] * 4
    )
    return [*_names(key), str(len(rows)), str(len(rows) - len(errors_m)), *figures]


def _grasps_row(key: Key, rows: Sequence[Any]) -> list[str]:
    search_s = values(rows, "search_s")
    touched = [row for row in rows if row.get("touched") is not None]
    grasped = [row for row in rows if row.get("gripped") is not None]
    both = sum(
        row.get("contact_left_s") is not None and row.get("contact_right_s") is not None for row in grasped
    )
    return [
        *_names(key),
        number(float(np.median(search_s)) if search_s else None, 1),
        str(total(touched, "touched")) if touched else "unknown",
        share(both, len(grasped)) if grasped else "not asked for",
    ]


def _stops(runs: Sequence[Run]) -> list[Mapping[str, Any]]:
    """From the sample with which a finger saw the object to the arm being told to stop, by bench and method."""
    body = []
    for bench in sorted({str(run.manifest.get("bench")) for run in runs}):
        there = [run for run in runs if run.manifest.get("bench") == bench]
        rows = rows_of(there)
        lost = sum(int((run.manifest.get("loss") or {}).get("audio.fingers", 0)) for run in there)
        for method in sorted({str(factor(row, "method")) for row in rows}):
            own = [row for row in rows if str(factor(row, "method")) == method]
            latencies_ms = 1e3 * np.array(
                [*values(own, "seen_to_stop_left_s"), *values(own, "seen_to_stop_right_s")]
            )
            if len(latencies_ms):
                spread = [number(float(np.percentile(latencies_ms, share)), 1) for share in (50, 99, 100)]
                body.append([bench, METHOD_NAMES[method], str(len(latencies_ms)), *spread, str(lost)])
    if not body:
        return []
    return [
        {
            "caption": "Seen, arm told to stop: from the time of the deciding sample of the envelope to the "
            "command's last byte, ms. Where there is sound, the chain's own delay, 3 ms, is in it; on the mock bench "
            "there is nothing but the wait for the loop's next turn, and on the emulated one the far side of the wire "
            "is an emulator's. Audio frames lost in all trials.",
            "head": ["bench", "method", "stops", "p50", "p99", "max", "frames lost"],
            "rows": body,
            "left": 2,
        }
    ]


def _draw(groups: Mapping[Key, Sequence[Any]], figures: Figures) -> Markup:
    """One histogram for each method and speed, all objects together."""
    cells: dict[tuple[str, float], list[float]] = {}
    for (_, method, speed_m_s), rows in groups.items():
        cells.setdefault((method, speed_m_s), []).extend(values(rows, "error_m"))
    cells = {key: errors for key, errors in sorted(cells.items()) if errors}
    reach_mm = max(9.0, 1e3 * max(abs(error) for errors in cells.values() for error in errors) + 1.0)
    edges: list[float] = np.arange(-np.ceil(reach_mm), np.ceil(reach_mm) + 0.5, 0.5).tolist()
    columns = 2 if len(cells) > 1 else 1
    rows_count = -(-len(cells) // columns)
    with figures.figure(
        1.7 * rows_count + 0.5, rows=rows_count, columns=columns, sharex=True, sharey=True
    ) as drawing:
        for axes, ((method, speed_m_s), errors) in zip(drawing.axes, cells.items(), strict=False):
            color = OURS if method == "ours" else PAPER
            axes.hist(np.array(errors) * 1e3, bins=edges, color=color, edgecolor="white", lw=0.3)
            for place in (-1e3 * WORST_CENTERING_M, 1e3 * WORST_CENTERING_M):
                axes.axvline(place, color=FALSE, lw=0.8, ls=(0, (4, 2)))
            axes.axvline(0.0, color=INK, lw=0.5)
            axes.set_title(f"{METHOD_NAMES[method]}, {speed_m_s:g} m/s, n = {len(errors)}")
        for axes in drawing.axes[len(cells) :]:
            axes.set_visible(False)
        for axes in drawing.axes[-columns:]:
            axes.set_xlabel("error (mm)")
        for axes in drawing.axes[::columns]:
            axes.set_ylabel("trials")
            axes.locator_params(axis="y", integer=True)
        return Markup(drawing.save("fig_8c_centering"))
