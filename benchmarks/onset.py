"""When a knock began, and whether what is said of its uncertainty holds: `python -m benchmarks onset`.

Real blows to a force sensor (after `make recordings`) with noise added, and simulated knocks; ours beside textbook
pickers. The growths that ours knows were chosen on two of the three runs of blows; the first run and fresh seeds judge.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from behaviors.events import Onset
from benchmarks.recordings import TRIBOMETER_HZ, load, struck
from benchmarks.results import save
from controller.detectors.onset import OnsetDetector, OnsetSettings
from controller.reports.counts import wilson
from drivers.core.messages import Floats, SampleBlock

QUIET_S, AFTER_S = 1.1, 0.05
"""Before each knock, and after it."""

JUDGED = "data"
"""The run of blows that chose nothing."""

LOUDER = (0.0, 3.0, 10.0, 30.0)
"""Noise added to a blow, in robust standard deviations of its run."""


class Knocked(NamedTuple):
    """A signal, shape (n,), its rate and when its knock began, s from the first sample on."""

    x: Floats
    rate_hz: float
    truth_s: float


def blows(louder: float) -> Iterator[Knocked]:
    """Blows of the judged run. The truth is halfway to the first sample beyond five deviations of its own quiet, where
    the blow is 450 times the noise; noise is added afterwards."""
    rng = np.random.default_rng(3)
    stored = load("blows")
    if stored is None:
        return
    v = stored[JUDGED]
    sigma = 1.4826 * float(np.median(np.abs(v - np.median(v))))
    before, after = round(QUIET_S * TRIBOMETER_HZ), round(AFTER_S * TRIBOMETER_HZ)
    for p in struck(v):
        if p > before and p + after < len(v):
            quiet = v[p - 600 : p - 100]
            near = np.abs(v[p - 60 : p + 1] - quiet.mean())
            first = before - 60 + int(np.flatnonzero(near <= 5.0 * quiet.std())[-1]) + 1
            x = v[p - before : p + after]
            yield Knocked(
                x + louder * sigma * rng.standard_normal(len(x)), TRIBOMETER_HZ, (first - 0.5) / TRIBOMETER_HZ
            )


SIMULATED: Mapping[str, tuple[float, float, float, float]] = {
    "piezo, 100 kHz, at once": (100e3, 20e3, 1e-5, 0.003),
    "microphone, 48 kHz, in 1 ms": (48e3, 2e3, 1e-3, 0.02),
    "accelerometer, 5 kHz, at once": (5e3, 700.0, 1e-4, 0.02),
    "accelerometer, 5 kHz, in 4 ms": (5e3, 700.0, 4e-3, 0.04),
}
"""Rate, frequency of the ring, time in which it grows as time to the power of 1.5, time in which it dies away."""

AMPLITUDES = (5.0, 30.0, 300.0)
"""Of the ring before it dies away, in deviations of noise."""


def simulated(kind: str, amplitude: float, count: int) -> Iterator[Knocked]:
    """Knocks in white noise; the instant lies anywhere between two samples."""
    rate_hz, ring_hz, rise_s, decay_s = SIMULATED[kind]
    for seed in range(count):
        rng = np.random.default_rng((50_000, seed))
        t_s = np.arange(round((QUIET_S + AFTER_S) * rate_hz)) / rate_hz
        truth_s = QUIET_S + float(rng.uniform()) / rate_hz
        since = np.maximum(0.0, t_s - truth_s)
        ring = np.minimum(1.0, since / rise_s) ** 1.5 * np.exp(-since / decay_s)
        ring *= np.sin(2.0 * math.pi * ring_hz * since + rng.uniform(0.0, 2.0 * math.pi))
        yield Knocked(rng.standard_normal(len(t_s)) + amplitude * ring, rate_hz, truth_s)


def ours(k: Knocked) -> tuple[float, float]:
    """When it began and its standard deviation, s; NaN where nothing is told within 20 ms before it and the end."""
    listener = OnsetDetector("knock", OnsetSettings())
    block = SampleBlock("board.accelerometer", 0, 0.0, k.x[:, None], rate_hz=k.rate_hz)
    for event in listener.push(block):
        if isinstance(event, Onset) and event.t_s > k.truth_s - 0.02:
            return event.began_s, event.sigma_s
    return math.nan, math.nan


def beyond(k: Knocked, sigmas: float) -> float:
    """The first sample beyond so many deviations of the quiet."""
    quiet = k.x[: round(1.0 * k.rate_hz)]
    begin = round((k.truth_s - 0.02) * k.rate_hz)
    above = np.flatnonzero(np.abs(k.x[begin:] - quiet.mean()) > sigmas * quiet.std())
    return float(begin + above[0] - 0.5) / k.rate_hz if len(above) else math.nan


def sta_lta(k: Knocked) -> float:
    """Mean power of 2 ms over that of the 0.2 s before, above six."""
    power = (k.x - k.x[: round(k.rate_hz)].mean()) ** 2
    total = np.concatenate([[0.0], np.cumsum(power)])
    short, long = round(0.002 * k.rate_hz), round(0.2 * k.rate_hz)
    ends = np.arange(round((k.truth_s - 0.02) * k.rate_hz), len(power))
    ratio = (total[ends] - total[ends - short]) / short
    ratio /= (total[ends - short] - total[ends - short - long]) / long
    above = np.flatnonzero(ratio > 6.0)
    return float(ends[above[0]] - 0.5) / k.rate_hz if len(above) else math.nan


def akaike(k: Knocked) -> float:
    """Maeda's: where two variances explain 20 ms before and 5 ms after the crossing of `sta_lta` best."""
    crossed = sta_lta(k)
    if math.isnan(crossed):
        return math.nan
    begin = round((crossed - 0.02) * k.rate_hz)
    x = k.x[begin : round((crossed + 0.005) * k.rate_hz)]
    n, at = len(x), np.arange(10, len(x) - 10)
    one, two = np.cumsum(x), np.cumsum(x**2)
    before = two[at - 1] / at - (one[at - 1] / at) ** 2
    after = (two[-1] - two[at - 1]) / (n - at) - ((one[-1] - one[at - 1]) / (n - at)) ** 2
    best = at[np.argmin(at * np.log(before + 1e-30) + (n - at - 1) * np.log(after + 1e-30))]
    return float(begin + best - 0.5) / k.rate_hz


RIVALS = {
    "first beyond 5 deviations": lambda k: beyond(k, 5.0),
    "STA/LTA above 6": sta_lta,
    "STA/LTA, then Akaike (Maeda)": akaike,
}


def judged(knocks: list[Knocked]) -> Iterator[dict[str, Any]]:
    """Of each picker: misses, and errors of the others, s; of ours how often its 95 % interval holds the truth."""
    found = np.array([ours(k) for k in knocks])
    truth = np.array([k.truth_s for k in knocks])
    picks = {
        "ours": found[:, 0],
        **{name: np.array([pick(k) for k in knocks]) for name, pick in RIVALS.items()},
    }
    for name, at_s in picks.items():
        off = (at_s - truth)[np.isfinite(at_s)]
        row: dict[str, Any] = {"picker": name, "knocks": len(knocks), "told": len(off)}
        if len(off):
            row |= {
                "median_s": float(np.median(off)),
                "within_90_s": float(np.quantile(np.abs(off), 0.9)),
            }
            if name == "ours":
                held = int(np.sum(np.abs(off) < 1.96 * found[np.isfinite(at_s), 1]))
                row |= {"held": held, "held_interval": wilson(held, len(off))}
                row["sigma_s"] = float(np.nanmedian(found[:, 1]))
        yield row


def main(quick: bool = False) -> None:
    """Run the study; writes results/onset.json."""
    rows = []
    count = 20 if quick else 200
    sets = {f"blows, noise + {louder:g}": list(blows(louder)) for louder in LOUDER}
    for kind in SIMULATED:
        for amplitude in AMPLITUDES:
            sets[f"{kind}, {amplitude:g} deviations"] = list(simulated(kind, amplitude, count))
    for name, knocks in sets.items():
        if knocks:
            rows += [{"signal": name, **row} for row in judged(knocks)]
    save("onset", {"rows": rows}, quick=quick)


if __name__ == "__main__":
    main()
