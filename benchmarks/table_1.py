"""Table I of Backus and Dollar: which unprinted values give it, and what they say of false contacts.

`python -m benchmarks table_1`. The paper's detector on simulated approaches of the 14 rows, over the plane of rate
behind "10 samples" and noise of the frequency, for both readings of its sigma. The point that fits is chosen on every
other row by least squares of the time alone, and judged on other seeds and all rows.
"""

from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.contact import ApproachScene, approach, rows
from benchmarks.results import in_parallel, kept, save, workers
from controller.detectors.resonance_paper import ResonancePaperDetector, ResonancePaperSettings
from controller.measures.transient import ONSET_N
from controller.reports.approaches import TABLE_1, TRIALS
from controller.reports.counts import mean_of, over_rows, wilson, within_scatter
from simulator.physics.finger import FingerSettings

Floats = NDArray[np.float64]

RULES = ("samples", "averages")
"""Of what sigma is taken: `ResonancePaperSettings.sigma_of`."""

RATES_HZ = (5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 15.0, 20.0, 28.0)
"""Frequency samples a second; at 28 nearly every period is one."""

NOISES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""Of the frequency, as a multiple of the plant's own; the load cell's stays."""

CHOSEN, JUDGED = tuple(range(101, 106)), tuple(range(1, 11))
"""Seeds: on the first the point is chosen, on the others it is judged. Each is the paper's whole table."""

CHOSEN_ROWS = tuple(range(0, 14, 2))
"""Rows that the point is chosen on."""

AVERAGED, BASELINE_S, SIGMAS = 10, 1.0, 3.0
"""As printed (III.B)."""

PRINTED_HZ = 10.0
"""Of which the printed times are multiples (`digits`)."""

WAITS_S = (0.0, 13.0)
"""From the baseline's end to the probe's start: none, as in `mock/transient`, and as in Fig. 5, where contact is 16 s
after the settling."""

RESTS_S = 17.0
"""From settling to the probe's start: fill and baseline at the lowest rate (3 s), and the longer wait."""

LISTENS_S, REACH_M = 1.4, 0.010
"""A detection later than this after the touch, or farther from the probe's start, is missed."""

COLUMNS = {"time": "delay_s", "extent": "extent_m", "force": "force_n"}


class Detection(NamedTuple):
    """One detector in one approach: false contacts after each of `WAITS_S`; the row's values, NaN for none."""

    false: bool
    false_waited: bool
    delay_s: float
    extent_m: float
    force_n: float


Key = tuple[str, float, float]
"""Rule, rate, noise."""

Found = Mapping[Key, Sequence[Sequence[Detection]]]
"""Of each point the detections by row."""


# --- one table -------------------------------------------------------------------------------


def finger(noise: float) -> FingerSettings:
    """The plant with noisier or quieter frequency, and its own load cell."""
    usual = FingerSettings()
    return FingerSettings(noise_scale=noise, load_cell_n=usual.load_cell_n / noise)


def detector(rule: str, rate_hz: float) -> ResonancePaperDetector:
    """The paper's at a point."""
    settings = {"average_samples": AVERAGED, "baseline_s": BASELINE_S, "threshold_sigma": SIGMAS}
    return ResonancePaperDetector(
        "contact", ResonancePaperSettings.model_validate({**settings, "sigma_of": rule, "sample_hz": rate_hz})
    )


def first_contact_s(scene: ApproachScene, rule: str, rate_hz: float, wait_s: float) -> float:
    """When the detector, reset so that its baseline ends `wait_s` before the probe starts, first detects contact."""
    fill_s = (AVERAGED - 1) / rate_hz
    learns_s = max(BASELINE_S, fill_s) if rule == "samples" else fill_s + BASELINE_S
    heard = scene.ends_s >= scene.starts_s - wait_s - learns_s - 1.0 / rate_hz
    times_s, found = detector(rule, rate_hz).deviations(scene.ends_s[heard], scene.periods_s[heard])
    above = np.flatnonzero(found["average"] > SIGMAS)
    return float(times_s[above[0]]) if len(above) else float("inf")


def detection(scene: ApproachScene, speed_m_s: float, rule: str, rate_hz: float) -> Detection:
    """What a row of Table I has of one approach, by the definitions of `mock/transient`."""
    t_s, later_s = (first_contact_s(scene, rule, rate_hz, wait_s) for wait_s in WAITS_S)
    false, waited = t_s < scene.touch_s, later_s < scene.touch_s
    if false or (t_s - scene.starts_s) * speed_m_s > REACH_M:
        return Detection(false, waited, *[float("nan")] * 3)
    moving = scene.times_s >= scene.starts_s
    force_n, times_s = scene.force_n[moving] - scene.force_n[~moving].mean(), scene.times_s[moving]
    delay_s = t_s - float(times_s[np.argmax(force_n >= ONSET_N)])
    period_s = scene.periods_s[np.searchsorted(scene.ends_s, t_s, side="right") - 1]
    last = (times_s > t_s - period_s) & (times_s <= t_s)
    return Detection(false, waited, delay_s, delay_s * speed_m_s, float(force_n[last].mean()))


def tables(task: tuple[float, int]) -> Found:
    """Every rule and rate on the approaches of one noise and seed."""
    noise, seed = task

    def compute() -> Found:
        found: dict[Key, list[list[Detection]]] = {
            (rule, rate_hz, noise): [[] for _ in TABLE_1] for rule in RULES for rate_hz in RATES_HZ
        }
        for place, row in enumerate(rows()):
            for trial in range(TRIALS):
                key = place * TRIALS + trial
                scene = approach(finger(noise), seed, key, row, 0.0, rests_s=RESTS_S, listens_s=LISTENS_S)
                for (rule, rate_hz, _), rows_found in found.items():
                    rows_found[place].append(detection(scene, row[1], rule, rate_hz))
        return found

    return kept(f"table_1_{sha256(repr(task).encode()).hexdigest()[:16]}", compute)


def joined(parts: Iterable[Found]) -> Found:
    """Several seeds' tables as one."""
    found: dict[Key, list[list[Detection]]] = {}
    for part in parts:
        for key, rows_found in part.items():
            mine = found.setdefault(key, [[] for _ in rows_found])
            for row, more in zip(mine, rows_found, strict=True):
                row.extend(more)
    return found


# --- agreement ---------------------------------------------------------------------------------


def means(detections: Sequence[Sequence[Detection]], column: str) -> list[Any]:
    """Of each row, over its true contacts."""
    known = ([getattr(each, column) for each in row] for row in detections)
    return [mean_of(value for value in row if not np.isnan(value)) for row in known]


def misfit_s(detections: Sequence[Sequence[Detection]]) -> float:
    """What the point is chosen by: root mean square difference of mean times from the paper's on `CHOSEN_ROWS`, s."""
    here = means(detections, "delay_s")
    return float(np.sqrt(np.mean([(here[i].mean - TABLE_1[i]["delay_s"]) ** 2 for i in CHOSEN_ROWS])))


def agreement(detections: Sequence[Sequence[Detection]]) -> dict[str, Any]:
    """Rows within scatter, ratio of the mean with its interval, and false contacts of the approaches."""
    result: dict[str, Any] = {}
    for name, column in COLUMNS.items():
        here = means(detections, column)
        known = [(mean, paper[column]) for mean, paper in zip(here, TABLE_1, strict=True) if mean.n]
        whole = over_rows((mean.mean, paper) for mean, paper in known)
        result[name] = {
            "rows": sum(bool(within_scatter(mean, paper, TRIALS)) for mean, paper in known),
            "ratio": whole.ours / whole.paper if whole else float("nan"),
            "ratio_low": 1.0 + whole.low / whole.paper if whole else float("nan"),
            "ratio_high": 1.0 + whole.high / whole.paper if whole else float("nan"),
        }
    every = [each for row in detections for each in row]
    for name in ("false", "false_waited"):
        count = sum(getattr(each, name) for each in every)
        low, high = wilson(count, len(every))
        result[name] = {
            "count": count,
            "of": len(every),
            "share": count / len(every),
            "low": low,
            "high": high,
        }
    missed = sum(bool(np.isnan(each.delay_s)) and not each.false for each in every)
    spreads = [mean.sigma for mean in means(detections, "delay_s") if mean.n > 1]
    printed = [row["delay_s.sd"] for row in TABLE_1]
    pooled = [float(np.sqrt(np.mean(np.square(each)))) for each in (spreads, printed)]
    return {**result, "missed": missed, "sigma_s": pooled[0], "sigma_s_paper": pooled[1]}


def table(detections: Sequence[Sequence[Detection]]) -> list[dict[str, Any]]:
    """Row by row beside the paper's."""
    listed = []
    for place, paper in enumerate(TABLE_1):
        line = {"location": paper["location"], "speed_m_s": paper["speed_m_s"]}
        for name, column in COLUMNS.items():
            mean = means(detections, column)[place]
            same = within_scatter(mean, paper[column], TRIALS)
            line |= {name: mean.mean, f"{name} sd": mean.sigma, f"{name} paper": paper[column]}
            line |= {f"{name} within": same, "n": mean.n}
        listed.append(line)
    return listed


# --- what the printed digits say ---------------------------------------------------------------


def on_grid(mean: float, sigma: float, step: float, half: float = 0.005) -> bool:
    """Whether three multiples of a step can have a mean and a standard deviation, both rounded to 2 `half`."""
    most = round((mean + 3.0 * sigma) / step) + 2
    return any(
        abs(np.mean(three) * step - mean) <= half + 1e-9
        and abs(np.std(three, ddof=1) * step - sigma) <= half + 1e-9
        for three in combinations_with_replacement(range(most + 1), TRIALS)
    )


def digits() -> dict[str, Any]:
    """Rows whose printed time three multiples of 1 / rate can have; and rows whose extent three times is an even
    multiple of a thousandth of an inch."""
    rates_hz = (5, 7, 8, 9, 10, 11, 12, 13, 14, 15)
    times = {
        f"{rate_hz}": sum(on_grid(row["delay_s"], row["delay_s.sd"], 1.0 / rate_hz) for row in TABLE_1)
        for rate_hz in rates_hz
    }
    step_m = 2.0 * 25.4e-6 / TRIALS
    off_m = [abs(row["extent_m"] - round(row["extent_m"] / step_m) * step_m) for row in TABLE_1]
    return {"rows_on_grid_of_rate": times, "rows_on_grid_of_extent": sum(off <= 5.01e-7 for off in off_m)}


# --- all of it ---------------------------------------------------------------------------------


def main(quick: bool = False) -> None:
    """Run the study, or the rest of it; writes results/table_1.json."""
    noises, seeds = ((1.0, 2.0), (CHOSEN[:1], JUDGED[:1])) if quick else (NOISES, (CHOSEN, JUDGED))
    tasks = [(noise, seed) for part in seeds for seed in part for noise in noises]
    with workers() as pool:
        done = dict(zip(tasks, in_parallel(tables, tasks, pool), strict=True))
    chosen, test = (joined(each for (_, seed), each in done.items() if seed in part) for part in seeds)
    save("table_1", figures(chosen, test), quick=quick)


def figures(chosen: Found, test: Found) -> dict[str, Any]:
    """All figures of the study; maps are lists of noises, each a list of rates."""
    costs = {key: misfit_s(rows_found) for key, rows_found in chosen.items()}
    noises = sorted({noise for _, _, noise in costs})

    def least(*where: object) -> Key:
        """The point of least misfit among those that have these values."""
        return min((key for key in costs if set(where) <= set(key)), key=costs.__getitem__)

    points = {f"{rule}, at the printed rate": least(rule, PRINTED_HZ) for rule in RULES}
    points |= {f"{rule}, any rate": least(rule) for rule in RULES}
    points["mock/transient"] = ("averages", 15.0, 1.0)
    held_out = [place for place in range(len(TABLE_1)) if place not in CHOSEN_ROWS]
    maps: dict[str, Any] = {}
    for rule in RULES:
        found = [[agreement(test[rule, rate_hz, noise]) for rate_hz in RATES_HZ] for noise in noises]
        own: dict[str, Any] = {
            "misfit_s": [[round(costs[rule, rate_hz, noise], 4) for rate_hz in RATES_HZ] for noise in noises]
        }
        for name in COLUMNS:
            for what in ("rows", "ratio"):
                own[f"{name}, {what}"] = [[round(each[name][what], 3) for each in line] for line in found]
        for name in ("false", "false_waited"):
            own[name] = [[round(each[name]["share"], 4) for each in line] for line in found]
        maps[rule] = own
    return {
        "digits": digits(),
        "seeds": {"chosen": CHOSEN, "judged": JUDGED, "approaches": len(JUDGED) * len(TABLE_1) * TRIALS},
        "points": {
            name: {"rate_hz": key[1], "noise": key[2], "misfit_s": costs[key], **agreement(test[key])}
            for name, key in points.items()
        },
        "held_out": {
            name: {
                c: sum(table(test[key])[place][f"{c} within"] is True for place in held_out) for c in COLUMNS
            }
            for name, key in points.items()
        },
        "tables": {name: table(test[key]) for name, key in points.items()},
        "rates_hz": RATES_HZ,
        "noises": noises,
        "maps": maps,
    }
