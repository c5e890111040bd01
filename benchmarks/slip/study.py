"""The comparison itself: sensor by sensor, nuisance by nuisance, threshold by threshold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.slip import scenes
from benchmarks.slip.clairvoyant import Clairvoyant, fit
from benchmarks.slip.scoring import Fresh, Quiet, Score, pooled, score
from controller.detectors.calibration import Calibration, Statistic
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.reports.slip_verdicts import VERDICTS, verdict_of

SEED_QUIET, SEED_SLIP, SEED_FIT = 7_000, 8_000, 9_000
"""Keys of recordings, of trials and of what the clairvoyant is fitted to: no sample is used twice."""

PAPER_THRESHOLDS = {"fingertip": 10.0, "flexible_finger": 0.25}
"""Printed in 4.3 and 5.1; none for the others."""


@dataclass(frozen=True)
class Size:
    """How much is simulated.

    Attributes:
        hours: Of recordings without slip for each sensor, nuisance and population; half of them sets the threshold.
        trials: Slips for each structure of the population.
    """

    hours: float
    trials: int


FULL = Size(hours=16.0, trials=100)
"""Eight alarms are expected in either half: an interval is known to within a factor of 2.3 (Poisson, 95 %). Ten minutes
on two cores; each hour more costs 67 s of processor time."""

QUICK = Size(hours=2.0 / 3.0, trials=10)


@dataclass(frozen=True)
class Result:
    """One detector on one sensor under one nuisance.

    Attributes:
        fresh: In its first seconds after a reset, and `fresh_score` at the threshold that those ask for.
        trials: How many slips it was shown.
    """

    sensor: str
    nuisance: str
    population: str
    detector: str
    calibration: Calibration
    false_alarms: int
    checked_h: float
    trials: int
    score: Score
    fresh: Fresh
    fresh_score: Score

    @property
    def verdict(self) -> str:
        """good, regular or bad, by the file that was fixed before the first run."""
        return verdict_of(self.score.delays_s)


def detectors(sensor: str) -> dict[str, Statistic]:
    """The paper's and ours, as the user would make them; nothing but the block's length depends on the sensor."""
    block_s = 0.16 if sensor == "dsa_taxel" else 0.064
    return {
        "slip.paper": SlipPaperDetector("paper", SlipPaperSettings(block_s=block_s)),
        "slip": SlipDetector("ours", SlipSettings()),
    }


def clairvoyant(sensor: str) -> tuple[Clairvoyant, float]:
    """The reference that knows the nominal plant, and its mean log-likelihood ratio in slip, nats a sample."""
    settings = scenes.sensor(sensor, "clean")
    rate_hz = settings.rate_hz
    still = [values[:, 0] for values in scenes.recordings(settings, 1.0 / 3.0, SEED_FIT)]
    moving = [
        trial.values[trial.onset + round(0.05 * rate_hz) :, 0]
        for trial in scenes.slips(settings, 40, SEED_FIT)
        if trial.onset is not None
    ]
    half = len(moving) // 2
    found = Clairvoyant(fit(still), fit(moving[:half]))
    gain = np.concatenate([found.log_odds(piece)[round(0.1 * rate_hz) :] for piece in moving[half:]])
    return found, float(np.mean(gain))


def compare(
    sensor: str, nuisance: str, population: str, judges: Mapping[str, Statistic], size: Size
) -> Iterator[Result]:
    """Calibrate and score some detectors on the same recordings and trials."""
    off = scenes.OFF if population == "off" else ((1.0, 1.0),)
    plants = [scenes.sensor(sensor, nuisance, *factors) for factors in off]
    rate_hz = plants[0].rate_hz
    quiet = {name: Quiet.empty() for name in judges}
    heard = 0
    for number, plant in enumerate(plants):
        for values in scenes.recordings(plant, size.hours / len(plants), SEED_QUIET + number):
            for name, judge in judges.items():
                quiet[name].hear(judge, values, rate_hz, heard)
            heard += 1
    trials = [
        list(scenes.slips(plant, size.trials, SEED_SLIP + number)) for number, plant in enumerate(plants)
    ]
    for name, judge in judges.items():
        calibration = quiet[name].threshold(VERDICTS["false_alarm_interval_s"])
        alarms, hours = quiet[name].check(calibration.threshold)
        fresh = quiet[name].fresh(calibration.threshold, VERDICTS["false_alarm_interval_s"])
        yield Result(
            sensor,
            nuisance,
            population,
            name,
            calibration,
            alarms,
            hours,
            size.trials * len(plants),
            _scored(judge, trials, rate_hz, calibration.threshold),
            fresh,
            _scored(judge, trials, rate_hz, fresh.calibration.threshold),
        )


def ramped(sensor: str, clean: Sequence[Result], size: Size) -> Iterator[Result]:
    """The 50 ms ramp at the thresholds of the clean recordings, which these results have."""
    judges = detectors(sensor)
    plants = [scenes.sensor(sensor, "clean", *factors) for factors in scenes.OFF]
    rate_hz = plants[0].rate_hz
    trials = [
        list(scenes.slips(plant, size.trials, SEED_SLIP + number, ramp=True))
        for number, plant in enumerate(plants)
    ]
    for result in clean:
        judge = judges[result.detector]
        yield replace(
            result,
            nuisance="ramp",
            score=_scored(judge, trials, rate_hz, result.calibration.threshold),
            fresh_score=_scored(judge, trials, rate_hz, result.fresh.calibration.threshold),
        )


def _scored(
    judge: Statistic, trials: Sequence[Sequence[scenes.Slip]], rate_hz: float, threshold: float
) -> Score:
    """All structures of a population together."""
    late_s = VERDICTS["missed_after_s"]
    return pooled([score(judge, group, rate_hz, threshold, late_s) for group in trials])


def bound_s(nats_per_sample: float, rate_hz: float) -> float:
    """log(ARL) / KL: what no detector with this false-alarm interval can beat on average (Lorden), one sample at
    least; infinite where the estimate of KL is not above 0."""
    if not nats_per_sample > 0.0:
        return math.inf
    samples = math.log(VERDICTS["false_alarm_interval_s"] * rate_hz) / nats_per_sample
    return max(1.0, samples) / rate_hz
