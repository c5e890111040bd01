"""Slip detectors at equal false alarms, on recordings and simulated: `python -m benchmarks slip [--quick]`.

Settings of ours were chosen on the choosing half of the recordings and on simulated seeds from 40,000 on. What is
reported is the judging half, seeds from 8,000 to 8,300, and the blows, which chose nothing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors.events import BaselineRefused, SlipEnded, SlipStarted
from benchmarks.recordings import BIOTAC_HZ, MARGIN_S, TRIBOMETER_HZ, Drag, drags, load
from benchmarks.results import save
from benchmarks.slip import scenes
from benchmarks.slip.rivals import LEARN_S, RIVALS, Rival
from controller.detectors.calibration import (
    calibrate_pieces,
    courses_of,
    poisson_interval,
    span_maxima,
    threshold_for,
)
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.reports.counts import wilson
from drivers.messages import SampleBlock

Floats = NDArray[np.float64]

MISSED_S = 0.75
OURS = "slip"
RESAMPLED, EDGES = 1000, (0.025, 0.975)

HOURS, TRIALS = 4.0 / 3.0, 400
"""Simulated without slip, and slips, for each sensor and nuisance: a quarter on each structure that is off."""

NUISANCES = ("clean", "bumps", "loads")
MORE = ("tails", "tremor", "smooth", "bouncing")
"""On the fingertip alone."""

CONTACTS = ("impacts", "rolling, 0.6 N", "rolling, 1 N", "rolling, 2 N")
"""Contact without slip."""

SENSORS = ("fingertip", "flexible_finger", "barrett_finger")
SEED_QUIET, SEED_SLIP, SEED_STEPS = 8_000, 8_100, 8_200

THRESHOLDS = (11.0, 25.0)
"""Of the recordings, rounded up; and the default."""

STEPS = (1.3, 1.5, 2.0, 3.0)
STEPS_EACH = 20

INTERVALS_S = (5.0, 10.0, 20.0)
"""Asked of `calibrate`: 138 s of quiet in both halves hold seven alarms and more of each."""


def _paper(block_s: float) -> Rival:
    detector = SlipPaperDetector("paper", SlipPaperSettings(block_s=block_s))

    def statistic(values: Floats, rate_hz: float) -> Floats:
        found = detector.statistic(values[:, None], rate_hz)
        found[: round(LEARN_S * rate_hz)] = np.nan
        return found

    return statistic


def _ours() -> Rival:
    detector = SlipDetector("ours", SlipSettings())
    return lambda values, rate_hz: detector.statistic(values[:, None], rate_hz)


def judges() -> Mapping[str, Rival]:
    """Every detector, as a function."""
    return {OURS: _ours(), "slip.paper, 64 ms": _paper(0.064), "slip.paper, 32 ms": _paper(0.032), **RIVALS}


def quantile(delays: Floats, share: float) -> float:
    """Of delays; infinite where so many are missed."""
    return float(np.sort(delays)[max(1, math.ceil(share * len(delays))) - 1]) if len(delays) else math.nan


def resampled(delays: Floats, share: float) -> Floats:
    """A quantile of delays resampled, the same slips in each call of as many, shape (RESAMPLED,)."""
    picks = np.random.default_rng(1).integers(0, len(delays), (RESAMPLED, len(delays)))
    place = max(1, math.ceil(share * len(delays))) - 1
    found: Floats = np.partition(np.minimum(delays, MISSED_S)[picks], place, axis=1)[:, place]
    return found


# --- recordings ----------------------------------------------------------------------------------


class Splice(NamedTuple):
    """A drag's own quiet, and then its slip.

    Attributes:
        values: Shape (n,).
        onset: Where slip begins: at a sample within the quiet's own range, so that the cut makes no step.
        reversed: The drag played backwards: quiet, and slip as it comes. The sensor is the same; a slip that dies away
            becomes one that grows.
        reversed_onset: Where its electrodes tell contact.
    """

    values: Floats
    onset: int
    reversed: Floats
    reversed_onset: int


def splice(drag: Drag) -> Splice:
    """A recording's own quiet before its slip."""
    quiet = drag.pressure[drag.lost + round(MARGIN_S * BIOTAC_HZ) :]
    slip = drag.pressure[round(BIOTAC_HZ) : drag.lost - round(0.5 * BIOTAC_HZ)]
    slip = slip[int(np.argmax(slip <= np.quantile(quiet, 0.9))) :][: round(BIOTAC_HZ)]
    backwards = drag.pressure[::-1].copy()
    return Splice(np.concatenate([quiet, slip]), len(quiet), backwards, len(drag.pressure) - drag.lost)


def _maxima(statistic: Floats, rate_hz: float) -> Floats:
    """Second by second; a rest of more than half a second is one."""
    size = round(rate_hz)
    rest = len(statistic) % size
    padded = np.concatenate([statistic, np.full(size - rest if rest > size // 2 else 0, np.nan)])
    return span_maxima(padded, rate_hz)


def _first_above(statistic: Floats, threshold: float) -> float:
    """Samples to the first value above; infinite without."""
    above = np.flatnonzero(np.nan_to_num(statistic, nan=-math.inf) > threshold)
    return float(above[0]) if above.size else math.inf


def on_drags(judge: Rival) -> dict[str, Any]:
    """The threshold from the choosing half's quiet, one false alarm a minute; delays on the judging half."""
    quiet = [s.values[: s.onset] for s in map(splice, drags("choosing"))]
    maxima = np.sort(np.concatenate([_maxima(judge(each, BIOTAC_HZ), BIOTAC_HZ) for each in quiet]))[::-1]
    heard_s = sum(len(each) / BIOTAC_HZ - LEARN_S for each in quiet)
    threshold = float(maxima[max(1, round(heard_s / 60.0))])
    delays, early, alarms, judged_s = [], 0, 0, 0.0
    for each in map(splice, drags("judging")):
        found = judge(each.values, BIOTAC_HZ)
        alarms += int(np.sum(_maxima(found[: each.onset], BIOTAC_HZ) > threshold))
        judged_s += each.onset / BIOTAC_HZ - LEARN_S
        delay_s = _first_above(found[each.onset :], threshold) / BIOTAC_HZ
        delays.append(delay_s if delay_s <= MISSED_S else math.inf)
        first = _first_above(judge(each.reversed, BIOTAC_HZ), threshold)
        early += (first - each.reversed_onset) / BIOTAC_HZ < -MARGIN_S
    return {
        "threshold": threshold,
        "judged_min": judged_s / 60.0,
        "alarms": alarms,
        "early": int(early),
        "delays_s": delays,
    }


def on_tribometer(threshold: float) -> Iterator[dict[str, Any]]:
    """What ours says of the finger on a tribometer."""
    recorded = load("tribometer")
    for column, name in ((0, "lateral force"), (2, "vibration")) if recorded else ():
        assert recorded is not None
        detector = SlipDetector("slip", SlipSettings(input="rig.finger", threshold=threshold))
        values = recorded["run"][:, column : column + 1]
        said = detector.push(SampleBlock("rig.finger", 0, 0.0, values, rate_hz=TRIBOMETER_HZ))
        marks = [
            f"{'on' if isinstance(e, SlipStarted) else 'off'} {e.t_s:.3f}"
            for e in said
            if isinstance(e, SlipStarted | SlipEnded)
        ]
        yield {"channel": name, "threshold": threshold, "said": marks}


BLOW_V, APART_S, HEARD_S = 0.15, 0.3, 0.5
"""A blow to the force sensor is beyond this, some 50 times its noise; the next is as far away at least; what a detector
says in the time after it is the blow's doing."""


def on_blows(judge: Rival, thresholds: Sequence[float]) -> Iterator[dict[str, Any]]:
    """How often single blows to a force sensor are called slip, and for how long: at thresholds as given, or without
    any at the largest value in the quiet between the blows."""
    pieces, quiet = [], []
    for values in (load("blows") or {}).values():
        statistic = judge(values, TRIBOMETER_HZ)
        places = np.flatnonzero(np.abs(values - np.median(values)) > BLOW_V)
        begins = places[np.diff(places, prepend=-(10**9)) > APART_S * TRIBOMETER_HZ]
        resting = np.ones(len(values), dtype=bool)
        for begin in begins:
            after = slice(begin, begin + round(HEARD_S * TRIBOMETER_HZ))
            pieces.append(np.nan_to_num(statistic[after]))
            resting[begin - round(0.05 * TRIBOMETER_HZ) : after.stop] = False
        quiet.append(float(np.nanmax(statistic[resting])))
    for threshold in (thresholds or [max(quiet)]) if pieces else []:
        yield {
            "threshold": threshold,
            "blows": len(pieces),
            "called": sum(bool((piece > threshold).any()) for piece in pieces),
            "lasting_s": float(np.median([np.sum(piece > threshold) for piece in pieces])) / TRIBOMETER_HZ,
        }


def on_quiet(interval_s: float) -> dict[str, Any]:
    """False alarms of thresholds that `calibrate` sets for an interval, on recordings that it did not hear: one half of
    the drags for the other, and each material for the other five."""
    found: dict[str, Any] = {"interval_s": interval_s}
    kept = [drag for half in ("choosing", "judging") for drag in drags(half)]
    cuts: Mapping[str, Callable[[Drag], str]] = {
        "half": lambda drag: str(int(drag.name.split("_")[1]) % 4),
        "material": lambda drag: drag.name.split("_")[0],
    }
    for name, cut in cuts.items():
        alarms, heard_s = 0, 0.0
        for left_out in sorted({cut(drag) for drag in kept}):
            others = [_quiet(drag) for drag in kept if cut(drag) != left_out]
            threshold = calibrate_pieces(others, interval_s).threshold
            for drag in kept:
                if cut(drag) == left_out:
                    maxima = np.concatenate(
                        [span_maxima(c.statistic, c.rate_hz) for c in courses_of(*_quiet(drag))]
                    )
                    alarms += int(np.sum(maxima > threshold))
                    heard_s += float(len(maxima))
        expected = heard_s / interval_s
        low, high = (end / expected for end in poisson_interval(alarms))
        found[name] = {"alarms": alarms, "expected": expected, "ratio_low": low, "ratio_high": high}
    return found


def _quiet(drag: Drag) -> tuple[SlipDetector, list[SampleBlock]]:
    """Ours, and what `calibrate` hears of a drag: its end, where the finger hangs in the air."""
    values = drag.pressure[drag.lost + round(MARGIN_S * BIOTAC_HZ) :, None]
    detector = SlipDetector("slip", SlipSettings())
    return detector, [SampleBlock("board.tangential", 0, 0.0, values, rate_hz=BIOTAC_HZ)]


def at_reset() -> dict[str, int]:
    """Drags of the judging half that slip while ours learns, with the quiet level of their own end stored."""
    refused = told = 0
    chosen = drags("judging")
    for drag in chosen:
        level = _pushed(drag.pressure[drag.lost + round(MARGIN_S * BIOTAC_HZ) :], BIOTAC_HZ, None)
        slipping = drag.pressure[round(BIOTAC_HZ) : round(2.5 * BIOTAC_HZ)]
        said = _pushed(slipping, BIOTAC_HZ, level[0].value)
        refused += any(isinstance(event, BaselineRefused) for event in said)
        told += bool(said)
    return {"drags": len(chosen), "refused": refused, "something_said": told}


# --- simulated -----------------------------------------------------------------------------------


def on_step(kind: str, rate_hz: float, factor: float) -> Iterator[dict[str, Any]]:
    """How often ours calls a step of the noise a slip, and for how long."""
    n = round(scenes.STEP_S * rate_hz)
    after = [
        _ours()(scenes.stepped(kind, rate_hz, factor, seed), rate_hz)[n:]
        for seed in range(SEED_STEPS, SEED_STEPS + STEPS_EACH)
    ]
    for threshold in THRESHOLDS:
        ends = [np.flatnonzero(each > threshold) for each in after]
        yield {
            "kind": kind,
            "rate_hz": rate_hz,
            "factor": factor,
            "threshold": threshold,
            "alarmed": sum(bool(above.size) for above in ends),
            "longest_s": max((above[-1] / rate_hz for above in ends if above.size), default=0.0),
        }


def in_contact(nuisance: str) -> Iterator[dict[str, Any]]:
    """Share of the time in contact without slip in which ours says slip, from the touch on; each sensor once for each
    structure that is off."""
    for sensor in SENSORS:
        heard = []
        for number, factors in enumerate(scenes.OFF):
            settings = scenes.sensor(sensor, nuisance, *factors)
            rolls = nuisance.startswith("rolling")
            values, touch, slid = scenes.contact(settings, SEED_QUIET + number, scenes.FIRM_M, rolls=rolls)
            if slid:
                raise RuntimeError(f"{sensor}, {nuisance}: it slipped")
            heard.append((values, touch, settings.rate_hz))
        for threshold in THRESHOLDS:
            slipping_s = sum(
                _slipping_s(values, touch, rate_hz, threshold) for values, touch, rate_hz in heard
            )
            share = slipping_s / (len(heard) * scenes.CONTACT_S)
            yield {"sensor": sensor, "nuisance": nuisance, "threshold": threshold, "share": share}


def _slipping_s(values: Floats, touch: int, rate_hz: float, threshold: float) -> float:
    """How long ours says slip after the touch."""
    detector = SlipDetector("slip", SlipSettings(threshold=threshold))
    said = detector.push(SampleBlock("board.tangential", 0, 0.0, values[:, None], rate_hz=rate_hz))
    edges = [e.t_s for e in said if isinstance(e, SlipStarted | SlipEnded)]
    edges += [len(values) / rate_hz] * (len(edges) % 2)
    begin_s = touch / rate_hz
    return sum(max(0.0, off - max(on, begin_s)) for on, off in zip(edges[::2], edges[1::2], strict=True))


def at_simulated_reset() -> Iterator[dict[str, Any]]:
    """A table that moves under the tip while ours learns, with the quiet level of the air stored."""
    for sensor in SENSORS:
        said = refused = 0
        for number, factors in enumerate(scenes.OFF * 5):
            settings = scenes.sensor(sensor, "table moves", *factors)
            values, touch, _ = scenes.contact(settings, SEED_SLIP + number, scenes.LIGHT_M, rolls=False)
            learned = _pushed(values[:touch], settings.rate_hz, None)
            begin = touch + round(0.5 * settings.rate_hz)
            events = _pushed(values[begin : begin + touch], settings.rate_hz, learned[0].value)
            said += bool(events)
            refused += any(isinstance(event, BaselineRefused) for event in events)
        yield {"sensor": sensor, "slips": number + 1, "refused": refused, "something_said": said}


def _pushed(values: Floats, rate_hz: float, quiet_rms: float | None) -> Sequence[Any]:
    """What ours says of a stretch."""
    detector = SlipDetector("a", SlipSettings(quiet_rms=quiet_rms))
    return detector.push(SampleBlock("board.tangential", 0, 0.0, values[:, None], rate_hz=rate_hz))


def simulated(sensor: str, nuisance: str, hours: float, count: int) -> list[dict[str, Any]]:
    """Every detector on one sensor under one nuisance: one false alarm an hour, the first seconds included."""
    plants = [scenes.sensor(sensor, nuisance, *factors) for factors in scenes.OFF]
    rate_hz = plants[0].rate_hz
    chosen = judges()
    maxima: dict[str, list[Floats]] = {name: [] for name in chosen}
    for number, plant in enumerate(plants):
        for values in scenes.recordings(plant, hours / len(plants), SEED_QUIET + number):
            for name, judge in chosen.items():
                maxima[name].append(span_maxima(judge(values[:, 0], rate_hz), rate_hz))
    found = {name: threshold_for(np.concatenate(parts), 3600.0) for name, parts in maxima.items()}
    rows = []
    for ramp in (False, True) if nuisance == "clean" else (False,):
        trials = [
            trial
            for number, plant in enumerate(plants)
            for trial in scenes.slips(plant, count // len(plants), SEED_SLIP + number, ramp=ramp)
            if trial.onset is not None
        ]
        for name, judge in chosen.items():
            delays, early = [], 0
            for trial in trials:
                assert trial.onset is not None
                statistic = judge(trial.values[:, 0], rate_hz)
                if math.isfinite(_first_above(statistic[trial.start : trial.onset], found[name].threshold)):
                    early += 1
                delay_s = _first_above(statistic[trial.onset :], found[name].threshold) / rate_hz
                delays.append(delay_s if delay_s <= MISSED_S else math.inf)
            rows.append(
                {
                    "sensor": sensor,
                    "nuisance": "ramp" if ramp else nuisance,
                    "detector": name,
                    "threshold": found[name].threshold,
                    "extrapolated": found[name].extrapolated,
                    "early": early,
                    "delays_s": delays,
                }
            )
    return rows


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
    """Run all of it; writes results/slip.json. Each simulated part is kept in build/slip_study: a run that
    broke off goes on; take that away after a change of a detector."""
    count, known = 8 if quick else TRIALS, bool(drags("judging"))
    parts = [(sensor, nuisance) for nuisance in NUISANCES for sensor in SENSORS]
    parts += [(SENSORS[0], nuisance) for nuisance in MORE]
    study: dict[str, Any] = {
        "drags": _beside_ours([{"detector": each, **on_drags(judge)} for each, judge in judges().items()])
        if known
        else [],
        "tribometer": [row for threshold in THRESHOLDS for row in on_tribometer(threshold)],
        "blows": [
            {"detector": name, **row}
            for name, judge in judges().items()
            for given in (((), THRESHOLDS) if name == OURS else ((),))
            for row in on_blows(judge, given)
        ],
        "at_reset": at_reset() if known else None,
        "quiet": [on_quiet(interval_s) for interval_s in INTERVALS_S] if known else [],
        "at_simulated_reset": list(at_simulated_reset()),
        "steps": [
            row
            for kind in ("white", "hum", "converter")
            for rate_hz in (1000.0, 2200.0, 10_000.0)
            for factor in STEPS
            for row in on_step(kind, rate_hz, factor)
        ],
        "contact": [row for nuisance in CONTACTS for row in in_contact(nuisance)],
        "hours": HOURS,
        "simulated": _summarized([row for part in parts for row in _kept(*part, count)]),
    }
    save("slip", study, quick=quick)


def _kept(sensor: str, nuisance: str, count: int) -> list[dict[str, Any]]:
    """A simulated part, from the disk where it is known."""
    path = Path("build/slip_study") / f"{sensor}_{nuisance}_{count}.json"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        begun = path.with_suffix(".begun")
        begun.write_text(json.dumps(simulated(sensor, nuisance, HOURS, count)), encoding="utf-8")
        begun.rename(path)
    found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return found


if __name__ == "__main__":
    main()
