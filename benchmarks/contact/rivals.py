"""Detectors that ours is held against: each a plain function from an approach to a statistic that a contact raises.

Each learns from the same baseline of 10 s as ours, and answers with times (s) and values; what settings it has are
given their best ones by the study, on the approaches that set the thresholds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.contact.scenes import RATE_HZ, SETTLE_S, Approach
from controller.detectors.resonance import ResonanceDetector, ResonanceSettings

Floats = NDArray[np.float64]
Told = tuple[Floats, Floats]


def average(heard: Approach, samples: int, sample_hz: float | None, baseline_s: float = 10.0) -> Told:
    """The paper's: a moving average of the frequency, in standard deviations of the baseline's averages."""
    times_s, frequency = heard.ends_s, 1.0 / heard.periods_s
    if sample_hz is not None:
        due = np.flatnonzero(np.diff(np.floor(times_s * sample_hz))) + 1
        times_s, frequency = times_s[due], frequency[due]
    averaged = np.convolve(frequency, np.ones(samples) / samples, mode="valid")
    return _scored(times_s[samples - 1 :], averaged, heard, baseline_s)


def period_innovations(heard: Approach, order: int) -> Told:
    """What an autoregressive model of the periods' frequencies does not foretell."""
    frequency = 1.0 / heard.periods_s
    return _scored(heard.ends_s, _innovations(frequency, heard.ends_s < heard.starts_s, order), heard)


def waveform_innovations(heard: Approach, order: int, hop: int, sum_of: int) -> Told:
    """Energy of what an autoregressive model of the waveform does not foretell, summed over some values.

    The waveform is averaged over `hop` samples: at 1 kHz the model would learn how the simulated noise is held.
    """
    n = len(heard.accelerometer) // hop * hop
    x = heard.accelerometer[:n].reshape(-1, hop).mean(axis=1)
    times_s = heard.times_s[hop - 1 : n : hop]
    off = _innovations(x - x[times_s < heard.starts_s].mean(), times_s < heard.starts_s, order)
    energy = np.sqrt(np.convolve(off**2, np.ones(sum_of))[: len(off)])
    return _scored(times_s, energy, heard)


def phase_kalman(heard: Approach, drift: float) -> Told:
    """Normalised innovations of the oscillator's edges: phase measured, frequency a random walk.

    Args:
        heard: The approach.
        drift: Step of the frequency in a period against the noise of an edge, in periods.
    """
    mean_s = heard.periods_s[heard.ends_s < heard.starts_s].mean()
    edges = heard.ends_s / mean_s
    phase, rate = float(edges[0]), float(heard.periods_s[0] / mean_s)
    a, b, c = 1.0, 0.0, 1.0  # the covariance of phase and rate
    off = np.zeros(len(edges))
    for i, edge in enumerate(edges.tolist()):
        phase, a, b, c = phase + rate, a + 2.0 * b + c, b + c, c + drift**2
        late, s = edge - phase, a + 1.0
        off[i] = -late / s**0.5  # an edge that comes early leads
        phase, rate = phase + a / s * late, rate + b / s * late
        a, b, c = a - a * a / s, b - a * b / s, c - b * b / s
    return _scored(heard.ends_s, off, heard)


def amplitude_cusum(heard: Approach, slack: float) -> Told:
    """Two one-sided sums of the amplitude's logarithm, period by period, beyond a slack in standard deviations."""
    samples = round(RATE_HZ * float(heard.periods_s.mean()))
    n = len(heard.accelerometer) // samples * samples
    blocks = heard.accelerometer[:n].reshape(-1, samples)
    times_s = heard.times_s[samples - 1 : n : samples]
    _, z = _scored(times_s, np.log(blocks.std(axis=1)), heard)
    found, up, down = np.zeros(len(z)), 0.0, 0.0
    for i, value in enumerate(z):
        up, down = max(0.0, up + value - slack), max(0.0, down - value - slack)
        found[i] = max(up, down)
    return times_s, found


def ours(heard: Approach, senses: str = "all", free_hz: float = 1.0) -> Told:
    """The detector of the program, its deviations; `free_hz`: it mixes with so many times the right frequency."""
    settings = ResonanceSettings.model_validate({"senses": senses})
    values = heard.accelerometer
    times_s, s = ResonanceDetector("contact", settings).deviations(values[:, None], RATE_HZ, free_hz)
    return SETTLE_S + 1.0 / RATE_HZ + times_s, s


def _innovations(x: Floats, base: NDArray[np.bool_], order: int) -> Floats:
    mean = x[base].mean()
    y = x - mean
    n = int(base.sum())
    past = np.column_stack([y[order - lag - 1 : n - lag - 1] for lag in range(order)])
    weights = np.linalg.lstsq(past, y[order:n], rcond=None)[0]
    off: Floats = np.convolve(y, np.concatenate([[1.0], -weights]))[: len(y)]
    off[:order] = 0.0
    return off


def _scored(times_s: Floats, x: Floats, heard: Approach, baseline_s: float = 10.0) -> Told:
    """Standard deviations above the mean of the baseline, whose first second is left out where it is long enough."""
    from_s = SETTLE_S + (1.0 if baseline_s > 5.0 else 0.0)
    to_s = heard.starts_s if baseline_s > 5.0 else SETTLE_S + baseline_s + times_s[0] - heard.ends_s[0]
    base = x[(times_s >= from_s) & (times_s < to_s)]
    return times_s, (x - base.mean()) / base.std(ddof=1)


VARIANTS: Mapping[str, Mapping[str, Callable[[Approach], Told]]] = {
    "paper's criterion at its best": {
        f"{samples} at {rate}": partial(average, samples=samples, sample_hz=rate)
        for samples in (2, 3, 5, 10)
        for rate in (15.0, None)
    },
    "one period": {"every period": partial(average, samples=1, sample_hz=None)},
    "AR innovations": {
        **{f"periods, order {order}": partial(period_innovations, order=order) for order in (2, 4, 6, 10)},
        "waveform, order 12": partial(waveform_innovations, order=12, hop=4, sum_of=3),
    },
    "Kalman on phase": {f"drift {drift}": partial(phase_kalman, drift=drift) for drift in (0.1, 0.3, 1.0)},
    "CUSUM on amplitude": {f"slack {slack}": partial(amplitude_cusum, slack=slack) for slack in (0.5, 1.5)},
    "ours": {"all": ours},
    "ours, phase alone": {"phase": partial(ours, senses="phase")},
    "ours, frequency alone": {"frequency": partial(ours, senses="frequency")},
    "ours, amplitude alone": {"amplitude": partial(ours, senses="amplitude")},
}
"""Every detector with the settings it may choose from."""
