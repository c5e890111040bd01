"""A real vibrating structure whose stiffness is changed in steps: ours and textbook trackers of its frequency.

`python -m benchmarks contact_steps`, after `make recordings`. Each rest between two steps is a recording of its own: a
detector learns from its first `LEARN_S`, is watched for false alarms until the roller moves, and then for `IN_TIME_S`.
Thresholds of one run come from the rests of the other three. All get the same signal: the accelerometer behind one
causal band-pass. And the simulated finger in noise that grows, or a hum: what of it is called contact.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter, hilbert, lfilter, sosfilt

from behaviors.events import BaselineRefused, Contact
from benchmarks.contact import IN_TIME_S as CONTACT_S
from benchmarks.contact import RATE_HZ as SIMULATED_HZ
from benchmarks.contact import SEED_JUDGED, approach, level, rows
from benchmarks.recordings import load
from benchmarks.results import save
from controller.detectors.calibration import poisson_interval
from controller.detectors.resonance import ResonanceDetector, ResonanceSettings
from drivers.core.messages import Floats, SampleBlock

RATE_HZ = 5000.0
BAND_HZ = (20.0, 55.0)
"""The first mode is at 26 to 42 Hz over the roller's travel."""

LEARN_S, AFTER_S, IN_TIME_S = 0.6, 0.05, 0.1
"""What is learned from, from how long after the roller stood; and a detection in time."""

MOVES_V, STANDS_S = 0.02, 0.5
"""The roller moves where its position changes by so much in 20 ms, eight times its noise; a shorter rest is none."""

MOTOR_S = 0.05
"""The motor shakes the beam before the position shows that it moves: time before a step that is no rest."""

FRESH = 1000
"""First of the approaches judged here: no constant was chosen on these."""

HARMONIC = 0.71
"""The oscillation's own share of the simulated waveform's deviation; the rest is noise and harmonics."""

RATE = 0.02
"""Rests with an alarm."""


class RollerStep(NamedTuple):
    """A rest and the step that ends it: run, the signal from the rest's start on (n,), the step's sample in it (None:
    the recording ends), and whether the frequency rises."""

    run: str
    x: Floats
    step: int | None
    rises: bool


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
                yield RollerStep(run, x[start : start + round(RATE_HZ)], None, False)
                continue
            before, way = way, math.copysign(1.0, mean[begin + 500] - mean[begin])
            if way < before:
                continue  # the motor takes up its play: it shakes the beam 0.1 s before the roller moves
            near = position[begin - 400 : begin + 400]
            off = np.abs(np.convolve(near, np.full(25, 0.04), "valid") - near[:300].mean())
            onset = begin - 400 + 100 + int(np.argmax(off[100:] > 0.012)) + 12
            stop = onset + round(IN_TIME_S * RATE_HZ)
            yield RollerStep(run, x[start:stop], onset - start, way > 0.0)


Tracker = Callable[[Floats], Floats]
"""The statistic after each sample, NaN where nothing is decided."""


def ours(stiffness: str) -> Tracker:
    """The program's detector."""

    def statistic(x: Floats) -> Floats:
        given = {"stiffness": stiffness, "baseline_s": LEARN_S, "free_hz_from": 22.0, "free_hz_to": 50.0}
        detector = ResonanceDetector("contact", ResonanceSettings.model_validate(given))
        return detector.statistic(x[:, None], RATE_HZ)

    return statistic


def _cusum(values: Floats, rate_hz: float, sign: float) -> Floats:
    """CUSUM of the deviation from the rest, `sign` 0 for either way: slack 1.5 sd, each at most 6."""
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
    chosen: Floats = found.max(axis=0) if sign == 0.0 else found[0 if sign > 0.0 else 1]
    return chosen


DECIMATED = 10


def ar2(sign: float) -> Tracker:
    """Frequency of a recursive second-order model (memory 40 ms) at 500 Hz, and a CUSUM."""

    def statistic(x: Floats) -> Floats:
        y, rate_hz = x[::DECIMATED], RATE_HZ / DECIMATED
        keep = math.exp(-1.0 / (0.04 * rate_hz))
        a = lfilter([1.0 - keep], [1.0, -keep], y[1:-1] * (y[2:] + y[:-2]))
        b = lfilter([1.0 - keep], [1.0, -keep], 2.0 * y[1:-1] ** 2)
        hz = np.arccos(np.clip(a / np.maximum(b, 1e-30), -1.0, 1.0)) * rate_hz / (2.0 * math.pi)
        return np.repeat(_cusum(np.concatenate([hz[:1], hz[:1], hz]), rate_hz, sign), DECIMATED)[: len(x)]

    return statistic


def crossings(sign: float) -> Tracker:
    """Frequency by the last two half periods between interpolated zero crossings, and a CUSUM at 500 Hz."""

    def statistic(x: Floats) -> Floats:
        at = np.flatnonzero(np.diff(np.signbit(x)))
        exact = at + x[at] / (x[at] - x[at + 1])
        hz = RATE_HZ / np.maximum(exact[2:] - exact[:-2], 1.0)
        places = np.searchsorted(at[2:] + 1, np.arange(len(x)), side="right")
        held = hz[np.maximum(places - 1, 0)]
        return np.repeat(_cusum(held[::DECIMATED], RATE_HZ / DECIMATED, sign), DECIMATED)[: len(x)]

    return statistic


def demodulated(sign: float) -> Tracker:
    """Phase against the straight line through the rest's, smoothed over 20 ms, in its standard deviations."""

    def statistic(x: Floats) -> Floats:
        n = round(LEARN_S * RATE_HZ)
        t = np.arange(len(x)) / RATE_HZ
        slope = np.polyfit(t[:n], np.unwrap(np.angle(hilbert(x[:n]))), 1)[0]
        mixed = lfilter(np.full(100, 0.01), [1.0], x * np.exp(-1j * slope * t))
        phase = np.unwrap(np.angle(lfilter(np.full(80, 1.0 / 80.0), [1.0], mixed)))
        rest = phase[round(0.15 * RATE_HZ) : n]
        z = (phase - np.polyval(np.polyfit(t[round(0.15 * RATE_HZ) : n], rest, 1), t)) / max(rest.std(), 1e-3)
        z[:n] = np.nan
        chosen: Floats = np.abs(z) if sign == 0.0 else sign * z
        return chosen

    return statistic


TRACKERS: Mapping[str, Mapping[str, Tracker]] = {
    "rising": {
        "ours, stiffness rises": ours("rises"),
        "AR(2) frequency, CUSUM": ar2(1.0),
        "zero crossings, CUSUM": crossings(1.0),
        "demodulated phase": demodulated(1.0),
    },
    "either": {
        "ours, stiffness either": ours("either"),
        "AR(2) frequency, CUSUM": ar2(0.0),
        "zero crossings, CUSUM": crossings(0.0),
        "demodulated phase": demodulated(0.0),
    },
}


def _rest(step: RollerStep, statistic: Floats) -> Floats:
    """The part of a statistic that is judged for false alarms."""
    return statistic if step.step is None else statistic[: step.step - round(MOTOR_S * RATE_HZ)]


def judged(found: list[tuple[RollerStep, Floats]], wanted: Callable[[RollerStep], bool]) -> dict[str, Any]:
    """Steps found in time at thresholds from the rests of the other runs."""
    highest = {
        i: float(np.nanmax(np.nan_to_num(_rest(step, s), nan=-1e9))) for i, (step, s) in enumerate(found)
    }
    refused = sum(bool(np.isnan(s).all()) for _, s in found)
    delays, alarms, margin = [], 0, round(MOTOR_S * RATE_HZ)
    for i, (step, s) in enumerate(found):
        others = [
            highest[k] for k, (other, _) in enumerate(found) if other.run != step.run and highest[k] > -1e9
        ]
        limit = sorted(others)[-max(1, round(RATE * len(others)))]
        alarms += highest[i] > limit
        if step.step is None or not wanted(step):
            continue
        above = np.flatnonzero(np.nan_to_num(s[step.step - margin :], nan=-1e9) > limit)
        delays.append(float(above[0] - margin) / RATE_HZ if len(above) else math.inf)
    return {
        "steps": len(delays),
        "found": int(np.isfinite(delays).sum()),
        "median_s": float(np.median(delays)),
        "rests": len(found),
        "alarms": alarms,
        "alarms_interval": poisson_interval(alarms),
        "refused": refused,
    }


DISTURBED: Mapping[str, tuple[float, float, bool]] = {
    "as in the baseline": (1.0, 0.0, False),
    "noise +30 % after the baseline": (1.3, 0.0, False),
    "noise twice as large after the baseline": (2.0, 0.0, False),
    "hum of 20 %, always": (1.0, 0.2, False),
    "hum of 20 %, after the baseline": (1.0, 0.2, True),
}
"""Factor on the noise, a hum's share of the oscillation at 50 Hz, and whether it begins with the motion."""


def disturbed(finger: str, count: int) -> dict[str, dict[str, int]]:
    """False, in time, late, missed and refused of approaches in each disturbance, with default settings."""
    found: dict[str, dict[str, int]] = {}
    for trial in range(count):
        for name, (noise, hum, later) in DISTURBED.items():
            row = rows()[trial % len(rows())]
            scene = approach(level(finger), SEED_JUDGED, FRESH + trial, row, hold_s=0.0, noise=noise)
            t_s, x = scene.times_s, scene.accelerometer
            amplitude = hum * math.sqrt(2.0) * HARMONIC * float(x[:10_000].std())
            begins_s = scene.starts_s if later else 0.0
            x = x + amplitude * np.sin(2.0 * math.pi * 50.0 * t_s + 0.7) * (t_s >= begins_s)
            block = SampleBlock("board.accelerometer", 0, float(t_s[0]), x[:, None], rate_hz=SIMULATED_HZ)
            events = ResonanceDetector("contact", ResonanceSettings()).push(block)
            at_s = [event.t_s - scene.touch_s for event in events if isinstance(event, Contact)][:1]
            verdict = "missed"
            if isinstance(events[0], BaselineRefused):
                verdict = "refused"
            elif at_s:
                verdict = "false" if at_s[0] < 0.0 else "in time" if at_s[0] <= CONTACT_S else "late"
            counts = found.setdefault(
                name, dict.fromkeys(("false", "in time", "late", "missed", "refused"), 0)
            )
            counts[verdict] += 1
    return found


def main(quick: bool = False) -> None:
    """Run the study; writes results/contact_steps.json."""
    every = list(steps())
    result: dict[str, Any] = {"steps": {}}
    for way, trackers in TRACKERS.items():
        for name, tracker in trackers.items():
            with np.errstate(all="ignore"):
                found = [(step, tracker(step.x)) for step in every]
            result["steps"][f"{way}: {name}"] = judged(found, lambda step: step.rises or way == "either")  # noqa: B023
    for finger in ("printed", "hard"):
        result[finger] = disturbed(finger, 14 if quick else 100)
    save("contact_steps", result, quick=quick)
