"""How soon anyone could tell a contact: an observer that knows the noise and what this very contact adds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks.contact.scenes import BASELINE_S, RATE_HZ, approach, level, rows

Floats = NDArray[np.float64]

SEED = 14

HELD = 8
"""Samples that are averaged, 8 ms: the plant holds its noise so long, and below that there is none to be whitened."""

ORDER = 30
"""Of the autoregressive model of the free waveform: 0.24 s."""

STEPS = 38
"""How far is looked after the touch: 0.3 s."""

KNOWN, UNKNOWN = (float(norm.isf(rate)) for rate in (1e-3, 1e-3 * 0.008 / 0.7))
"""Thresholds for one false contact in 1,000 approaches: who knows when to look, and who looks every 8 ms of 0.7 s."""


def separations(name: str, count: int, first: int = 0) -> Floats:
    """Deflection of the matched filter after each 8 ms, in standard deviations, shape (count, STEPS).

    The same approach is simulated with and without the probe, in the same noise: the difference is what the contact
    adds. Whitened by the model that the free finger's baseline teaches, and divided by its deviation, its norm is how
    far the two hypotheses lie apart for whoever knows it (Neyman and Pearson); in Gaussian noise no test does better.
    """
    found = np.zeros((count, STEPS))
    for i in range(count):
        there, free = (
            approach(level(name), SEED, first + i, rows()[(first + i) % 14], hold_s=0.0, touching=touching)
            for touching in (True, False)
        )
        x = free.accelerometer[: round(BASELINE_S * RATE_HZ)].reshape(-1, HELD).mean(axis=1)
        x = x - x.mean()
        past = np.column_stack([x[ORDER - lag - 1 : -lag - 1] for lag in range(ORDER)])
        weights = np.linalg.lstsq(past, x[ORDER:], rcond=None)[0]
        sigma = float((x[ORDER:] - past @ weights).std())
        begins = int(np.searchsorted(there.times_s, there.touch_s))
        span = slice(begins, begins + STEPS * HELD)
        added = (there.accelerometer[span] - free.accelerometer[span]).reshape(-1, HELD).mean(axis=1)
        white = np.convolve(added, np.concatenate([[1.0], -weights]))[:STEPS]
        found[i] = np.sqrt(np.cumsum(white**2)) / sigma
    return found


def bound(found: Floats) -> dict[str, dict[str, float]]:
    """Share told within 36 and 70 ms, and when half and 95 % are told (s; infinity beyond 0.3 s)."""
    told = {}
    for name, limit in (("known", KNOWN), ("unknown", UNKNOWN)):
        shares = norm.cdf(found - limit).mean(axis=0)
        after = [float(HELD / RATE_HZ * (1 + int(np.argmax(shares >= q)))) for q in (0.5, 0.95)]
        told[name] = {
            "within_36_ms": float(shares[3]),
            "within_70_ms": float(shares[7]),
            "half_s": after[0] if shares[-1] >= 0.5 else float("inf"),
            "p95_s": after[1] if shares[-1] >= 0.95 else float("inf"),
        }
    return told
