"""Page's CUSUM over knocks, which no single blow can drive far, and the likelihood of vibration beside it. Compiled."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.signals.octaves import (
    TREND_IN,
    Octaves,
    filter_octaves,
    judge_octaves,
    learn_octaves,
    quiet_level,
    spare_octaves,
    strike_octaves,
)
from controller.signals.whitening import (
    BARE,
    BEYOND,
    COUNT,
    FRESH,
    LAST,
    LIMIT,
    NOISE,
    ROUNDED,
    STEP,
    Predictor,
    innovate,
)
from drivers.core.compiled import compiled

Floats = NDArray[np.float64]

SUM, CREDIT, MISSING, MEDIAN, TAIL, TOTAL, USED, VIBRATION = range(8)
QUIET, LASTING, SINCE, STRUCK, FALLEN, MASK, IMPACT, TAIL_QUIET, DEAF = range(8, 17)
"""Places in the state: the sum over knocks; what may still be added now; samples missing since the last good one;
logarithms of the innovations' running median and of their 98 % quantile over those of normal noise; sum of the
innovations, and how many; what vibration was worth last; its root mean square in the quiet that was learned, in the
input's unit; evidence that vibration lasts; samples since an impact began (0: none), its largest squared innovation,
and how far the octaves' energy has fallen since half of its time; logarithm of what innovations are compared with
since; the largest of an impact that is over with this sample, 0 without; the tail in the quiet that was learned; how
many more samples went by without a decision than with one."""

MOST_BARE = 25.0
"""An innovation counts no more than this many variances of noise in the likelihood ratio: five standard deviations."""

PER_OCTAVE_NAT = 2.0
PER_INNOVATION_NAT = 0.75
"""Weights of the two opinions on vibration, of which the smaller counts, beside that of knocks. Chosen on the choosing
half of the recordings: the first so that octaves detect slips there that knocks detect too late, the second so that an
arm's start, which innovations do not show, stays below a threshold of knocks."""

MOST_VIBRATION_NAT = 15.0
"""Vibration is worth no more. One blow rings as a slip does, so a threshold beyond this asks for several knocks."""

LASTS_NAT, MOST_LASTING_NAT, LASTS_HZ, LASTING_INNOVATION_NAT = 3.0, 9.0, 20.0, 1.5
"""Vibration beyond the first, up to the second, at this rate, is evidence that it lasts: it is worth the default
threshold in 0.2 s at least, longer than a bump rings. Innovations weigh more in it, for it need not be quick. Chosen on
the choosing half of the recordings and on simulated seeds from 40,000 on."""

LASTING_BELOW = 0.9
"""It stays so many knocks' worth below the upper limit of the knocks."""

STRIKE = 40.0**2
"""A squared innovation beyond this is an impact, in variances of noise. Slip of the recorded and simulated sensors
stays below 700 (26 standard deviations); recorded blows begin at 2,700, an arm's at 300,000."""

STRUCK_RATIO = 0.001
"""After an impact innovations are compared with this share of its largest,"""

RECOVER_NATS_S = 4.0
"""which sinks so fast, nats a second. Chosen on four of an arm's runs."""

DECAYS_NAT = 2.5
"""An impact is one where in its second half the octaves' energy is once so far below their peaks: a slip goes on."""

MEDIAN_NORMAL = -0.7877
"""Logarithm of the median of a chi-square variable, 1 degree of freedom: ln 0.4549."""

MOST_TAIL_NAT, TAIL_ROOM_NAT = math.log(2.25), 0.4
"""Limit of following the tail, 1.5 times the amplitude: beyond it a weak slip among load steps is missed. Where the
quiet itself has a heavier tail, as of servos, converters, outliers, this is the room above."""

TINY = 1e-300
"""Keeps a logarithm finite."""

FLOOR = 1e-3
"""Share of the noise's variance that is added to an octave's energy: a constant converter reading has none."""


class Cusum(NamedTuple):
    """Two opinions about the next innovation, both mixtures of noise and knocks; and the state, advanced in place.

    Attributes:
        knock: Chance of a knock per sample while it slips.
        jump: The same while it does not.
        ratio: Variance of a knock's innovation over that of noise.
        cap: Largest log-likelihood ratio, ln(knock / jump): what one knock is worth.
        refill: What may be added per sample in the long run: a knock counts once, however many samples it lasts.
        patience: Missing samples after which the sum restarts.
        follow: How far the logarithm of the running median moves in a sample; that of the tail, at most.
        most_followed: Largest value of that of the median.
        tail_share: Share of innovations of which the running tail is the quantile: so many a second at any rate.
        tail_normal: Logarithm of that quantile of a chi-square variable, 1 degree of freedom.
        strike: Samples that an impact lasts.
        sample_s: Time of a sample, s.
        deaf: Samples more without a decision than with one that are too many.
        state: Shape (17,).
        totals: Running sums of squared innovations, a ring, shape (size,).
    """

    knock: float
    jump: float
    ratio: float
    cap: float
    refill: float
    patience: int
    follow: float
    most_followed: float
    tail_share: float
    tail_normal: float
    strike: int
    sample_s: float
    deaf: int
    state: Floats
    totals: Floats


@compiled()
def log_odds(c: Cusum, squared: float) -> float:
    """Log-likelihood ratio of an innovation, given its square in variances of noise; bounded by `cap`."""
    # beyond 100 the exponential outweighs all else, and the ratio is at its cap
    lift = math.exp(0.5 * min(squared, 100.0) * (1.0 - 1.0 / c.ratio)) / math.sqrt(c.ratio)
    return math.log((1.0 - c.knock + c.knock * lift) / (1.0 - c.jump + c.jump * lift))


@compiled()
def louder(totals: Floats, count: int) -> float:
    """Generalized log-likelihood ratio of a larger variance in the last 1, 2, 4 ... innovations, nats.

    Args:
        totals: Running sums of squared innovations, a ring, shape (size,).
    """
    size = totals.size
    newest, best, window = totals[count % size], 0.0, 1
    while window < min(size, count + 1):
        ratio = (newest - totals[(count - window) % size]) / window
        if ratio > 1.0:
            best = max(best, 0.5 * window * (ratio - 1.0 - math.log(ratio)))
        window *= 2
    return best


@compiled()
def _follow(c: Cusum, squared: float, pace: float, most_tail: float) -> None:
    """Moves the running median and tail of the innovations."""
    state, found = c.state, math.log(squared + 1e-12)
    step = pace if found - MEDIAN_NORMAL > state[MEDIAN] else -pace
    state[MEDIAN] = min(max(state[MEDIAN] + step, 0.0), c.most_followed)
    beyond = 1.0 if found - c.tail_normal > state[TAIL] else 0.0
    state[TAIL] = min(max(state[TAIL] + pace * (beyond - c.tail_share), 0.0), most_tail)


@compiled()
def _knocks(c: Cusum, squared: float, ceiling: float) -> None:
    """Takes one innovation into Page's sum."""
    state = c.state
    _follow(c, squared, c.follow, max(MOST_TAIL_NAT, state[TAIL_QUIET] + TAIL_ROOM_NAT))
    gain = log_odds(c, squared * math.exp(-max(state[MEDIAN], state[TAIL], state[MASK])))
    if gain > 0.0:
        gain = min(gain, state[CREDIT])
        state[CREDIT] -= gain
    state[CREDIT] = min(c.cap, state[CREDIT] + c.refill)
    state[SUM] = min(max(0.0, state[SUM] + gain), ceiling)


@compiled()
def _strike(c: Cusum, bands: Octaves, squared: float, floor: float) -> None:
    """Follows an impact from its first innovation on, and what it leaves."""
    state = c.state
    state[IMPACT] = 0.0
    state[MASK] = max(0.0, state[MASK] - RECOVER_NATS_S * c.sample_s)
    if state[SINCE] == 0.0:
        if squared * math.exp(-state[TAIL]) < STRIKE:
            return
        state[STRUCK] = state[FALLEN] = 0.0
    state[SINCE] += 1.0
    state[STRUCK] = max(state[STRUCK], squared)
    state[MASK] = max(state[MASK], math.log(STRUCK_RATIO * state[STRUCK]))
    if int(state[SINCE]) % bands.stride == 0:
        fallen = strike_octaves(bands, floor)
        if 2 * state[SINCE] > c.strike:
            state[FALLEN] = max(state[FALLEN], fallen)
    if state[SINCE] >= c.strike:
        state[SINCE] = 0.0
        if state[FALLEN] > DECAYS_NAT:
            state[IMPACT] = state[STRUCK]
        else:
            state[MASK] = 0.0
            spare_octaves(bands)


@compiled()
def _vibration(bands: Octaves, c: Cusum, floor: float, least: float, ceiling: float) -> None:
    """Likelihood of vibration on which octaves and innovations agree, nats; and of one that lasts."""
    state = c.state
    wide = min(MOST_VIBRATION_NAT, PER_OCTAVE_NAT * judge_octaves(bands, floor, state[MEDIAN], least))
    larger = louder(c.totals, int(state[USED])) if wide > 0.0 else 0.0
    state[VIBRATION] = min(wide, PER_INNOVATION_NAT * larger)
    gain = min(wide, LASTING_INNOVATION_NAT * larger, MOST_LASTING_NAT) - LASTS_NAT
    # not far above the threshold: a slip that is over shall end
    most = ceiling - LASTING_BELOW * c.cap
    state[LASTING] = min(max(0.0, state[LASTING] + LASTS_HZ * gain * bands.decision_s), most)


@compiled()
def _learn_quiet(c: Cusum, p: Predictor, bands: Octaves) -> None:
    """Takes a sample into the quiet that is learned."""
    noise, count, learn = p.scalars, p.counts[COUNT], p.first.size
    if count % bands.stride == 0:
        learn_octaves(bands, FLOOR * noise[NOISE], (count - learn - 1) // bands.stride + 1)
    if 2 * count > 3 * learn:
        # weights exist by now, and little time is left
        _follow(c, noise[BARE], 4.0 * c.follow, math.inf)
        c.state[TAIL_QUIET] = c.state[TAIL]


@compiled()
def _go_without(c: Cusum, deaf: bool) -> None:
    """A sample goes by without an innovation; a bridged one leaves it no more deaf."""
    state = c.state
    state[MISSING] += 1.0
    if deaf and state[USED] > 0.0:
        state[DEAF] += 1.0
    if state[MISSING] > c.patience:
        state[SUM] = 0.0
        state[VIBRATION] = 0.0
        state[LASTING] = 0.0


@compiled()
def accumulate(c: Cusum, p: Predictor, bands: Octaves, x: Floats, ceiling: float, out: Floats) -> int:
    """Process samples of one channel, up to the one at which the quiet level is learned, an impact is over, or too many
    went by without a decision.

    Args:
        c: The sum, advanced.
        p: The predictor, advanced.
        bands: Its octaves, advanced.
        x: Samples, shape (n,); NaN is a gap.
        ceiling: Upper limit of the sums, so that old knocks do not delay the end.
        out: Written: the largest of knocks, vibration and that which lasts, after each sample, nats, NaN while it
            learns, shape (n,).

    Returns:
        How many samples were processed.
    """
    noise, state, totals, learn = p.scalars, c.state, c.totals, p.first.size
    for i in range(x.size):
        squared = innovate(p, x[i])
        count = p.counts[COUNT]
        known = abs(x[i]) < BEYOND
        if p.counts[FRESH] > 0:
            # x, or what a lost one was predicted to be
            if p.counts[FRESH] == 1:
                bands.scalars[TREND_IN] = noise[LAST]
            most = LIMIT * math.sqrt(noise[NOISE]) if noise[NOISE] > 0.0 else math.inf
            filter_octaves(bands, noise[LAST], most)
        if known and learn < count < 2 * learn:
            _learn_quiet(c, p, bands)
        if math.isfinite(squared):
            _knocks(c, squared, ceiling)
            _strike(c, bands, squared, FLOOR * noise[NOISE])
            state[MISSING] = 0.0
            state[DEAF] = max(0.0, state[DEAF] - 1.0)
            used = int(state[USED]) + 1
            state[USED] = used
            state[TOTAL] += min(noise[BARE], MOST_BARE)
            totals[used % totals.size] = state[TOTAL]
            least = math.log(ROUNDED * noise[STEP] * noise[STEP] + TINY)
            if used == 1:
                state[QUIET] = quiet_level(bands, least)
            if used % bands.stride == 0:
                _vibration(bands, c, FLOOR * noise[NOISE], least, ceiling)
        else:
            _go_without(c, known or p.counts[FRESH] == 0)
        found = max(state[SUM], state[VIBRATION])
        if state[LASTING] > MOST_VIBRATION_NAT:
            found = max(found, state[LASTING])
        out[i] = found if state[USED] > 0.0 else math.nan
        over = math.isfinite(squared) and (state[USED] == 1.0 or state[IMPACT] > 0.0)
        if over or state[DEAF] == c.deaf:
            return i + 1
    return x.size
