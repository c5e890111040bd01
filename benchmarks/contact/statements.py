"""What the paper says of the frequency beyond its table (V.B), as two numbers, and what each finger has of them.

The derivation is in docs/explanation/finger_physics.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.contact.scenes import SETTLE_S, Approach
from drivers.mock.physics.finger import FingerPlant, FingerSettings

Floats = NDArray[np.float64]

LIGHT_S = 0.3
"""From touch to detection, V.B: the time in which an unfiltered signal would have to be consistent."""

SIGMA = 3.0
"""The paper's threshold in standard deviations."""


def shares_below(heard: Sequence[Approach]) -> tuple[float, float]:
    """Share of the periods in light contact that lie below the unfiltered threshold, and of approaches with one.

    Light contact are the whole periods within `LIGHT_S` of the first touch; the threshold is three standard deviations
    of single periods above their mean over the baseline.
    """
    below = total = dips = 0
    for each in heard:
        frequency = 1.0 / each.periods_s
        before = frequency[each.ends_s < each.starts_s]
        light = (each.ends_s - each.periods_s > each.touch_s) & (each.ends_s <= each.touch_s + LIGHT_S)
        low = frequency[light] <= before.mean() + SIGMA * before.std(ddof=1)
        above = np.flatnonzero(~low)
        below, total = below + int(low.sum()), total + int(light.sum())
        dips += bool(not len(above) or low[above[0] :].any())
    return below / total, dips / len(heard)


def averages(settings: FingerSettings, seed: int, trial: int, seconds: float) -> Floats:
    """The untouched finger's ten-sample average at 15 samples a second."""
    plant = FingerPlant(settings)
    plant.begin(key=(seed, trial), gap_m=0.1)
    plant.excite(True)
    plant.advance(SETTLE_S)
    plant.advance(SETTLE_S + seconds, frozenset({"period"}))
    ends_s, periods_s = plant.periods()
    cells = np.floor(ends_s * 15.0)
    sampled = 1.0 / periods_s[np.flatnonzero(np.diff(cells)) + 1]
    return np.convolve(sampled, np.ones(10) / 10.0, mode="valid")


def false_contacts_a_minute(
    settings: FingerSettings, seed: int, sigmas: Sequence[float], minutes: int
) -> dict[str, list[float]]:
    """Crossings of the threshold a minute against its height in standard deviations.

    `known`: sigma over the whole minute; `learned`: mean and sigma of the first second, as the paper learns them.
    """
    found = {"known": np.zeros(len(sigmas)), "learned": np.zeros(len(sigmas))}
    for trial in range(minutes):
        x = averages(settings, seed, trial, 61.0)
        for name, base in (("known", x), ("learned", x[:15])):
            for i, sigma in enumerate(sigmas):
                above = x[15:] > base.mean() + sigma * base.std(ddof=1)
                found[name][i] += np.count_nonzero(above[1:] & ~above[:-1])
    return {name: (counts / minutes).tolist() for name, counts in found.items()}
