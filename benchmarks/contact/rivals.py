"""Detectors that ours is compared with: each a plain function from an approach to a statistic that a contact raises.

Each learns from the same baseline of 10 s as ours, and returns times (s) and values; the study chooses its best
settings on the approaches that set the thresholds.
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
Trace = tuple[Floats, Floats]


def average(scene: ApproachScene, samples: int, sample_hz: float | None) -> Trace:
    """The paper's: a moving average of the frequency, in standard deviations of the baseline's averages."""
    settings = ResonancePaperSettings(
        average_samples=samples, sample_hz=sample_hz, baseline_s=BASELINE_S - 1.0
    )
    times_s, found = ResonancePaperDetector("contact", settings).deviations(scene.ends_s, scene.periods_s)
    return times_s, found["average"]


def period_innovations(scene: ApproachScene, order: int) -> Trace:
    """Innovations of an autoregressive model of the periods' frequencies."""
    frequency = 1.0 / scene.periods_s
    return _scored(scene.ends_s, _innovations(frequency, scene.ends_s < scene.starts_s, order), scene)


def phase_kalman(scene: ApproachScene, drift: float) -> Trace:
    """Normalised innovations of the oscillator's edges: phase measured, frequency a random walk.

    Args:
        scene: The approach.
        drift: Step of the frequency in a period against the noise of an edge, in periods.
    """
    mean_s = scene.periods_s[scene.ends_s < scene.starts_s].mean()
    edges = scene.ends_s / mean_s
    phase, rate = float(edges[0]), float(scene.periods_s[0] / mean_s)
    a, b, c = 1.0, 0.0, 1.0  # the covariance of phase and rate
    off = np.zeros(len(edges))
    for i, edge in enumerate(edges.tolist()):
        phase, a, b, c = phase + rate, a + 2.0 * b + c, b + c, c + drift**2
        late, s = edge - phase, a + 1.0
        off[i] = -late / s**0.5  # an edge that comes early leads
        phase, rate = phase + a / s * late, rate + b / s * late
        a, b, c = a - a * a / s, b - a * b / s, c - b * b / s
    return _scored(scene.ends_s, off, scene)


def amplitude_cusum(scene: ApproachScene, slack: float) -> Trace:
    """Page's cumulative sums, up and down, of each period's rms in deviations of the baseline, less a slack."""
    ends = np.searchsorted(scene.times_s, scene.ends_s, side="right")
    sums = np.concatenate([[0.0], np.cumsum(scene.accelerometer**2)])
    starts = np.concatenate([[0], ends[:-1]])
    power = (sums[ends] - sums[starts]) / np.maximum(ends - starts, 1)
    times_s, off = _scored(scene.ends_s, np.sqrt(power), scene)
    found = np.zeros(len(off))
    up = down = 0.0
    for i in np.flatnonzero(times_s >= scene.starts_s).tolist():
        up, down = max(0.0, up + off[i] - slack), max(0.0, down - off[i] - slack)
        found[i] = max(up, down)
    return times_s, found


def ours(scene: ApproachScene, senses: str = "all", free_hz: float = 1.0) -> Trace:
    """The detector of the program, its deviations; `free_hz`: factor on its mixing frequency."""
    times_s, found = _deviations(scene, free_hz)
    return times_s, found[senses]


@lru_cache(maxsize=1)
def _deviations(scene: ApproachScene, free_hz: float) -> tuple[Floats, Mapping[str, Floats]]:
    detector = ResonanceDetector("contact", ResonanceSettings(baseline_s=BASELINE_S))
    return detector.deviations(scene.times_s, scene.accelerometer, free_hz)


def _innovations(x: Floats, base: NDArray[np.bool_], order: int) -> Floats:
    mean = x[base].mean()
    y = x - mean
    n = int(base.sum())
    past = np.column_stack([y[order - lag - 1 : n - lag - 1] for lag in range(order)])
    weights = np.linalg.lstsq(past, y[order:n], rcond=None)[0]
    off: Floats = np.convolve(y, np.concatenate([[1.0], -weights]))[: len(y)]
    off[:order] = 0.0
    return off


def _scored(times_s: Floats, x: Floats, scene: ApproachScene) -> Trace:
    """Standard deviations above the mean of the baseline, whose first second is left out."""
    base = x[(times_s >= SETTLE_S + 1.0) & (times_s < scene.starts_s)]
    return times_s, (x - base.mean()) / base.std(ddof=1)


PAPER, AR, KALMAN, OURS = "paper's criterion at its best", "AR innovations", "Kalman on phase", "ours"
CUSUM = "CUSUM on amplitude"

VARIANTS: Mapping[str, Mapping[str, Callable[[ApproachScene], Trace]]] = {
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
