"""From a recording without events to the threshold that gives a false alarm once in a stated time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.messages import SampleBlock

Floats = NDArray[np.float64]

SPAN_S = 1.0
"""Alarms closer together than this are one alarm. Assumption: longer than a bump rings, shorter than a user
forgives."""

ENOUGH = 5
"""So many alarms must be expected within the recording for its own quantile to be used; fewer are extrapolated to.
With 5 the interval is known to within a factor of about 2.5 either way (Poisson, 95 %)."""

TAIL = 0.02
TAIL_LEAST = 20
"""Share of the spans, and at least how many, whose maxima the tail is fitted to where it is extrapolated."""


WHOLE = 0.5
"""A recording of which a larger share was lost is refused. Assumption: what is left is then no longer what it was."""


@runtime_checkable
class Statistic(Protocol):
    """A detector that can show the number which it holds against its threshold."""

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """The number after each sample of a whole recording, shape (n,); NaN where a sample decides nothing."""


@dataclass(frozen=True)
class Calibration:
    """A threshold and how well it is known.

    Attributes:
        threshold: One false alarm in `false_alarm_interval_s`, on average.
        low: Lower end of its 95 % confidence interval.
        high: Upper end; infinite where the recording is too short to have one.
        false_alarm_interval_s: What was asked for.
        recording_s: Length of the recording used.
        extrapolated: True where the recording is too short to contain the alarms that it is asked about, so that the
            tail beyond its largest values was assumed to be exponential.
    """

    threshold: float
    low: float
    high: float
    false_alarm_interval_s: float
    recording_s: float
    extrapolated: bool


def calibrate(
    detector: Statistic, values: Floats, rate_hz: float, false_alarm_interval_s: float
) -> Calibration:
    """The threshold that a recording without events asks for.

    Args:
        detector: Whose threshold; its own setting of it does not matter.
        values: The recording, shape (n, channels) or (n,).
        rate_hz: Its sample rate.
        false_alarm_interval_s: Mean time between false alarms.

    Raises:
        ValueError: a recording too short to say anything, or on which the detector decides nothing.
    """
    columns = values[:, None] if values.ndim == 1 else values
    maxima = span_maxima(detector.statistic(columns, rate_hz), rate_hz)
    found = threshold_for(maxima, false_alarm_interval_s)
    if not 0.0 < found.threshold < math.inf:
        raise ValueError(
            f"the recording asks for a threshold of {found.threshold:g}, which is none; is the sensor alive, is its "
            "range exceeded?"
        )
    return found


def calibrate_blocks(
    detector: Statistic, blocks: Sequence[SampleBlock], false_alarm_interval_s: float
) -> Calibration:
    """The threshold that a recorded stream asks for; samples that were lost are gaps to the detector.

    Args:
        detector: Whose threshold.
        blocks: The recording, in order; all at one rate.
        false_alarm_interval_s: Mean time between false alarms.

    Raises:
        ValueError: as `calibrate`; or values that are not finite, irregular times, more than half lost.
    """
    values, rate_hz = _joined([block for block in blocks if len(block)])
    return calibrate(detector, values, rate_hz, false_alarm_interval_s)


def _joined(blocks: Sequence[SampleBlock]) -> tuple[Floats, float]:
    """All samples of a stream, shape (n, channels), NaN where they were lost; and their rate."""
    if not blocks:
        raise ValueError("the recording holds no sample")
    rates = {block.rate_hz for block in blocks}
    rate_hz = blocks[0].rate_hz
    if rate_hz is None or len(rates) > 1:
        raise ValueError(
            "samples at irregular times have no threshold; where they are regular, say --rate HZ"
        )
    heard = sum(len(block) for block in blocks)
    begin = blocks[0].seq
    length = blocks[-1].seq + len(blocks[-1]) - begin
    if any(b.seq < a.seq + len(a) for a, b in pairwise(blocks)):
        raise ValueError("the stream begins anew within the recording; choose one trial or cut it")
    if heard < (1.0 - WHOLE) * length:
        raise ValueError(f"{length - heard} of {length} samples are missing; record more of it in one piece")
    values = np.full((length, blocks[0].values.shape[1]), np.nan)
    for block in blocks:
        physical = block.physical
        bad = np.flatnonzero(~np.isfinite(physical).all(axis=1))
        if bad.size:
            raise ValueError(f"a value at {block.times[bad[0]]:.6g} s is not finite; cut the recording there")
        values[block.seq - begin : block.seq - begin + len(block)] = physical
    return values, rate_hz


def span_maxima(statistic: Floats, rate_hz: float) -> Floats:
    """Largest value in each whole second, spans without a decision left out, shape (spans,)."""
    size = max(1, round(SPAN_S * rate_hz))
    count = len(statistic) // size
    spans = np.where(np.isnan(statistic), -math.inf, statistic)[: count * size].reshape(count, size)
    maxima = spans.max(axis=1) if count else np.empty(0)
    return maxima[maxima > -math.inf]


def threshold_for(maxima: Floats, false_alarm_interval_s: float) -> Calibration:
    """The threshold from the maxima of spans without an event.

    Args:
        maxima: Largest value in each second, shape (spans,).
        false_alarm_interval_s: Mean time between false alarms.

    Raises:
        ValueError: too few spans, or an interval of no more than one.
    """
    recording_s = len(maxima) * SPAN_S
    if not false_alarm_interval_s > SPAN_S:
        raise ValueError(
            f"a false-alarm interval of {false_alarm_interval_s:g} s is too short; ask for more than {SPAN_S:g} s"
        )
    if len(maxima) < 2 * TAIL_LEAST:
        raise ValueError(
            f"{recording_s:g} s in which the detector decides are too few; record {2 * TAIL_LEAST} s or more"
        )
    ordered = np.sort(maxima)[::-1]
    expected = recording_s / false_alarm_interval_s
    if expected >= ENOUGH:
        low, high = poisson_interval(expected)
        ranks = [min(len(ordered), round(rank)) for rank in (high, expected, low)]
        # just above the value of rank k: k - 1 spans alarm; a rank below 1 lies beyond the recording
        levels = [float(ordered[rank - 1]) if rank >= 1 else math.inf for rank in ranks]
        return Calibration(levels[1], levels[0], levels[2], false_alarm_interval_s, recording_s, False)
    return _extrapolated(ordered, expected, false_alarm_interval_s)


def poisson_interval(count: float) -> tuple[float, float]:
    """95 % confidence interval of a Poisson mean of which `count` were seen (F. Garwood, Biometrika 28, 1936)."""
    from scipy.stats import chi2

    low = float(chi2.ppf(0.025, 2.0 * count) / 2.0) if count > 0.0 else 0.0
    return low, float(chi2.ppf(0.975, 2.0 * count + 2.0) / 2.0)


def _extrapolated(ordered: Floats, expected: float, false_alarm_interval_s: float) -> Calibration:
    """An exponential tail through the largest maxima; its scale's standard error makes the interval."""
    used = max(TAIL_LEAST, int(TAIL * len(ordered)))
    start = float(ordered[used])
    scale = float(np.mean(ordered[:used])) - start
    reach = math.log(used / expected)
    error = 1.96 / math.sqrt(used)
    return Calibration(
        start + scale * reach,
        start + scale * reach * (1.0 - error),
        start + scale * reach * (1.0 + error),
        false_alarm_interval_s,
        len(ordered) * SPAN_S,
        True,
    )
