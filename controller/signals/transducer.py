"""A transducer's sweep: where it resonates, how broad, and whether one resonance explains it or two are needed."""

import math
from typing import Literal, NamedTuple

import numpy as np

from drivers.core.messages import Floats

Kind = Literal["amplitude", "conductance"]

LEAST = 6
"""Points of a sweep at least: one more than the parameters of one resonance on a slope."""

BETTER = 10.0
"""By so much AICc must fall for two resonances to be believed in place of one: "essentially no support" for the other
(K. Burnham, D. Anderson, Model Selection and Multimodel Inference, 2002, 2.6)."""

QS = (1.0, 1e4)
"""Sharpness that a resonance may have."""


class Resonance(NamedTuple):
    """One of them: frequency in Hz, and sharpness."""

    frequency_hz: float
    q: float


class Sweep(NamedTuple):
    """What a sweep shows.

    Attributes:
        peak_hz: Where it is largest: the top of a parabola through the three points around it.
        q: The peak's frequency over the width of the band at half its power; NaN where the sweep does not hold that.
        half_low_hz: Lower end of the band in which it has half the peak's power at least; NaN likewise.
        half_high_hz: Upper end.
        low_hz: Lower end of the band within 6 dB of the peak; NaN likewise.
        high_hz: Upper end.
        aicc_one: Akaike's criterion, corrected for few points, of one resonance; smaller is better.
        aicc_two: Of two; NaN where there are too few points for them.
        resonances: Of the model that is believed, by frequency.
        residual: Root mean square of what that model leaves, as a share of the peak.
    """

    peak_hz: float
    q: float
    half_low_hz: float
    half_high_hz: float
    low_hz: float
    high_hz: float
    aicc_one: float
    aicc_two: float
    resonances: tuple[Resonance, ...]
    residual: float


def analyse(frequencies_hz: Floats, response: Floats, kind: Kind = "amplitude") -> Sweep:
    """Peak, bands, sharpness and resonances of a sweep.

    A transducer that sends to another passes through both resonances: the amplitude is a product of one or two. The
    conductance is a sum of one or two, on a straight line.

    Args:
        frequencies_hz: Rising, shape (n,).
        response: Amplitude, or conductance, of each, shape (n,).
        kind: Which of the two. Power goes with the square of an amplitude, and with a conductance itself.

    Raises:
        ValueError: too few points, or no peak among them.
    """
    if len(frequencies_hz) < LEAST:
        raise ValueError(f"{len(frequencies_hz)} points are too few; measure {LEAST} or more")
    if not (np.isfinite(frequencies_hz).all() and np.isfinite(response).all() and (response > 0.0).all()):
        raise ValueError("frequencies and responses must be finite, responses above zero")
    if not (np.diff(frequencies_hz) > 0.0).all() or frequencies_hz[0] <= 0.0:
        raise ValueError("frequencies must rise from row to row, from above zero")
    half, quarter = (math.sqrt(0.5), 0.5) if kind == "amplitude" else (0.5, 0.25)
    top_hz, half_low_hz, half_high_hz = peak(frequencies_hz, response, half)
    if not frequencies_hz[0] < top_hz < frequencies_hz[-1]:
        raise ValueError("the largest response is at the sweep's end; sweep farther, or choose another span")
    _, low_hz, high_hz = peak(frequencies_hz, response, quarter)
    q = top_hz / (half_high_hz - half_low_hz)
    guess = q if math.isfinite(q) else 10.0 * top_hz / float(np.ptp(frequencies_hz))
    one = _fitted(frequencies_hz, response, kind, [Resonance(top_hz, guess)])
    two = _two(frequencies_hz, response, kind, top_hz, guess)
    chosen = two if two is not None and two.aicc < one.aicc - BETTER else one
    return Sweep(
        *(top_hz, q, half_low_hz, half_high_hz, low_hz, high_hz),
        *(one.aicc, math.nan if two is None else two.aicc, chosen.resonances, chosen.residual),
    )


def peak(frequencies_hz: Floats, response: Floats, share: float) -> tuple[float, float, float]:
    """The highest point of a curve, Hz, and where it falls to `share` of it on either side, by straight lines between
    its points; NaN where it does not."""
    best = int(np.argmax(response))
    top_hz, top = float(frequencies_hz[best]), float(response[best])
    if 0 < best < len(response) - 1:
        near_hz = frequencies_hz[best - 1 : best + 2] - top_hz
        curve = np.polynomial.polynomial.polyfit(near_hz, response[best - 1 : best + 2], 2)
        if curve[2] < 0.0:
            shift_hz = float(np.clip(-0.5 * curve[1] / curve[2], near_hz[0], near_hz[2]))
            top_hz, top = top_hz + shift_hz, float(np.polynomial.polynomial.polyval(shift_hz, curve))
    level = share * top
    low_hz = _crossing(frequencies_hz[best::-1], response[best::-1], level)
    return top_hz, low_hz, _crossing(frequencies_hz[best:], response[best:], level)


def _crossing(frequencies_hz: Floats, response: Floats, level: float) -> float:
    """Where a curve that begins above a level first comes down to it."""
    below = np.flatnonzero(response <= level)
    if not below.size or below[0] == 0:
        return math.nan
    at = int(below[0])
    along = (response[at - 1] - level) / (response[at - 1] - response[at])
    return float(frequencies_hz[at - 1] + along * (frequencies_hz[at] - frequencies_hz[at - 1]))


# --- models --------------------------------------------------------------------------------------


class _Fit(NamedTuple):
    aicc: float
    resonances: tuple[Resonance, ...]
    residual: float


def curve(
    frequencies_hz: Floats,
    kind: Kind,
    resonances: list[Resonance],
    heights: Floats,
    across: Floats | None = None,
) -> Floats:
    """What resonances make of a sweep.

    Args:
        frequencies_hz: Shape (n,).
        heights: Of an amplitude its one factor; of a conductance each one's height, the line's middle and its slope
            over the whole sweep.
        across: Places on that line, -0.5 to 0.5 over the sweep; None is the sweep's own.
    """
    detuned = [
        one.q * (frequencies_hz / one.frequency_hz - one.frequency_hz / frequencies_hz) for one in resonances
    ]
    if kind == "amplitude":
        product: Floats = heights[0] / np.sqrt(np.prod([1.0 + x**2 for x in detuned], axis=0))
        return product
    if across is None:
        across = (frequencies_hz - frequencies_hz.mean()) / np.ptp(frequencies_hz)
    peaks = [height / (1.0 + x**2) for height, x in zip(heights, detuned, strict=False)]
    total: Floats = np.sum(peaks, axis=0) + heights[-2] + heights[-1] * across
    return total


def believed(sweep: Sweep, frequencies_hz: Floats, response: Floats, kind: Kind, at_hz: Floats) -> Floats:
    """The curve of the model that is believed, at any frequencies; arguments as `analyse`, `at_hz` of shape (m,)."""
    found = list(sweep.resonances)
    heights = _heights(frequencies_hz, response, kind, found)
    across = (at_hz - frequencies_hz.mean()) / np.ptp(frequencies_hz)
    return curve(at_hz, kind, found, heights, across)


def _heights(frequencies_hz: Floats, response: Floats, kind: Kind, resonances: list[Resonance]) -> Floats:
    """Least squares of what the model is linear in; no resonance is negative, the line may be."""
    from scipy.optimize import nnls

    count = 1 if kind == "amplitude" else len(resonances) + 2
    columns = np.column_stack([curve(frequencies_hz, kind, resonances, row) for row in np.eye(count)])
    signs = columns[:, len(resonances) :]  # the line's two columns
    solved: Floats = nnls(np.column_stack([columns, -signs]), response)[0]
    solved[len(resonances) : count] -= solved[count:]
    return solved[:count]


def _two(frequencies_hz: Floats, response: Floats, kind: Kind, top_hz: float, q: float) -> _Fit | None:
    """The best of several starts: the second resonance beside the first, at distances within the band and beyond."""
    parameters = 5 if kind == "amplitude" else 8
    if len(frequencies_hz) < parameters + 3:
        return None
    width_hz = top_hz / q
    starts = []
    for share in (-2.0, -0.7, -0.3, 0.3, 0.7, 2.0):
        other_hz = top_hz + share * width_hz
        if frequencies_hz[0] < other_hz < frequencies_hz[-1]:
            starts.append([Resonance(top_hz, q), Resonance(other_hz, q)])
    fits = [_fitted(frequencies_hz, response, kind, start) for start in starts]
    return min(fits, key=lambda fit: fit.aicc, default=None)


def _fitted(frequencies_hz: Floats, response: Floats, kind: Kind, start: list[Resonance]) -> _Fit:
    """Least squares from a start: frequencies and sharpnesses by search, heights solved for in each step."""
    from scipy.optimize import least_squares

    top = float(response.max())
    span_hz = float(np.ptp(frequencies_hz))
    bounds_hz = (max(0.5 * frequencies_hz[0], frequencies_hz[0] - span_hz), frequencies_hz[-1] + span_hz)

    def resonances(x: Floats) -> list[Resonance]:
        return [Resonance(float(x[at]), math.exp(float(x[at + 1]))) for at in range(0, len(x), 2)]

    def left(x: Floats) -> Floats:
        heights = _heights(frequencies_hz, response, kind, resonances(x))
        return (curve(frequencies_hz, kind, resonances(x), heights) - response) / top

    begin = np.array([value for one in start for value in (one.frequency_hz, math.log(one.q))])
    low = np.tile([bounds_hz[0], math.log(QS[0])], len(start))
    high = np.tile([bounds_hz[1], math.log(QS[1])], len(start))
    scale = np.tile([span_hz, 1.0], len(start))
    found = least_squares(left, np.clip(begin, low + 1e-9, high - 1e-9), bounds=(low, high), x_scale=scale)
    n = len(response)
    k = len(begin) + (1 if kind == "amplitude" else len(start) + 2) + 1  # the errors' variance is one more
    squares = max(float(np.sum(found.fun**2)), n * 1e-24)
    aicc = n * math.log(squares / n) + 2.0 * k + 2.0 * k * (k + 1) / (n - k - 1) if n > k + 1 else math.inf
    return _Fit(aicc, tuple(sorted(resonances(found.x))), math.sqrt(squares / n))
