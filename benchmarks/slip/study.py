"""Slip detectors at equal false alarms, on recordings and simulated: `python -m benchmarks slip [--quick]`.

Settings of ours were chosen on the choosing half of the recordings and on simulated seeds from 40,000 on. What is
reported is the judging half, seeds from 8,000 to 8,300, and the blows, which chose nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.recordings import drags
from benchmarks.results import save
from benchmarks.slip.known_structure import knowing
from benchmarks.slip.recorded import at_reset, on_blows, on_drags, on_quiet, on_tribometer
from benchmarks.slip.rivals import OURS, judges
from benchmarks.slip.scoring import EDGES, THRESHOLDS, quantile, resampled
from benchmarks.slip.simulated import CONTACTS, SENSORS, at_simulated_reset, in_contact, on_steps, simulated
from controller.reports.counts import wilson

HOURS, TRIALS = 4.0 / 3.0, 400
"""Simulated without slip, and slips, for each sensor and nuisance: a quarter on each structure that is off."""

NUISANCES = ("clean", "bumps", "loads")
MORE = ("tails", "tremor", "smooth", "bouncing")
"""On the fingertip alone."""

BOUNDED = (("flexible_finger", "bumps"), ("flexible_finger", "loads"), ("barrett_finger", "loads"))
"""Where a goal was missed and ringing is the reason: the gain from knowing the structure there. The fingertip has
hysteresis, which that filter does not know."""

INTERVALS_S = (5.0, 10.0, 20.0)
"""Asked of `calibrate`: 138 s of quiet in both halves hold seven alarms and more of each."""


def _beside_ours(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows with median, p90 and the share missed, and the ratios of the delays to those of ours on the same slips; each
    with its 95 % interval."""
    ours = {(r.get("sensor"), r.get("nuisance")): r["delays_s"] for r in rows if r["detector"] == OURS}
    found = []
    for row in rows:
        delays = np.array(row["delays_s"])
        same = np.array(ours[row.get("sensor"), row.get("nuisance")])
        missed, early = int(np.sum(np.isinf(delays))), row["early"]
        found.append(
            row
            | {"missed": missed / len(delays), "missed_95": wilson(missed, len(delays))}
            | {"early_share": early / len(delays), "early_95": wilson(early, len(delays))}
        )
        for name, share in (("median", 0.5), ("p90", 0.9)):
            again = resampled(delays, share)
            ratios = again / np.maximum(resampled(same, share), 1e-4)
            found[-1] |= {
                f"{name}_s": quantile(delays, share),
                f"{name}_95_s": np.quantile(again, EDGES).tolist(),
                f"{name}_over_ours_95": np.quantile(ratios, EDGES).tolist(),
            }
    return found


def _summarized(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Beside ours, without the slips one by one: seeds bring them back."""
    return [
        {key: value for key, value in row.items() if key != "delays_s"} | {"slips": len(row["delays_s"])}
        for row in _beside_ours(rows)
    ]


def main(quick: bool = False) -> None:
    """Run all of it; writes results/slip.json. Each simulated part is cached in build/slip_study, so that an
    interrupted run continues; delete it after a change of a detector."""
    count, known = 8 if quick else TRIALS, bool(drags("judging"))
    parts = [(sensor, nuisance) for nuisance in NUISANCES for sensor in SENSORS]
    parts += [(SENSORS[0], nuisance) for nuisance in MORE]
    rows = [
        row
        for sensor, nuisance in parts
        for row in _kept(f"{sensor}_{nuisance}_{count}", partial(simulated, sensor, nuisance, HOURS, count))
    ]
    rows += [
        row
        for sensor, nuisance in BOUNDED
        for row in _kept(
            f"{sensor}_{nuisance}_known_{count}", partial(simulated, sensor, nuisance, HOURS, count, knowing)
        )
    ]
    dragged = [{"detector": name, **on_drags(judge)} for name, judge in judges().items()] if known else []
    minute = {row["detector"]: row["threshold"] for row in dragged}
    hour = {sensor: _thresholds(rows, sensor) for sensor in SENSORS}
    study: dict[str, Any] = {
        "drags": _beside_ours(dragged),
        "tribometer": [row for name, judge in judges().items() for row in on_tribometer(name, judge)],
        "blows": [
            {"detector": name, **row}
            for name, judge in judges().items()
            for given in (((), THRESHOLDS) if name == OURS else ((),))
            for row in on_blows(judge, given)
        ],
        "at_reset": [row for name in minute for row in at_reset(name, judges()[name], minute[name])],
        "quiet": [on_quiet(interval_s) for interval_s in INTERVALS_S] if known else [],
        "at_simulated_reset": [row for sensor in SENSORS for row in at_simulated_reset(sensor, hour[sensor])],
        "steps": [
            row
            for kind in ("white", "hum", "converter")
            for rate_hz in (1000.0, 2200.0, 10_000.0)
            for row in _kept(f"steps_{kind}_{rate_hz:g}", partial(on_steps, kind, rate_hz))
        ],
        "contact": [
            row
            for nuisance in CONTACTS
            for sensor in SENSORS
            for row in _kept(
                f"contact_{sensor}_{nuisance}_{count}", partial(in_contact, sensor, nuisance, hour[sensor])
            )
        ],
        "hours": HOURS,
        "simulated": _summarized(rows),
    }
    save("slip", study, quick=quick)


def _thresholds(rows: Iterable[dict[str, Any]], sensor: str) -> dict[str, dict[str, float]]:
    """For one false alarm an hour on a sensor: of each detector, while it rolls, and among bumps."""
    found: dict[str, dict[str, float]] = {name: {} for name in judges()}
    for row in rows:
        if row["sensor"] == sensor and row["nuisance"] in ("clean", "bumps") and row["detector"] in found:
            found[row["detector"]][row["nuisance"]] = row["threshold"]
    return found


def _kept(name: str, compute: Callable[[], Iterable[dict[str, Any]]]) -> list[dict[str, Any]]:
    """A simulated part, from the cache where it is there."""
    path = Path("build/slip_study") / f"{name}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        begun = path.with_suffix(".begun")
        begun.write_text(json.dumps(list(compute())), encoding="utf-8")
        begun.rename(path)
    found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return found


if __name__ == "__main__":
    main()
