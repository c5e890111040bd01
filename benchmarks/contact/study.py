"""The contact study: thresholds at equal false contacts, set on other approaches than those judged."""

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
"""False contacts an approach at which everybody is compared; `EQUAL` of them in the table."""

EQUAL = 1e-3
"""One false contact in 1,000 approaches, from an exponential fitted to the tail of another 1,000. Where the tail is a
normal one's, this is more than the largest of them."""

IN_TIME_S = 0.07
"""The goal: two periods."""


@dataclass
class Told:
    """What one variant said: the largest statistic before each touch, and its rising records after it."""

    before: list[float] = field(default_factory=list)
    after: list[tuple[Floats, Floats]] = field(default_factory=list)
    mean_n: list[Floats] = field(default_factory=list)


def hear(told: dict[Key, Told], heard: ApproachScene) -> None:
    """Let every variant hear an approach."""
    for name, variants in VARIANTS.items():
        for variant, detector in variants.items():
            times_s, s = detector(heard)
            mine = told.setdefault((name, variant), Told())
            free = (times_s > heard.starts_s) & (times_s < heard.touch_s)
            late = times_s >= heard.touch_s
            mine.before.append(float(s[free].max()) if free.any() else 0.0)
            highest = np.maximum.accumulate(s[late]) if late.any() else np.empty(0)
            new = np.flatnonzero(np.diff(highest, prepend=-np.inf) > 0.0)
            mine.after.append((times_s[late][new] - heard.touch_s, highest[new]))
            mine.mean_n.append(_mean_force(heard, times_s[late][new]))


def _mean_force(heard: ApproachScene, at_s: Floats) -> Floats:
    """Force over the oscillation that ends at some times, as Table I's measure has it, N."""
    sums = np.concatenate([[0.0], np.cumsum(heard.force_n)])
    period = round(1000.0 * float(np.median(heard.periods_s)))
    ends = np.searchsorted(heard.times_s, at_s, side="right")
    means: Floats = (sums[ends] - sums[ends - period]) / period
    return means


def batch(settings: Mapping[str, Any], seed: int, trials: Iterable[int], **scene: Any) -> dict[Key, Told]:
    """What everybody says of some approaches over Table I's rows."""
    told: dict[Key, Told] = {}
    finger, places = FingerSettings.model_validate(settings), rows()
    for trial in trials:
        hear(told, approach(finger, seed, trial, places[trial % len(places)], hold_s=0.0, **scene))
    return told


def joined(parts: Sequence[Mapping[Key, Told]]) -> dict[Key, Told]:
    """What was said in several batches, one after the other."""
    return {
        key: Told(
            [value for part in parts for value in part[key].before],
            [value for part in parts for value in part[key].after],
            [value for part in parts for value in part[key].mean_n],
        )
        for key in parts[0]
    }


def threshold(before: Sequence[float], rate: float) -> float:
    """Exceeded in that share of approaches: an exponential fitted to the largest twentieth, or a rank within it."""
    ordered = np.sort(before)[::-1]
    tail = max(5, len(ordered) // 20)
    base = float(ordered[tail])
    scale = float((ordered[:tail] - base).mean())
    return base + scale * float(np.log(tail / len(ordered) / rate))


def judged(told: Told, limit: float) -> dict[str, float]:
    """False contacts, delays (s) and forces (N) at a threshold."""
    delays = np.full(len(told.after), np.inf)
    forces = np.zeros(len(told.after))
    for i, (times_s, highest) in enumerate(told.after):
        place = int(np.searchsorted(highest, limit, side="right"))
        if place < len(times_s):
            delays[i], forces[i] = times_s[place], told.mean_n[i][place]
    found = np.isfinite(delays)
    return {
        "false": float(np.sum(np.asarray(told.before) > limit)),
        "missed": float(np.sum(~found)),
        "median_s": float(np.median(delays)),
        "p95_s": float(np.sort(delays)[int(np.ceil(0.95 * len(delays))) - 1]),
        "in_time": float(np.mean(delays <= IN_TIME_S)),
        "force_max_n": float(forces.max()) if found.any() else float("nan"),
        "threshold": limit,
    }


def compared(
    setting: Mapping[Key, Told], test: Mapping[Key, Told], rate: float = EQUAL
) -> dict[str, dict[str, Any]]:
    """Each detector at its best variant: the one with most contacts in time on the approaches that set thresholds."""
    found: dict[str, dict[str, Any]] = {}
    for name, variants in VARIANTS.items():
        limits = {variant: threshold(setting[name, variant].before, rate) for variant in variants}
        own = {variant: judged(setting[name, variant], limits[variant]) for variant in variants}
        _, _, best = max((own[variant]["in_time"], -own[variant]["p95_s"], variant) for variant in variants)
        found[name] = {"variant": best, **judged(test[name, best], limits[best])}
    return found


def swept(setting: Mapping[Key, Told], test: Mapping[Key, Told]) -> dict[str, list[dict[str, Any]]]:
    """A5: each detector at several rates of false contacts."""
    tables = [compared(setting, test, rate) for rate in RATES]
    return {name: [table[name] for table in tables] for name in VARIANTS}
