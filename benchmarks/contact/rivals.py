"""Detectors that ours is held against: each a plain function from an approach to a statistic that a contact raises.

Each learns from the same baseline of 10 s as ours, and answers with times (s) and values; what settings it has are
given their best ones by the study, on the approaches that set the thresholds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.contact.scenes import BASELINE_S, SETTLE_S, ApproachScene
from controller.detectors.resonance import ResonanceDetector, ResonanceSettings
from controller.detectors.resonance_paper import ResonancePaperDetector, ResonancePaperSettings

Floats = NDArray[np.float64]
Told = tuple[Floats, Floats]


def average(heard: ApproachScene, samples: int, sample_hz: float | None) -> Told:
    """The paper's: a moving average of the frequency, in standard deviations of the baseline's averages."""
    settings = ResonancePaperSettings(
        average_samples=samples, sample_hz=sample_hz, baseline_s=BASELINE_S - 1.0
    )
    times_s, told = ResonancePaperDetector("contact", settings).deviations(heard.ends_s, heard.periods_s)
    return times_s, told["average"]


def period_innovations(heard: ApproachScene, order: int) -> Told:
    """What an autoregressive model of the periods' frequencies does not foretell."""
    frequency = 1.0 / heard.periods_s
    return _scored(heard.ends_s, _innovations(frequency, heard.ends_s < heard.starts_s, order), heard)


def phase_kalman(heard: ApproachScene, drift: float) -> Told:
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


def amplitude_cusum(heard: ApproachScene, slack: float) -> Told:
    """Page's cumulative sums, up and down, of each period's rms in deviations of the baseline, less a slack."""
    ends = np.searchsorted(heard.times_s, heard.ends_s, side="right")
    sums = np.concatenate([[0.0], np.cumsum(heard.accelerometer**2)])
    starts = np.concatenate([[0], ends[:-1]])
    power = (sums[ends] - sums[starts]) / np.maximum(ends - starts, 1)
    times_s, off = _scored(heard.ends_s, np.sqrt(power), heard)
    told = np.zeros(len(off))
    up = down = 0.0
    for i in np.flatnonzero(times_s >= heard.starts_s).tolist():
        up, down = max(0.0, up + off[i] - slack), max(0.0, down - off[i] - slack)
        told[i] = max(up, down)
    return times_s, told


def ours(heard: ApproachScene, senses: str = "all", free_hz: float = 1.0) -> Told:
    """The detector of the program, its deviations; `free_hz`: it mixes with so many times the right frequency."""
    times_s, told = _deviations(heard, free_hz)
    return times_s, told[senses]


@lru_cache(maxsize=1)
def _deviations(heard: ApproachScene, free_hz: float) -> tuple[Floats, Mapping[str, Floats]]:
    detector = ResonanceDetector("contact", ResonanceSettings(baseline_s=BASELINE_S))
    return detector.deviations(heard.times_s, heard.accelerometer, free_hz)


def _innovations(x: Floats, base: NDArray[np.bool_], order: int) -> Floats:
    mean = x[base].mean()
    y = x - mean
    n = int(base.sum())
    past = np.column_stack([y[order - lag - 1 : n - lag - 1] for lag in range(order)])
    weights = np.linalg.lstsq(past, y[order:n], rcond=None)[0]
    off: Floats = np.convolve(y, np.concatenate([[1.0], -weights]))[: len(y)]
    off[:order] = 0.0
    return off


def _scored(times_s: Floats, x: Floats, heard: ApproachScene) -> Told:
    """Standard deviations above the mean of the baseline, whose first second is left out."""
    base = x[(times_s >= SETTLE_S + 1.0) & (times_s < heard.starts_s)]
    return times_s, (x - base.mean()) / base.std(ddof=1)


PAPER, AR, KALMAN, OURS = "paper's criterion at its best", "AR innovations", "Kalman on phase", "ours"
CUSUM = "CUSUM on amplitude"

VARIANTS: Mapping[str, Mapping[str, Callable[[ApproachScene], Told]]] = {
    PAPER: {
        f"{samples} {'period' if rate is None else 'sample'}{'s' * (samples > 1)}"
        f"{'' if rate is None else f' at {rate:g} Hz'}": partial(average, samples=samples, sample_hz=rate)
        for samples in (1, 2, 10)
        for rate in (15.0, None)
    },
    AR: {f"order {order}": partial(period_innovations, order=order) for order in (4, 6)},
    KALMAN: {f"drift {drift}": partial(phase_kalman, drift=drift) for drift in (0.3, 1.0)},
    CUSUM: {f"slack {slack}": partial(amplitude_cusum, slack=slack) for slack in (0.5, 1.0, 2.0)},
    OURS: {"all": ours},
    **{
        f"ours, {senses} alone": {senses: partial(ours, senses=senses)}
        for senses in ("phase", "frequency", "amplitude")
    },
    "ours, mixed 30 % off": {"all": partial(ours, free_hz=1.3)},
}
"""Every detector with the settings it may choose from: rivals, and ours in parts and with a wrong free frequency."""
