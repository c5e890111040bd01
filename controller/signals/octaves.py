"""Vibration in octaves, each against its own quiet level. Compiled.

A slip shakes several neighbouring octaves at once. Hum shakes one, and a smoothly starting arm the lowest alone.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled

Floats = NDArray[np.float64]

LOWEST_HZ = 15.0
"""Where the lowest octave begins. Real slip of a soft fingertip lies at 10 to 80 Hz; below is the arm's motion."""

TREND_HZ = 10.0
"""A first-order high-pass ahead of all octaves removes the arm's motion. At 5 Hz starts of the arm pass; with a second
order the slip of a soft fingertip is detected later. Chosen on the choosing half of the recordings and on simulated
starts."""

CYCLES = 0.3
"""Memory of an octave's energy, in half periods of its lower edge. Half or twice as much changes little."""

DEAD_NATS = 1.4
"""The log energy of an octave counts from here on: twice the amplitude of quiet is nothing yet."""

MOST_NATS = 4.0
"""No octave counts more."""

FOLLOW_NATS_S = 0.5
"""How fast the quiet level of an octave is followed at most, nats a second: standing contact that vibrates more than
the air did is the new quiet after seconds."""

SINK_NATS_S, QUIETER_NAT, QUIETER_S = 4.0, 1.0, 0.3
"""Additional rate of fall where the log energy has been this far below it, averaged over this time: quiet that was
learned beside running servos is unlearned before a slip that is no louder. Chosen on the choosing half and on
simulated seeds from 40,000 on, which it leaves as they are: with 0.7 nats or 0.15 s the recordings' slips are
detected later."""

DECIDES_HZ = 2000.0
"""The logarithms are taken no more often than this: they cost most."""

TREND, TREND_IN = range(2)
"""Places among the scalars: state of the high-pass ahead and its last input."""

HIGH, LOW, LOW_IN, ENERGY, LEVEL, LATELY, RAISED = range(7)
"""Places in an octave's state: its high-pass, its low-pass and that one's last input, its energy, its quiet level (the
mean logarithm of the energy), how far beyond that the log energy has lain lately, and how far an impact has raised what
counts as quiet."""

STRUCK_NATS = 2.5
"""What an impact leaves counts as quiet up to so far below its peak: contact that bounces is then no slip."""

RECOVER_NATS_S = 4.0
"""How fast that sinks. An arm's bouncing contact dies away as fast; chosen on four of its runs."""


class Octaves(NamedTuple):
    """Filters of one channel; the arrays are advanced in place.

    Attributes:
        trend: Pole of the high-pass ahead.
        poles: High-pass, low-pass and energy of each octave, shape (octaves, 3); a low-pass with pole -1 is none.
        states: Shape (octaves, 7).
        shares: Logarithm of the energy of each in white noise of variance 1, shape (octaves,).
        scalars: Shape (2,).
        stride: Samples from one decision to the next.
        decision_s: The same as a time.
    """

    trend: float
    poles: Floats
    states: Floats
    shares: Floats
    scalars: Floats
    stride: int
    decision_s: float


def octaves(rate_hz: float) -> Octaves:
    """Filters in their initial state; none at rates below 60 Hz."""

    def pole(frequency_hz: float) -> float:
        warped = math.tan(math.pi * frequency_hz / rate_hz)
        return (1.0 - warped) / (1.0 + warped)

    rows, shares, edge_hz = [], [], LOWEST_HZ
    while 4.0 * edge_hz <= rate_hz:
        low = pole(2.0 * edge_hz) if 2.0 * edge_hz < 0.45 * rate_hz else -1.0
        rows.append((pole(edge_hz), low, math.exp(-2.0 * edge_hz / (CYCLES * rate_hz))))
        # of white noise first-order high-pass and low-pass, warped to a and b, leave b^2 / (a + b) / (1 + a) / (1 + b)
        a, b = math.tan(math.pi * edge_hz / rate_hz), (1.0 - low) / max(1.0 + low, 1e-12)
        shares.append(math.log(b * b / ((a + b) * (1.0 + a) * (1.0 + b))))
        edge_hz *= 2.0
    poles = np.array(rows).reshape(-1, 3)
    stride = max(1, int(rate_hz / DECIDES_HZ))
    trend = pole(min(TREND_HZ, 0.1 * rate_hz))
    states = np.zeros((len(rows), 7))
    return Octaves(trend, poles, states, np.array(shares), np.zeros(2), stride, stride / rate_hz)


@compiled()
def filter_octaves(o: Octaves, x: float, most: float) -> None:
    """Process one sample; `most` bounds the step from the one before, so that a glitch does not ring for long."""
    scalars, states = o.scalars, o.states
    step = min(max(x - scalars[TREND_IN], -most), most)
    scalars[TREND_IN] = x
    before = scalars[TREND]
    now = o.trend * before + 0.5 * (1.0 + o.trend) * step
    scalars[TREND] = now
    for k in range(states.shape[0]):
        high = o.poles[k, 0] * states[k, HIGH] + 0.5 * (1.0 + o.poles[k, 0]) * (now - before)
        states[k, HIGH] = high
        low = high
        if o.poles[k, 1] > -1.0:
            low = o.poles[k, 1] * states[k, LOW] + 0.5 * (1.0 - o.poles[k, 1]) * (high + states[k, LOW_IN])
            states[k, LOW] = low
            states[k, LOW_IN] = high
        states[k, ENERGY] += (1.0 - o.poles[k, 2]) * (low * low - states[k, ENERGY])


@compiled()
def learn_octaves(o: Octaves, floor: float, count: int) -> None:
    """Takes one more decision into the mean that is the quiet level, the `count`th."""
    for k in range(o.states.shape[0]):
        o.states[k, LEVEL] += (math.log(o.states[k, ENERGY] + floor) - o.states[k, LEVEL]) / count
        o.states[k, LATELY] = 0.0
        o.states[k, RAISED] = 0.0


@compiled()
def strike_octaves(o: Octaves, floor: float) -> float:
    """Takes the present energy for that of an impact; returns how far it is from its peak, nats, the octaves' mean."""
    fallen = 0.0
    for k in range(o.states.shape[0]):
        beyond = math.log(o.states[k, ENERGY] + floor) - o.states[k, LEVEL]
        o.states[k, RAISED] = max(o.states[k, RAISED], beyond - STRUCK_NATS)
        fallen += (o.states[k, RAISED] + STRUCK_NATS - beyond) / o.states.shape[0]
    return fallen


@compiled()
def spare_octaves(o: Octaves) -> None:
    """It was no impact."""
    o.states[:, RAISED] = 0.0


@compiled()
def quiet_level(o: Octaves, least: float) -> float:
    """Root mean square of all octaves' quiet, in the input's unit, from now on that of white noise at least; `least` is
    the logarithm of its variance."""
    total = 0.0
    for k in range(o.states.shape[0]):
        o.states[k, LEVEL] = max(o.states[k, LEVEL], least + o.shares[k])
        total += math.exp(o.states[k, LEVEL])
    return math.sqrt(total)


@compiled()
def judge_octaves(o: Octaves, floor: float, louder: float, least: float) -> float:
    """Nats by which the loudest neighbours together exceed their quiet; follows the quiet levels.

    Args:
        floor: Added to each energy: what noise of the converter may hide.
        louder: Nats by which the noise in all octaves has grown since quiet was learned; they count for nothing.
        least: Logarithm of the variance of the white noise below which no quiet level falls.
    """
    best, last, second = 0.0, 0.0, 0.0
    follow, sink, lately = FOLLOW_NATS_S * o.decision_s, SINK_NATS_S * o.decision_s, o.decision_s / QUIETER_S
    for k in range(o.states.shape[0]):
        beyond = math.log(o.states[k, ENERGY] + floor) - o.states[k, LEVEL]
        o.states[k, LEVEL] += follow * min(max(beyond, -1.0), 1.0)
        o.states[k, LATELY] += lately * (min(max(beyond, -MOST_NATS), MOST_NATS) - o.states[k, LATELY])
        if o.states[k, LATELY] < -QUIETER_NAT:
            o.states[k, LEVEL] -= sink
            o.states[k, LATELY] += sink
        o.states[k, LEVEL] = max(o.states[k, LEVEL], least + o.shares[k])
        counts = min(max(beyond - o.states[k, RAISED] - louder - DEAD_NATS, 0.0), MOST_NATS)
        o.states[k, RAISED] = max(0.0, o.states[k, RAISED] - RECOVER_NATS_S * o.decision_s)
        best = max(best, counts + last + second)
        second, last = last, counts
    return best
