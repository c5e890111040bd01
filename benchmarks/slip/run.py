"""The slip study: `python -m benchmarks slip`, or `python -m benchmarks.slip [--quick]`."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import numpy as np

from benchmarks.results import save
from benchmarks.slip import figures
from benchmarks.slip.report import figures as numbers
from benchmarks.slip.report import milliseconds, write_page
from benchmarks.slip.study import (
    FULL,
    QUICK,
    Result,
    Size,
    bound_s,
    clairvoyant,
    compare,
    detectors,
    ramped,
)
from controller.detectors.calibration import Statistic
from controller.reports.slip_verdicts import VERDICTS
from drivers.mock.plants.slip_sensors import SENSORS

NUISANCES = dict.fromkeys(figures.SENSORS, ("clean", "bumps", "loads", "rough")) | {
    "jr3_wrist": ("clean", "bumps"),
    "dsa_taxel": ("clean", "bumps"),
}
"""What each sensor is asked: the two that show no slip at rest are not asked under load as well."""


def _told(result: Result) -> Result:
    s = result.score
    print(
        f"{result.sensor:16} {result.nuisance:6} {result.population:8} {result.detector:11} "
        f"threshold {result.calibration.threshold:10.4g}  {result.false_alarms:3d} false in {result.checked_h:.1f} h  "
        f"median {milliseconds(s.quantile_s(0.5)):>6}  p95 {milliseconds(s.quantile_s(0.95)):>6}  "
        f"missed {100 * s.missed:5.1f} % of {s.delays_s.size}",
        flush=True,
    )
    return result


def _sensor(sensor: str, size: Size) -> tuple[list[Result], tuple[float, float]]:
    """All that is asked of one sensor, and its bound."""
    reference, nats = clairvoyant(sensor)
    judges: Mapping[str, Statistic] = detectors(sensor)
    results = [
        _told(r) for r in compare(sensor, "clean", "nominal", {**judges, "clairvoyant": reference}, size)
    ]
    for nuisance in NUISANCES[sensor]:
        results += [_told(r) for r in compare(sensor, nuisance, "off", judges, size)]
    if sensor in figures.SENSORS:
        results += [_told(r) for r in ramped(sensor, results, size)]
    return results, (nats, bound_s(nats, SENSORS[sensor].rate_hz))


def costs() -> dict[str, float]:
    """Nanoseconds a sample a channel of each detector: median of seven runs of 100 s, blocks of 64."""
    from drivers.messages import SampleBlock

    rate_hz, n, size = 1000.0, 100_000, 64
    values = np.random.default_rng(1).standard_normal((n, 1))
    found = {}
    for name, detector in detectors("fingertip").items():
        taken = []
        for _ in range(7):
            detector.reset()  # type: ignore[attr-defined]
            blocks = [
                SampleBlock("board.tangential", i, i / rate_hz, values[i : i + size], rate_hz=rate_hz)
                for i in range(0, n, size)
            ]
            started = time.process_time()
            for block in blocks:
                detector.push(block)  # type: ignore[attr-defined]
            taken.append(1e9 * (time.process_time() - started) / n)
        found[f"{name}, blocks of 64"] = float(np.median(taken))
        taken = []
        for _ in range(7):
            started = time.process_time()
            detector.statistic(values, rate_hz)
            taken.append(1e9 * (time.process_time() - started) / n)
        found[f"{name}, all at once"] = float(np.median(taken))
    return found


def main(quick: bool = False) -> None:
    """Run the study; writes results/slip.json, results/slip.md and two figures."""
    started = time.process_time()
    size = QUICK if quick else FULL
    results: list[Result] = []
    bounds = {}
    for sensor in SENSORS:
        more, bounds[sensor] = _sensor(sensor, size)
        results += more
    cost = costs()
    seconds = time.process_time() - started
    name = "slip_quick" if quick else "slip"
    save(
        name,
        {
            "simulated": True,
            "hours": size.hours,
            "slips_each": size.trials,
            "verdicts": VERDICTS,
            "results": [numbers(result) for result in results],
            "bounds": {
                sensor: {"nats_per_sample": nats, "bound_s": bound if math.isfinite(bound) else None}
                for sensor, (nats, bound) in bounds.items()
            },
            "ns_per_sample": cost,
            "cpu_s": seconds,
        },
    )
    page = write_page(name)
    if not quick:
        figures.draw(results)
    print(page.partition("## All of it")[0])


if __name__ == "__main__":
    main()
