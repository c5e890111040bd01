"""Running evidence: log-likelihoods that no single jump can sway, summed until they would be positive no more.
Compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.signals.whitening import Predictor, Settling, innovate
from drivers.compiled import compiled

Floats = NDArray[np.float64]

SUM, CREDIT, MISSING = range(3)
"""Places in the evidence: the sum; what may still be added now; samples missing since the last good one."""


class Odds(NamedTuple):
    """Two opinions about the next innovation, both mixtures of noise and knocks.

    Attributes:
        knock: Chance of a knock per sample while it slips.
        jump: The same while it does not.
        ratio: Variance of a knock's innovation over that of noise.
        cap: Largest log-likelihood ratio, ln(knock / jump): what one knock is worth.
        refill: What may be added per sample in the long run: a knock counts once, however many samples it lasts.
        patience: Missing samples after which the sum begins anew.
    """

    knock: float
    jump: float
    ratio: float
    cap: float
    refill: float
    patience: int


@compiled()
def log_odds(o: Odds, squared: float) -> float:
    """Log-likelihood ratio of an innovation, given its square in variances of noise; bounded by `cap`."""
    # beyond 100 the exponential outweighs all else, and the ratio is at its cap
    lift = math.exp(0.5 * min(squared, 100.0) * (1.0 - 1.0 / o.ratio)) / math.sqrt(o.ratio)
    return math.log((1.0 - o.knock + o.knock * lift) / (1.0 - o.jump + o.jump * lift))


@compiled()
def accumulate(
    o: Odds, s: Settling, p: Predictor, evidence: Floats, x: Floats, ceiling: float, out: Floats
) -> None:
    """Hears n samples of one channel.

    Args:
        o: The two opinions.
        s: Constants of the predictor.
        p: State of the predictor, advanced.
        evidence: Sum, credit and missing samples, shape (3,), advanced.
        x: Samples, shape (n,); NaN is a gap.
        ceiling: The sum is held at this: what was certain long ago must not delay the end.
        out: Written: the sum after each sample, shape (n,).
    """
    for i in range(x.size):
        squared = innovate(s, p, x[i], evidence[SUM] < o.cap)
        if math.isfinite(squared):
            gain = log_odds(o, squared)
            if gain > 0.0:
                gain = min(gain, evidence[CREDIT])
                evidence[CREDIT] -= gain
            evidence[CREDIT] = min(o.cap, evidence[CREDIT] + o.refill)
            evidence[SUM] = min(max(0.0, evidence[SUM] + gain), ceiling)
            evidence[MISSING] = 0.0
        else:
            evidence[MISSING] += 1.0
            if evidence[MISSING] > o.patience:
                evidence[SUM] = 0.0
        out[i] = evidence[SUM]
