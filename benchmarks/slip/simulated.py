"""Detectors on simulated sensors. Thresholds come from quiet that is not judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.slip import scenes
from benchmarks.slip.rivals import OURS, Rival, judges
from benchmarks.slip.scoring import MISSED_S, THRESHOLDS, called, first_above, mean_95, refusals
from controller.detectors.calibration import span_maxima, threshold_for
from controller.reports.counts import wilson
from drivers.mock.physics.slip import SlipPlantSettings

Floats = NDArray[np.float64]
Thresholds = Mapping[str, Mapping[str, float]]
"""Of each detector, under its nuisances."""

SEED_QUIET, SEED_SLIP, SEED_STEPS = 8_000, 8_100, 8_200

SENSORS = ("fingertip", "flexible_finger", "barrett_finger")

STEPS = (1.3, 1.5, 2.0, 3.0)
STEPS_EACH = 20
QUIET_EACH = 120
"""Pieces without a step for the thresholds: 14 minutes in which detectors decide."""

INTERVAL_S = 3600.0
"""One false alarm in this time."""

CONTACTS = ("impacts", "rolling, 0.6 N", "rolling, 1 N", "rolling, 2 N")
"""Contact without slip."""

PIECE_S = 5.0
"""Pieces of contact that are resampled: an impact comes every five seconds."""


def on_steps(kind: str, rate_hz: float) -> Iterator[dict[str, Any]]:
    """How often each detector calls a step of the noise a slip, and for how long: at one false alarm an hour where
    nothing steps, and ours at thresholds from elsewhere as well."""
    begin = round(scenes.STEP_S * rate_hz)
    steps = range(SEED_STEPS, SEED_STEPS + STEPS_EACH)
    after = {factor: [scenes.stepped(kind, rate_hz, factor, seed) for seed in steps] for factor in STEPS}
    quiet = [scenes.stepped(kind, rate_hz, 1.0, seed) for seed in range(SEED_QUIET, SEED_QUIET + QUIET_EACH)]
    for name, judge in judges().items():
        maxima = np.concatenate([span_maxima(judge(each, rate_hz), rate_hz) for each in quiet])
        equal = threshold_for(maxima, INTERVAL_S).threshold
        for factor, recordings in after.items():
            found = [judge(each, rate_hz)[begin:] for each in recordings]
            for threshold in (equal, *(THRESHOLDS if name == OURS else ())):
                ends = [np.flatnonzero(np.nan_to_num(each) > threshold) for each in found]
                alarmed = sum(bool(above.size) for above in ends)
                yield {
                    "kind": kind,
                    "rate_hz": rate_hz,
                    "factor": factor,
                    "detector": name,
                    "threshold": threshold,
                    "steps": STEPS_EACH,
                    "alarmed": alarmed,
                    "alarmed_95": wilson(alarmed, STEPS_EACH),
                    "longest_s": max(
                        ((above[-1] + 1) / rate_hz for above in ends if above.size), default=0.0
                    ),
                }


def in_contact(sensor: str, nuisance: str, thresholds: Thresholds) -> Iterator[dict[str, Any]]:
    """Share of the time in contact without slip in which each detector reports slip, from the touch on, once for each
    structure that is off."""
    recordings = []
    for number, factors in enumerate(scenes.OFF):
        settings = scenes.sensor(sensor, nuisance, *factors)
        rolls = nuisance.startswith("rolling")
        values, touch, slid = scenes.contact(settings, SEED_QUIET + number, scenes.FIRM_M, rolls=rolls)
        if slid:
            raise RuntimeError(f"{sensor}, {nuisance}: it slipped")
        recordings.append(values)
    rate_hz = settings.rate_hz
    for name, judge in judges().items():
        statistics = [judge(values, rate_hz) for values in recordings]
        given = {**thresholds[name], **({f"{each:g}": each for each in THRESHOLDS} if name == OURS else {})}
        for source, threshold in given.items():
            slipping = [
                called(name, values, statistic, rate_hz, threshold)[touch:]
                for values, statistic in zip(recordings, statistics, strict=True)
            ]
            pieces = np.reshape(slipping, (-1, round(PIECE_S * rate_hz))).mean(axis=1)
            yield {
                "sensor": sensor,
                "nuisance": nuisance,
                "detector": name,
                "from": source,
                "threshold": threshold,
                "share": float(pieces.mean()),
                "share_95": mean_95(pieces),
            }


def at_simulated_reset(sensor: str, thresholds: Thresholds) -> Iterator[dict[str, Any]]:
    """A table that moves under the tip while a detector starts, and goes on: how many it then detects. Ours as well
    with the quiet level of the air stored."""
    quiet, slipping = [], []
    for number, factors in enumerate(scenes.OFF * 5):
        settings = scenes.sensor(sensor, "table moves", *factors)
        values, touch, _ = scenes.contact(settings, SEED_SLIP + number, scenes.LIGHT_M, rolls=False)
        begin = touch + round(0.5 * settings.rate_hz)
        quiet.append(values[:touch])
        slipping.append(values[begin : begin + touch])
    for name, judge in judges().items():
        detected = sum(
            math.isfinite(first_above(judge(each, settings.rate_hz), thresholds[name]["clean"]))
            for each in slipping
        )
        row = {"slips": len(slipping), "detected": detected, "detected_95": wilson(detected, len(slipping))}
        yield {"sensor": sensor, "detector": name, "stored": False, **row}
    yield {"sensor": sensor, "detector": OURS, **refusals(quiet, slipping, settings.rate_hz)}


def simulated(
    sensor: str,
    nuisance: str,
    hours: float,
    count: int,
    judges_of: Callable[[SlipPlantSettings], Mapping[str, Rival]] = lambda _: judges(),
) -> list[dict[str, Any]]:
    """Every detector on one sensor under one nuisance: one false alarm an hour, the first seconds included."""
    plants = [scenes.sensor(sensor, nuisance, *factors) for factors in scenes.OFF]
    rate_hz = plants[0].rate_hz
    chosen = [judges_of(plant) for plant in plants]
    maxima: dict[str, list[Floats]] = {name: [] for name in chosen[0]}
    for number, plant in enumerate(plants):
        for values in scenes.recordings(plant, hours / len(plants), SEED_QUIET + number):
            for name, judge in chosen[number].items():
                maxima[name].append(span_maxima(judge(values[:, 0], rate_hz), rate_hz))
    found = {name: threshold_for(np.concatenate(parts), INTERVAL_S) for name, parts in maxima.items()}
    rows = []
    for ramp in (False, True) if nuisance == "clean" else (False,):
        trials = [
            (judges_here, trial)
            for number, (plant, judges_here) in enumerate(zip(plants, chosen, strict=True))
            for trial in scenes.slips(plant, count // len(plants), SEED_SLIP + number, ramp=ramp)
            if trial.onset is not None
        ]
        for name, equal in found.items():
            delays, early = [], 0
            for judges_here, trial in trials:
                assert trial.onset is not None
                statistic = judges_here[name](trial.values[:, 0], rate_hz)
                if math.isfinite(first_above(statistic[trial.start : trial.onset], equal.threshold)):
                    early += 1
                delay_s = first_above(statistic[trial.onset :], equal.threshold) / rate_hz
                delays.append(delay_s if delay_s <= MISSED_S else math.inf)
            rows.append(
                {
                    "sensor": sensor,
                    "nuisance": "ramp" if ramp else nuisance,
                    "detector": name,
                    "threshold": equal.threshold,
                    "extrapolated": equal.extrapolated,
                    "early": early,
                    "delays_s": delays,
                }
            )
    return rows
