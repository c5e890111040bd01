"""Detectors on public recordings: `benchmarks.recordings` fetches them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.recordings import BIOTAC_HZ, MARGIN_S, TRIBOMETER_HZ, Drag, drags, load
from benchmarks.slip.rivals import LEARN_S, OURS, Rival
from benchmarks.slip.scoring import MISSED_S, THRESHOLDS, called, first_above, refusals
from controller.detectors.calibration import (
    calibrate_pieces,
    courses_of,
    poisson_interval,
    span_maxima,
)
from controller.detectors.slip import SlipDetector, SlipSettings
from controller.reports.counts import wilson
from drivers.messages import SampleBlock

Floats = NDArray[np.float64]


class Splice(NamedTuple):
    """A drag's own quiet, and then its slip.

    Attributes:
        values: Shape (n,).
        onset: Where slip begins: at a sample within the quiet's own range, so that the cut makes no step.
        reversed: The drag played backwards: quiet, and slip as it comes. The sensor is the same; a slip that dies away
            becomes one that grows.
        reversed_onset: Where its electrodes show contact.
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


def on_drags(judge: Rival) -> dict[str, Any]:
    """The threshold from the choosing half's quiet, one false alarm a minute; delays on the judging half."""
    quiet = [s.values[: s.onset] for s in map(splice, drags("choosing"))]
    maxima = np.sort(np.concatenate([_maxima(judge(each, BIOTAC_HZ), BIOTAC_HZ) for each in quiet]))[::-1]
    decided_s = sum(len(each) / BIOTAC_HZ - LEARN_S for each in quiet)
    threshold = float(maxima[max(1, round(decided_s / 60.0))])
    delays, early, alarms, judged_s = [], 0, 0, 0.0
    for each in map(splice, drags("judging")):
        found = judge(each.values, BIOTAC_HZ)
        alarms += int(np.sum(_maxima(found[: each.onset], BIOTAC_HZ) > threshold))
        judged_s += each.onset / BIOTAC_HZ - LEARN_S
        delay_s = first_above(found[each.onset :], threshold) / BIOTAC_HZ
        delays.append(delay_s if delay_s <= MISSED_S else math.inf)
        first = first_above(judge(each.reversed, BIOTAC_HZ), threshold)
        early += (first - each.reversed_onset) / BIOTAC_HZ < -MARGIN_S
    return {
        "threshold": threshold,
        "judged_min": judged_s / 60.0,
        "alarms": alarms,
        "early": int(early),
        "delays_s": delays,
    }


RESTS_S, TOUCH_S, LOADED_S, MOVES_S, LETS_GO_S, STANDS_S = (1.0, 2.2), 3.207, (3.95, 4.48), 4.528, 4.573, 7.01
LIFTS_S = 7.3
"""On the tribometer: quiet in the air, before the servo hums; contact; quiet and loaded; the stage moves; the lateral
force drops; the stage stands; shortly before the finger is lifted."""


def on_tribometer(name: str, judge: Rival) -> Iterator[dict[str, Any]]:
    """Results of a detector for the finger on a tribometer: at the largest value of its rest, and ours at thresholds
    from elsewhere as well."""
    recorded = load("tribometer")
    for column, channel in ((0, "lateral force"), (2, "vibration")) if recorded else ():
        assert recorded is not None
        values = recorded["run"][:, column]
        statistic = judge(values, TRIBOMETER_HZ)
        rest = float(np.nanmax(_between(statistic, *RESTS_S)))
        for threshold in (rest, *(THRESHOLDS if name == OURS else ())):
            slipping = called(name, values, statistic, TRIBOMETER_HZ, threshold)
            moving = _between(slipping, MOVES_S, LIFTS_S)
            turns = np.flatnonzero(np.diff(slipping)) + 1
            yield {
                "detector": name,
                "channel": channel,
                "threshold": threshold,
                "before_touch_s": float(_between(slipping, RESTS_S[1], TOUCH_S).sum() / TRIBOMETER_HZ),
                "loaded_s": float(_between(slipping, *LOADED_S).sum() / TRIBOMETER_HZ),
                "reported_s": MOVES_S + first_above(moving.astype(float), 0.5) / TRIBOMETER_HZ,
                "share_of_slip": float(_between(slipping, LETS_GO_S, STANDS_S).mean()),
                "off_s": MOVES_S + float(np.max(np.flatnonzero(moving), initial=-1) + 1) / TRIBOMETER_HZ,
                "reported": [
                    f"{'on' if slipping[i] else 'off'} {i / TRIBOMETER_HZ:.3f}" for i in turns.tolist()
                ]
                if name == OURS
                else None,
            }


def _between(values: NDArray[Any], begin_s: float, end_s: float) -> NDArray[Any]:
    """A stretch of the tribometer's run."""
    return values[round(begin_s * TRIBOMETER_HZ) : round(end_s * TRIBOMETER_HZ)]


BLOW_V, APART_S, AFTER_S = 0.15, 0.3, 0.5
"""A blow to the force sensor is beyond this, some 50 times its noise; the next is as far away at least; events in
the time after it are attributed to the blow."""


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
            after = slice(begin, begin + round(AFTER_S * TRIBOMETER_HZ))
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
    """False alarms of thresholds that `calibrate` sets for an interval, on other recordings: one half of
    the drags for the other, and each material for the other five."""
    found: dict[str, Any] = {"interval_s": interval_s}
    kept = [drag for half in ("choosing", "judging") for drag in drags(half)]
    cuts: Mapping[str, Callable[[Drag], str]] = {
        "half": lambda drag: str(int(drag.name.split("_")[1]) % 4),
        "material": lambda drag: drag.name.split("_")[0],
    }
    for name, cut in cuts.items():
        alarms, decided_s = 0, 0.0
        for left_out in sorted({cut(drag) for drag in kept}):
            others = [_quiet(drag) for drag in kept if cut(drag) != left_out]
            threshold = calibrate_pieces(others, interval_s).threshold
            for drag in kept:
                if cut(drag) == left_out:
                    maxima = np.concatenate(
                        [span_maxima(c.statistic, c.rate_hz) for c in courses_of(*_quiet(drag))]
                    )
                    alarms += int(np.sum(maxima > threshold))
                    decided_s += float(len(maxima))
        expected = decided_s / interval_s
        low, high = (end / expected for end in poisson_interval(alarms))
        found[name] = {"alarms": alarms, "expected": expected, "ratio_low": low, "ratio_high": high}
    return found


def _quiet(drag: Drag) -> tuple[SlipDetector, list[SampleBlock]]:
    """Ours, and the part of a drag for `calibrate`: its end, where the finger hangs in the air."""
    values = drag.pressure[drag.lost + round(MARGIN_S * BIOTAC_HZ) :, None]
    detector = SlipDetector("slip", SlipSettings())
    return detector, [SampleBlock("board.tangential", 0, 0.0, values, rate_hz=BIOTAC_HZ)]


def at_reset(name: str, judge: Rival, threshold: float) -> Iterator[dict[str, Any]]:
    """Drags of the judging half that slip while a detector starts, and go on: how many it then detects. Ours as well
    with the quiet level of their own end stored."""
    chosen = drags("judging")
    slipping = [drag.pressure[round(BIOTAC_HZ) : round(2.5 * BIOTAC_HZ)] for drag in chosen]
    detected = sum(math.isfinite(first_above(judge(each, BIOTAC_HZ), threshold)) for each in slipping)
    yield {
        "detector": name,
        "stored": False,
        "slips": len(chosen),
        "detected": detected,
        "detected_95": wilson(detected, len(chosen)),
    }
    if name == OURS:
        quiet = [drag.pressure[drag.lost + round(MARGIN_S * BIOTAC_HZ) :] for drag in chosen]
        yield {"detector": name, **refusals(quiet, slipping, BIOTAC_HZ)}
