"""The program's detector as in a run: events, with a probe that rests against the finger and leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from behaviors.events import BaselineRefused, Contact, ContactLost, Detected
from benchmarks.contact.scenes import RATE_HZ, ApproachScene, approach, level, rows
from controller.detectors.resonance import ResonanceDetector, ResonanceSettings
from drivers.messages import SampleBlock

SEED = 13

FELT_N, FELT_S = 0.005, 0.1
"""The load cell feels the finger above this force (paper IV.B), and between two such moments no farther apart."""

MEAN_SAMPLES = 10
"""Of the load cell, 10 ms: a single sample of the hard finger's, with 1.6 mN of noise, exceeds that force by itself."""


def events_of(scene: ApproachScene, settings: ResonanceSettings) -> Sequence[Detected]:
    """The detector's events on the accelerometer from the baseline's start on."""
    block = SampleBlock(
        "board.accelerometer",
        0,
        float(scene.times_s[0]),
        scene.accelerometer[:, None],
        rate_hz=RATE_HZ,
        unit="m/s2",
    )
    return ResonanceDetector("contact", settings).push(block)


def held(name: str, count: int) -> dict[str, float]:
    """False contacts, gaps in contact while the load cell feels it, and delay of the end; with default settings."""
    false = refused = again = 0
    delays: list[float] = []
    gaps: list[float] = []
    ends: list[float] = []
    for trial in range(count):
        scene = approach(level(name), SEED, trial, rows()[trial % len(rows())])
        events = events_of(scene, ResonanceSettings())
        refused += isinstance(events[0], BaselineRefused)
        begun = [event.t_s for event in events if isinstance(event, Contact)]
        lost = [event.t_s for event in events if isinstance(event, ContactLost)]
        false += bool(begun and begun[0] < scene.touch_s)
        true = [t_s for t_s in begun if t_s >= scene.touch_s]
        delays.append(true[0] - scene.touch_s if true else np.inf)
        force_n = np.convolve(scene.force_n, np.full(MEAN_SAMPLES, 1.0 / MEAN_SAMPLES))[: len(scene.force_n)]
        felt = scene.times_s[force_n > FELT_N]
        left_s = max(t_s for t_s, made in scene.contacts if not made)
        spans = np.split(felt, np.flatnonzero(np.diff(felt) > FELT_S) + 1)
        off = [(t_s, min([b for b in begun if b > t_s], default=np.inf)) for t_s in lost]
        gaps.append(
            max(
                (min(to, span[-1]) - max(since, span[0]) for since, to in off for span in spans),
                default=0.0,
            )
        )
        ends.append(lost[-1] - left_s if lost and lost[-1] > left_s else np.inf)
        again += any(t_s > left_s + FELT_S for t_s in begun)
    known = np.sort(delays)
    return {
        "approaches": count,
        "refused": refused,
        "false": false,
        "again": again,
        "in_time": float(np.mean(known <= 0.07)),
        "p95_s": float(known[int(np.ceil(0.95 * count)) - 1]),
        "held": float(np.mean(np.asarray(gaps) <= 0.1)),
        "longest_gap_s": float(max(0.0, *gaps)),
        "end_median_s": float(np.median(ends)),
        "end_detected": float(np.mean(np.asarray(ends) <= 1.0)),
    }
