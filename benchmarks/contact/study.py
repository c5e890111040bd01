"""The contact study: thresholds at equal false contacts, set on separate approaches."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.contact.rivals import VARIANTS
from benchmarks.contact.scenes import ApproachScene, approach, rows
from drivers.mock.physics.finger import FingerSettings

Floats = NDArray[np.float64]

Key = tuple[str, str]
"""Detector and variant."""

SEED_SET, SEED_JUDGED = 11, 12
"""Of approaches that set thresholds, and of those judged."""

RATES = (1e-1, 1e-2, 1e-3, 1e-4)
"""False contacts an approach at which all are compared; `EQUAL` of them in the table."""

EQUAL = 1e-3
"""One false contact in 1,000 approaches, from an exponential fitted to the tail of another 1,000. For a normal
tail this exceeds the largest of them."""

IN_TIME_S = 0.07
"""The goal: two periods."""


@dataclass
class Record:
    """Results of one variant: the largest statistic before each touch, and its rising maxima after it."""

    before: list[float] = field(default_factory=list)
    after: list[tuple[Floats, Floats]] = field(default_factory=list)
    mean_n: list[Floats] = field(default_factory=list)


def add(records: dict[Key, Record], scene: ApproachScene) -> None:
    """Apply every variant to an approach."""
    for name, variants in VARIANTS.items():
        for variant, detector in variants.items():
            times_s, s = detector(scene)
            mine = records.setdefault((name, variant), Record())
            free = (times_s > scene.starts_s) & (times_s < scene.touch_s)
            late = times_s >= scene.touch_s
            mine.before.append(float(s[free].max()) if free.any() else 0.0)
            highest = np.maximum.accumulate(s[late]) if late.any() else np.empty(0)
            new = np.flatnonzero(np.diff(highest, prepend=-np.inf) > 0.0)
            mine.after.append((times_s[late][new] - scene.touch_s, highest[new]))
            mine.mean_n.append(_mean_force(scene, times_s[late][new]))


def _mean_force(scene: ApproachScene, at_s: Floats) -> Floats:
    """Force over the oscillation that ends at some times, as Table I's measure has it, N."""
    sums = np.concatenate([[0.0], np.cumsum(scene.force_n)])
    period = round(1000.0 * float(np.median(scene.periods_s)))
    ends = np.searchsorted(scene.times_s, at_s, side="right")
    means: Floats = (sums[ends] - sums[ends - period]) / period
    return means


def batch(settings: Mapping[str, Any], seed: int, trials: Iterable[int], **scene: Any) -> dict[Key, Record]:
    """Results of all variants on some approaches over Table I's rows."""
    records: dict[Key, Record] = {}
    finger, places = FingerSettings.model_validate(settings), rows()
    for trial in trials:
        add(records, approach(finger, seed, trial, places[trial % len(places)], hold_s=0.0, **scene))
    return records


def joined(parts: Sequence[Mapping[Key, Record]]) -> dict[Key, Record]:
    """Results of several batches joined."""
    return {
        key: Record(
            [value for part in parts for value in part[key].before],
            [value for part in parts for value in part[key].after],
            [value for part in parts for value in part[key].mean_n],
        )
        for key in parts[0]
    }


def threshold(before: Sequence[float], rate: float) -> float:
    """Threshold exceeded in a share `rate` of approaches: exponential fitted to the largest twentieth."""
    ordered = np.sort(before)[::-1]
    tail = max(5, len(ordered) // 20)
    base = float(ordered[tail])
    scale = float((ordered[:tail] - base).mean())
    return base + scale * float(np.log(tail / len(ordered) / rate))


def judged(record: Record, limit: float) -> dict[str, float]:
    """False contacts, delays (s) and forces (N) at a threshold."""
    delays = np.full(len(record.after), np.inf)
    forces = np.zeros(len(record.after))
    for i, (times_s, highest) in enumerate(record.after):
        place = int(np.searchsorted(highest, limit, side="right"))
        if place < len(times_s):
            delays[i], forces[i] = times_s[place], record.mean_n[i][place]
    found = np.isfinite(delays)
    return {
        "false": float(np.sum(np.asarray(record.before) > limit)),
        "missed": float(np.sum(~found)),
        "median_s": float(np.median(delays)),
        "p95_s": float(np.sort(delays)[int(np.ceil(0.95 * len(delays))) - 1]),
        "in_time": float(np.mean(delays <= IN_TIME_S)),
        "force_max_n": float(forces.max()) if found.any() else float("nan"),
        "threshold": limit,
    }


def compared(
    setting: Mapping[Key, Record], test: Mapping[Key, Record], rate: float = EQUAL
) -> dict[str, dict[str, Any]]:
    """Each detector at its best variant: the one with most contacts in time on the approaches that set thresholds."""
    found: dict[str, dict[str, Any]] = {}
    for name, variants in VARIANTS.items():
        limits = {variant: threshold(setting[name, variant].before, rate) for variant in variants}
        own = {variant: judged(setting[name, variant], limits[variant]) for variant in variants}
        _, _, best = max((own[variant]["in_time"], -own[variant]["p95_s"], variant) for variant in variants)
        found[name] = {"variant": best, **judged(test[name, best], limits[best])}
    return found


def swept(setting: Mapping[Key, Record], test: Mapping[Key, Record]) -> dict[str, list[dict[str, Any]]]:
    """A5: each detector at several rates of false contacts."""
    tables = [compared(setting, test, rate) for rate in RATES]
    return {name: [table[name] for table in tables] for name in VARIANTS}
