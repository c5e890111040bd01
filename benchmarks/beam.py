"""A real vibrating structure whose stiffness is changed in steps, and textbook trackers of its frequency: for `curves`.

Each rest between two steps is a recording of its own: a detector learns from its first `LEARN_S`, is watched for false
alarms until the roller moves, and then for `IN_TIME_S`. All get the same signal: the accelerometer behind one causal
band-pass.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, hilbert, lfilter, sosfilt

from benchmarks.recordings import load
from controller.detectors.resonance import ResonanceDetector, ResonanceSettings
from drivers.core.messages import Floats

RATE_HZ = 5000.0
BAND_HZ = (20.0, 55.0)
"""The first mode is at 26 to 42 Hz over the roller's travel."""

LEARN_S, AFTER_S, IN_TIME_S = 0.6, 0.05, 0.1
"""What is learned from, from how long after the roller stood; and a detection in time."""

MOVES_V, STANDS_S = 0.02, 0.5
"""The roller moves where its position changes by so much in 20 ms, eight times its noise; a shorter rest is none."""

MOTOR_S = 0.05
"""The motor shakes the beam before the position shows that it moves: time before a step that is no rest."""


class RollerStep(NamedTuple):
    """A rest and the step that ends it: run, the signal from the rest's start on (n,), and the step's sample in it
    (None: the recording ends)."""

    run: str
    x: Floats
    step: int | None


def steps() -> Iterator[RollerStep]:
    """All rests in which the beam swings, and what follows."""
    for run, columns in (load("beam") or {}).items():
        position = columns[:, 1].copy()
        position[:25] = np.median(position[25:100])  # the converter starts
        x = np.asarray(sosfilt(butter(2, BAND_HZ, "bandpass", fs=RATE_HZ, output="sos"), columns[:, 0]))
        mean = np.convolve(np.pad(position, 50, "edge"), np.full(100, 0.01), "valid")[: len(position)]
        moving = np.concatenate(
            [np.zeros(50, bool), np.abs(mean[100:] - mean[:-100]) > MOVES_V, [False] * 50]
        )
        turns = np.flatnonzero(np.diff(moving))
        begins, ends = turns[::2], turns[1::2]
        rests = [
            (end, begin)
            for end, begin in zip(ends, [*begins[1:], None], strict=True)
            if begin is None or begin - end > STANDS_S * RATE_HZ
        ]
        way = 0.0
        for end, begin in rests:
            start = end + round(AFTER_S * RATE_HZ)
            if begin is None:  # as long as the others
                yield RollerStep(run, x[start : start + round(RATE_HZ)], None)
                continue
            before, way = way, math.copysign(1.0, mean[begin + 500] - mean[begin])
            if way < before:
                continue  # the motor takes up its play: it shakes the beam 0.1 s before the roller moves
            near = position[begin - 400 : begin + 400]
            off = np.abs(np.convolve(near, np.full(25, 0.04), "valid") - near[:300].mean())
            onset = begin - 400 + 100 + int(np.argmax(off[100:] > 0.012)) + 12
            stop = onset + round(IN_TIME_S * RATE_HZ)
            yield RollerStep(run, x[start:stop], onset - start)


Tracker = Callable[[Floats], Floats]
"""The statistic after each sample, NaN where nothing is decided."""


def ours(x: Floats) -> Floats:
    """The program's detector."""
    given = {"stiffness": "either", "baseline_s": LEARN_S, "free_hz_from": 22.0, "free_hz_to": 50.0}
    detector = ResonanceDetector("contact", ResonanceSettings.model_validate(given))
    return detector.statistic(x[:, None], RATE_HZ)


def _cusum(values: Floats, rate_hz: float) -> Floats:
    """CUSUM of the deviation from the rest, either way: slack 1.5 sd, each at most 6."""
    n = round(LEARN_S * rate_hz)
    rest = values[round(0.15 * rate_hz) : n]
    z = (values - np.median(rest)) / max(float(rest.std()), 0.005 * abs(float(np.median(rest))))
    found = np.zeros((2, len(values)))
    for row, way in enumerate((1.0, -1.0)):
        level = 0.0
        for i in range(n, len(values)):
            level = max(0.0, level + min(way * float(z[i]), 6.0) - 1.5)
            found[row, i] = level
    found[:, :n] = np.nan
    larger: Floats = found.max(axis=0)
    return larger


DECIMATED = 10


def ar2(x: Floats) -> Floats:
    """Frequency of a recursive second-order model (memory 40 ms) at 500 Hz, and a CUSUM."""
    y, rate_hz = x[::DECIMATED], RATE_HZ / DECIMATED
    keep = math.exp(-1.0 / (0.04 * rate_hz))
    a = lfilter([1.0 - keep], [1.0, -keep], y[1:-1] * (y[2:] + y[:-2]))
    b = lfilter([1.0 - keep], [1.0, -keep], 2.0 * y[1:-1] ** 2)
    hz = np.arccos(np.clip(a / np.maximum(b, 1e-30), -1.0, 1.0)) * rate_hz / (2.0 * math.pi)
    return np.repeat(_cusum(np.concatenate([hz[:1], hz[:1], hz]), rate_hz), DECIMATED)[: len(x)]


def crossings(x: Floats) -> Floats:
    """Frequency by the last two half periods between interpolated zero crossings, and a CUSUM at 500 Hz."""
    at = np.flatnonzero(np.diff(np.signbit(x)))
    exact = at + x[at] / (x[at] - x[at + 1])
    hz = RATE_HZ / np.maximum(exact[2:] - exact[:-2], 1.0)
    places = np.searchsorted(at[2:] + 1, np.arange(len(x)), side="right")
    held = hz[np.maximum(places - 1, 0)]
    return np.repeat(_cusum(held[::DECIMATED], RATE_HZ / DECIMATED), DECIMATED)[: len(x)]


def demodulated(x: Floats) -> Floats:
    """Phase against the straight line through the rest's, smoothed over 20 ms, in its standard deviations."""
    n = round(LEARN_S * RATE_HZ)
    t = np.arange(len(x)) / RATE_HZ
    slope = np.polyfit(t[:n], np.unwrap(np.angle(hilbert(x[:n]))), 1)[0]
    mixed = lfilter(np.full(100, 0.01), [1.0], x * np.exp(-1j * slope * t))
    phase = np.unwrap(np.angle(lfilter(np.full(80, 1.0 / 80.0), [1.0], mixed)))
    rest = phase[round(0.15 * RATE_HZ) : n]
    z = (phase - np.polyval(np.polyfit(t[round(0.15 * RATE_HZ) : n], rest, 1), t)) / max(rest.std(), 1e-3)
    z[:n] = np.nan
    away: Floats = np.abs(z)
    return away


TRACKERS: Mapping[str, Tracker] = {
    "ours, stiffness either": ours,
    "AR(2) frequency, CUSUM": ar2,
    "zero crossings, CUSUM": crossings,
    "demodulated phase": demodulated,
}
