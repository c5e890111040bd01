"""Bound on the detection of a contact, or its end: an observer that knows the noise and this contact's effect."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks.contact.holding import FELT_N, FELT_S, MEAN_SAMPLES
from benchmarks.contact.scenes import BASELINE_S, RATE_HZ, ApproachScene, approach, level, rows

Floats = NDArray[np.float64]

SEED = 14

HELD = 8
"""Samples that are averaged, 8 ms: the plant holds its noise so long, and below that there is none to be whitened."""

ORDER = 30
"""Of the autoregressive model of the free waveform: 0.24 s."""

STEPS = 38
"""Steps evaluated after the touch: 0.3 s."""

KNOWN, UNKNOWN = (float(norm.isf(rate)) for rate in (1e-3, 1e-3 * 0.008 / 0.7))
"""Thresholds for one false contact in 1,000 approaches: for a known instant, and for a look every 8 ms of 0.7 s."""


APART = 2.0 * KNOWN
"""Deflection for one error of either kind in 1,000."""

INSTANTS_S = (0.2, 0.5, 0.8, 1.1)
"""After the probe has come to stand: the last time before each at which the load cell felt the finger."""

AWAY_M_S = 1.0


def separations(name: str, count: int, first: int = 0) -> Floats:
    """Deflection of the matched filter after each 8 ms, in standard deviations, shape (count, STEPS).

    The same approach is simulated with and without the probe, in the same noise: the difference is the
    contact's effect. Whitened by the model learned from the free finger's baseline, and divided by its deviation, its
    norm is the distance of the two hypotheses for an observer that knows it (Neyman and Pearson); in Gaussian noise no
    test does better.
    """
    found = np.zeros((count, STEPS))
    for i in range(count):
        there, free = (
            approach(level(name), SEED, first + i, rows()[(first + i) % 14], hold_s=0.0, touching=touching)
            for touching in (True, False)
        )
        found[i] = _apart(there, free, there.touch_s, STEPS)
    return found


def _apart(there: ApproachScene, free: ApproachScene, since_s: float, steps: int) -> Floats:
    """Deflection between two waveforms in the same noise after each 8 ms from a time on, shape (steps,)."""
    x = free.accelerometer[: round(BASELINE_S * RATE_HZ)].reshape(-1, HELD).mean(axis=1)
    x = x - x.mean()
    past = np.column_stack([x[ORDER - lag - 1 : -lag - 1] for lag in range(ORDER)])
    weights = np.linalg.lstsq(past, x[ORDER:], rcond=None)[0]
    sigma = float((x[ORDER:] - past @ weights).std())
    begins = int(np.searchsorted(there.times_s, since_s))
    span = slice(begins, begins + steps * HELD)
    added = (there.accelerometer[span] - free.accelerometer[span]).reshape(-1, HELD).mean(axis=1)
    white = np.convolve(added, np.concatenate([[1.0], -weights]))[:steps]
    return np.asarray(np.sqrt(np.cumsum(white**2)) / sigma)


def waits(name: str, count: int, first: int = 0) -> Floats:
    """Time until it can be known whether the probe is still there, s, shape (count, instants).

    The same approach is simulated with a probe that stands and with one that is gone, within 4 ms, from an instant on
    at which the load cell felt the finger. An earlier decision errs, in one or the other way, more often than once in
    1,000 times; infinity beyond 0.6 s.
    """
    steps = round(0.6 * RATE_HZ / HELD)
    found = np.full((count, len(INSTANTS_S)), np.inf)
    for i in range(count):
        key = (level(name), SEED, first + i, rows()[(first + i) % 14])
        there = approach(*key, hold_s=INSTANTS_S[-1] + 0.8)
        force_n = np.convolve(there.force_n, np.full(MEAN_SAMPLES, 1.0 / MEAN_SAMPLES))[: len(there.force_n)]
        felt_s = there.times_s[force_n > FELT_N]
        for place, after_s in enumerate(INSTANTS_S):
            since_s = float(felt_s[felt_s <= there.stops_s + after_s][-1])
            gone = approach(*key, hold_s=max(since_s - there.stops_s, 0.001), away_m_s=AWAY_M_S)
            known = _apart(there, gone, since_s, steps) >= APART
            if known.any():
                found[i, place] = HELD / RATE_HZ * (1 + int(np.argmax(known)))
    return found


def bound(found: Floats) -> dict[str, dict[str, float]]:
    """Share detected within 36 and 70 ms, and when half and 95 % are (s; infinity beyond 0.3 s)."""
    result = {}
    for name, limit in (("known", KNOWN), ("unknown", UNKNOWN)):
        shares = norm.cdf(found - limit).mean(axis=0)
        after = [float(HELD / RATE_HZ * (1 + int(np.argmax(shares >= q)))) for q in (0.5, 0.95)]
        result[name] = {
            "within_36_ms": float(shares[3]),
            "within_70_ms": float(shares[7]),
            "half_s": after[0] if shares[-1] >= 0.5 else float("inf"),
            "p95_s": after[1] if shares[-1] >= 0.95 else float("inf"),
        }
    return result


def waited(found: Floats) -> dict[str, float]:
    """Summary of `waits`, s."""
    return {
        "median_s": float(np.median(found)),
        "p95_s": float(np.quantile(found, 0.95, method="higher")),
        "longest_s": float(found.max()),
        "within_gap": float(np.mean(found <= FELT_S)),
    }
