"""The slip study: `python -m benchmarks slip`, or `python -m benchmarks.slip [--quick]`."""

from __future__ import annotations

import math
import multiprocessing
import os
import resource
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor

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
from drivers.mock.physics.slip_sensors import SENSORS

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


def _nominal(sensor: str, size: Size) -> tuple[list[Result], float]:
    """The plant's own parameters, with the reference that knows them; and what slip adds, nats a sample."""
    reference, nats = clairvoyant(sensor)
    judges: Mapping[str, Statistic] = {**detectors(sensor), "clairvoyant": reference}  # type: ignore[dict-item] # hears no stream
    return list(compare(sensor, "clean", "nominal", judges, size)), nats


def _off(sensor: str, nuisance: str, size: Size) -> list[Result]:
    """Structures that are off; where they are clean, the ramp as well."""
    results = list(compare(sensor, nuisance, "off", detectors(sensor), size))
    if nuisance == "clean" and sensor in figures.SENSORS:
        return [*results, *ramped(sensor, results, size)]
    return results


def _study(size: Size, pool: ProcessPoolExecutor) -> tuple[list[Result], Mapping[str, float]]:
    """All results in the order of the page, and the nats a sample of each sensor."""
    # each has keys of its own: who computes what changes nothing
    work = {
        sensor: (
            pool.submit(_nominal, sensor, size),
            [pool.submit(_off, sensor, nuisance, size) for nuisance in NUISANCES[sensor]],
        )
        for sensor in SENSORS
    }
    results, nats = [], {}
    for sensor, (nominal, off) in work.items():
        found, nats[sensor] = nominal.result()
        results += [_told(result) for result in found]
        for part in off:
            results += [_told(result) for result in part.result()]
    return results, nats


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
    """Run the study on all cores; writes results/slip.json, results/slip.md and two figures."""
    started_s, size = time.perf_counter(), QUICK if quick else FULL
    # a fresh interpreter each: a fork of one that has loaded numba's threads may hang
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        results, nats = _study(size, pool)
    cost = costs()
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    name = "slip_quick" if quick else "slip"
    save(
        name,
        {
            "simulated": True,
            "hours": size.hours,
            "slips_each": size.trials,
            "verdicts": VERDICTS,
            "results": [numbers(result) for result in results],
            "bounds": {sensor: _bound(sensor, found) for sensor, found in nats.items()},
            "ns_per_sample": cost,
            "wall_s": time.perf_counter() - started_s,
            "cpu_s": time.process_time() + children.ru_utime + children.ru_stime,
        },
    )
    page = write_page(name)
    if not quick:
        figures.draw(results)
    print(page.partition("## All of it")[0])


def _bound(sensor: str, nats: float) -> dict[str, float | None]:
    found_s = bound_s(nats, SENSORS[sensor].rate_hz)
    return {"nats_per_sample": nats, "bound_s": found_s if math.isfinite(found_s) else None}


if __name__ == "__main__":
    main()
