"""A series of weights on a bridge: from a recording to its steps, and from steps to gain, hysteresis and resolution.

Definitions follow Fernandez et al., 4.2, where given: a line through zero by least squares; hysteresis is
the largest difference between loading and unloading at the same load over the full-scale output (its equation 5);
resolution is "the smallest change detected". The criterion of detection is not printed: `DETECTED_SIGMA` here.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from controller.recording.series import TrialRecording
from drivers.core.messages import Floats

DETECTED_SIGMA = 3.5
"""A change is detected when it is as many standard deviations of one sample. Assumption: the paper gives no value;
with Gaussian noise one sample in 4,300 goes as far by itself in either direction."""

CONFIDENCE = 0.95
UPPER = 0.5 + CONFIDENCE / 2.0
"""Of every interval, and the share below its upper end."""

BRIDGES = ("x", "y", "t")
"""Names of the bridges in the order of the stream's channels."""


class Step(NamedTuple):
    """One recorded load at rest.

    Attributes:
        going: "up", "down" or "zero": the direction of loading.
        cycle: Which cycle, from 0; negative before the first.
    """

    load_n: float
    going: str
    cycle: int
    mean_v: float
    sd_v: float
    samples: int


class Estimate(NamedTuple):
    """A value with its 95 % interval; NaN where there is too little data."""

    value: float
    low: float
    high: float


UNKNOWN = Estimate(math.nan, math.nan, math.nan)


def steps_of(
    recording: TrialRecording, *, load_stream: str, bridges_stream: str, bridge: str, preloads: int
) -> list[Step]:
    """The loads of a trial, in order; the first is the empty bridge.

    A load that was requested twice in a row (after a pause) counts as it was recorded the second time.

    Args:
        load_stream: The load, as confirmed by the operator.
        bridge: "x", "y" or "t".
        preloads: How often the largest weight hung before the first cycle.
    """
    channel = BRIDGES.index(bridge)
    loads, volts = recording.stream(load_stream), recording.stream(bridges_stream)
    if not len(loads) or not len(volts):
        return []
    ends_s = [*loads.times_s[1:].tolist(), math.inf]
    zeros, before_n = 0, 0.0
    steps: list[Step] = []
    hung = zip(loads.values[:, channel].tolist(), loads.times_s.tolist(), ends_s, strict=True)
    for load_n, begin_s, end_s in hung:
        values_v = volts.between(begin_s, end_s).values[:, channel]
        if len(values_v) < 2:
            continue
        again = bool(steps) and steps[-1].load_n == load_n
        if again:
            before_n = steps[-2].load_n if len(steps) > 1 else 0.0
            zeros -= load_n == 0.0
            steps.pop()
        zeros += load_n == 0.0
        going = "zero" if load_n == 0.0 else "up" if load_n > before_n else "down"
        mean_v, sd_v = float(values_v.mean()), float(values_v.std(ddof=1))
        # After the empty bridge and the preloads' zeros the first cycle begins; a cycle's own zero ends it.
        cycle = zeros - 1 - preloads - (load_n == 0.0)
        steps.append(Step(load_n, going, cycle, mean_v, sd_v, len(values_v)))
        before_n = load_n
    return steps


def calibrate(steps: Sequence[Step], weight_uncertainty: float) -> dict[str, float]:
    """Gain, hysteresis and resolution of one bridge, by column of trials.csv; NaN where there is too little data.

    The line goes through the mean over all cycles of each load and direction: repeating the series improves these
    means, not the line: the residuals are the loop's own departures from any line. The interval of the gain holds
    those residuals as if they were independent, and the weights' common error.

    Args:
        steps: Of a trial (`steps_of`).
        weight_uncertainty: Relative standard uncertainty common to all weights.

    Returns:
        Nothing where no cycle was recorded with two different loads, the bridge is dead, or the largest load is less
        than the smallest change detected.
    """
    if not steps or steps[0].going != "zero":
        return {}
    zero_v, by_cycle = steps[0].mean_v, dict[int, list[Step]]()
    for step in steps[1:]:
        if step.cycle >= 0:
            by_cycle.setdefault(step.cycle, []).append(step._replace(mean_v=step.mean_v - zero_v))
    cycles = list(by_cycle.values())
    points = _mean_points(step for own in cycles for step in own if step.going != "zero")
    loads_n = np.array([load_n for load_n, _ in points])
    if len(set(loads_n.tolist())) < 2:
        return {}
    volts = np.array(list(points.values()))
    gain = _gain(loads_n, volts, weight_uncertainty)
    if gain.value == 0.0:
        return {}
    top_n = float(loads_n.max())
    full_v = gain.value * top_n
    resolution_n = _resolution([step for own in cycles for step in own], gain)
    if resolution_n.value >= top_n:  # a gain that is noise
        return {}
    left_v = [step.mean_v for own in cycles for step in own if step.going == "zero"]
    loaded = [np.array([(s.load_n, s.mean_v) for s in own if s.going != "zero"]) for own in cycles]
    slopes = [_slope(*pairs.T) for pairs in loaded if len(pairs)]
    middles = {n: np.mean(volts[loads_n == n]) for n in set(loads_n.tolist())}
    found: dict[str, float] = {
        "zero_v": zero_v,
        "nonlinearity": max(abs(float(v) - gain.value * load_n) for load_n, v in middles.items())
        / abs(full_v),
        "remanence": float(np.mean(left_v)) / full_v if left_v else math.nan,
        "gain_repeat_v_n": float(np.std(slopes, ddof=1)) if len(slopes) > 1 else math.nan,
        "loads": sum(map(len, cycles)),
    }
    hysteresis = _hysteresis(cycles, full_v, _relative(gain))
    estimates = {"gain{}_v_n": gain, "hysteresis{}": hysteresis, "resolution{}_n": resolution_n}
    for name, estimate in estimates.items():
        ends = zip(("", "_low", "_high"), estimate, strict=True)
        found |= {name.format(end): value for end, value in ends}
    return found


def _mean_points(steps: Iterable[Step]) -> Mapping[tuple[float, str], float]:
    """Mean over the cycles of each load and direction, V."""
    found: dict[tuple[float, str], list[float]] = {}
    for step in steps:
        found.setdefault((step.load_n, step.going), []).append(step.mean_v)
    return {key: float(np.mean(values)) for key, values in sorted(found.items())}


def _slope(loads_n: Floats, volts: Floats) -> float:
    return float(loads_n @ volts / (loads_n @ loads_n))


def _gain(loads_n: Floats, volts: Floats, weight_uncertainty: float) -> Estimate:
    """Least squares through zero, with the residuals' and the weights' uncertainty."""
    from scipy.special import ndtri, stdtrit  # a third of what all of scipy.stats takes to load

    gain = _slope(loads_n, volts)
    freedom = len(loads_n) - 1
    residuals_v = volts - gain * loads_n
    fit = math.sqrt(float(residuals_v @ residuals_v) / freedom / float(loads_n @ loads_n))
    student, normal = (float(each) for each in (stdtrit(freedom, UPPER), ndtri(UPPER)))
    half = math.hypot(student * fit, normal * weight_uncertainty * gain)
    return Estimate(gain, gain - half, gain + half)


def _relative(gain: Estimate) -> float:
    """Half of the gain's interval, relative."""
    return abs((gain.high - gain.low) / (2.0 * gain.value))


def _hysteresis(cycles: Sequence[Sequence[Step]], full_v: float, relative: float) -> Estimate:
    """The paper's equation 5, cycle by cycle; the interval holds cycles and gain."""
    from scipy.special import stdtrit

    shares = []
    for steps in cycles:
        up = {step.load_n: step.mean_v for step in steps if step.going == "up"}
        down = {step.load_n: step.mean_v for step in steps if step.going == "down"}
        both = up.keys() & down.keys()
        if both:
            shares.append(max(abs(down[load_n] - up[load_n]) for load_n in both) / abs(full_v))
    if not shares:
        return UNKNOWN
    mean = float(np.mean(shares))
    if len(shares) < 2:
        return Estimate(mean, math.nan, math.nan)
    student, sigma = float(stdtrit(len(shares) - 1, UPPER)), float(np.std(shares, ddof=1))
    half = math.hypot(student * sigma / math.sqrt(len(shares)), relative * mean)
    return Estimate(mean, mean - half, mean + half)


def _resolution(steps: Sequence[Step], gain: Estimate) -> Estimate:
    """`DETECTED_SIGMA` times the noise of one sample, as force; samples are taken as independent."""
    from scipy.special import gammaincinv

    freedom = sum(step.samples - 1 for step in steps)
    variance = sum((step.samples - 1) * step.sd_v**2 for step in steps) / freedom
    resolution_n = DETECTED_SIGMA * math.sqrt(variance) / abs(gain.value)
    # the quantiles of chi square
    high, low = (2.0 * float(gammaincinv(0.5 * freedom, 0.5 + side * CONFIDENCE / 2.0)) for side in (1, -1))
    below = resolution_n * (1.0 - math.sqrt(freedom / high))
    above = resolution_n * (math.sqrt(freedom / low) - 1.0)
    below, above = (math.hypot(each, resolution_n * _relative(gain)) for each in (below, above))
    return Estimate(resolution_n, resolution_n - below, resolution_n + above)
