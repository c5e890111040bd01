"""Delay against false alarms an hour, of every detector on every signal: `python -m benchmarks curves [--quick]`.

Thresholds for 1, 10 and 100 false alarms an hour are set, as `calibrate` does, on the quiet of all groups of a signal
but one, and judged on that one: a group is a material, a run, a structure, or a fold of fresh seeds. The drags that
constants were chosen on are left out. Recordings need `make recordings`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks import pretouch, slip
from benchmarks.beam import BAND_HZ, MOTOR_S, TRACKERS, steps
from benchmarks.beam import RATE_HZ as BEAM_HZ
from benchmarks.pretouch_rooms import commanded
from benchmarks.recordings import (
    ARM_HZ,
    BIOTAC_HZ,
    TRIBOMETER_HZ,
    drags,
    load,
    splice,
    struck,
)
from benchmarks.results import kept, save
from controller.characterize import AFTER_S, AN_HOUR, DELAY_S, EARLY_S, delays_at
from controller.detectors.calibration import poisson_interval, span_in, span_maxima, threshold_for
from controller.detectors.level import LevelDetector, LevelPaperDetector, LevelPaperSettings, LevelSettings
from controller.detectors.onset import OnsetDetector, OnsetSettings
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings
from controller.detectors.threshold import ForceThresholdDetector, ForceThresholdSettings
from drivers.core.messages import Floats
from simulator.physics.aura_settings import NOTHING, SIDES, SIX

Course = tuple[Floats, Floats]
"""Times since an event, from `EARLY_S` before it to `AFTER_S` after it, s, and the statistic."""


class Heard(NamedTuple):
    """A detector's statistic in a stretch of quiet, shape (n,), its rate, and the course of each event."""

    quiet: Floats
    rate_hz: float
    events: Sequence[Course]


Groups = Mapping[str, Sequence[Heard]]
"""By what is left out in turn."""


def around(statistic: Floats, rate_hz: float, at: float) -> Course:
    """The course around an event at a sample, which may lie between two."""
    begin, end = max(0, math.ceil(at - EARLY_S * rate_hz)), math.ceil(at + AFTER_S * rate_hz)
    part = statistic[begin:end]
    since: Floats = (np.arange(begin, begin + len(part), dtype=np.float64) - at) / rate_hz
    return since, part


def curve(groups: Groups) -> Iterator[dict[str, Any]]:
    """A row for each rate: delays of all events at thresholds of other groups, and false alarms in their own quiet."""
    decided = {
        name: sum(int(np.sum(~np.isnan(each.quiet))) / each.rate_hz for each in heard)
        for name, heard in groups.items()
    }
    span_s = span_in(sum(decided.values()))
    maxima = {
        name: np.concatenate([span_maxima(each.quiet, each.rate_hz, span_s) for each in heard])
        for name, heard in groups.items()
    }
    for an_hour in AN_HOUR:
        courses, thresholds, alarms, extrapolated = [], [], 0, False
        for left_out, heard in groups.items():
            others = np.concatenate([each for name, each in maxima.items() if name != left_out])
            found = threshold_for(others, 3600.0 / an_hour, span_s)
            thresholds.append(found.threshold)
            extrapolated |= found.extrapolated
            alarms += int(np.sum(maxima[left_out] > found.threshold))
            # one threshold for all: statistics are shown relative to their group's
            courses += [(since, each / found.threshold) for part in heard for since, each in part.events]
        hours = sum(map(len, maxima.values())) * span_s / 3600.0
        delays = delays_at(courses, 1.0)
        yield {
            "an_hour": an_hour,
            "threshold": float(np.median(thresholds)),
            "extrapolated": extrapolated,
            "quiet_s": 3600.0 * hours,
            "alarms": alarms,
            "alarms_an_hour": [end / hours for end in (alarms, *poisson_interval(alarms))],
            **delays._asdict(),
        }


Rival = slip.Rival


def knock_judges() -> dict[str, Rival]:
    """Of what strikes a sensor: ours for knocks and forces, and the rivals of slip."""
    chosen = slip.judges()
    names = ("high-pass RMS, 10 ms, over own quiet", "AR(16) residual, GLR", "AR(16) residual, CUSUM")
    return {
        "onset": lambda x, hz: OnsetDetector("onset", OnsetSettings()).statistic(x[:, None], hz),
        "force.threshold": lambda x, hz: ForceThresholdDetector("force", ForceThresholdSettings()).statistic(
            x[:, None], hz
        ),
        **{name: chosen[name] for name in names},
    }


def on_biotac(judge: Rival) -> Groups:
    """Drags of the judging half by material: the quiet after each, then its slip."""
    groups: dict[str, list[Heard]] = {}
    for drag in drags("judging"):
        whole = splice(drag)
        found = judge(whole.values, BIOTAC_HZ)
        heard = Heard(found[: whole.onset], BIOTAC_HZ, [around(found, BIOTAC_HZ, whole.onset)])
        groups.setdefault(drag.name.split("_")[0], []).append(heard)
    return groups


def on_blows(judge: Rival) -> Groups:
    """Blows to a force sensor by run; quiet is what is neither within 50 ms before one nor half a second after it."""
    groups = {}
    for name, x in (load("blows") or {}).items():
        found = judge(x, TRIBOMETER_HZ)
        begins = struck(x)
        quiet = found.copy()
        for begin in begins:
            quiet[begin - round(0.05 * TRIBOMETER_HZ) : begin + round(0.5 * TRIBOMETER_HZ)] = np.nan
        # it crosses `BLOW_V` about 0.8 ms after it began (benchmarks/results/onset.md)
        events = [around(found, TRIBOMETER_HZ, begin - 8) for begin in begins if begin > TRIBOMETER_HZ]
        groups[name] = [Heard(quiet, TRIBOMETER_HZ, events)]
    return groups


def on_arm(judge: Rival) -> Groups:
    """Impacts of an arm on a force sensor, by run; quiet is the air before. The impact is where the force leaves what
    it was in the first 0.3 s by eight deviations."""
    groups = {}
    for name, x in (load("arm") or {}).items():
        found, rest = judge(x, ARM_HZ), x[: round(0.3 * ARM_HZ)]
        hit = int(np.argmax(np.abs(x - np.median(rest)) > 8.0 * rest.std()))
        quiet = found[: hit - round(EARLY_S * ARM_HZ)]
        groups[name] = [Heard(quiet, ARM_HZ, [around(found, ARM_HZ, hit)])]
    return groups


def on_beam(tracker: Callable[[Floats], Floats]) -> Groups:
    """Steps of a beam's support by run; quiet is each rest after its first 0.6 s."""
    groups: dict[str, list[Heard]] = {}
    for step in steps():
        with np.errstate(all="ignore"):
            found = tracker(step.x)
        margin = round(MOTOR_S * BEAM_HZ)
        rest = found if step.step is None else found[: step.step - margin]
        events = [] if step.step is None else [around(found, BEAM_HZ, step.step)]
        groups.setdefault(step.run, []).append(Heard(rest, BEAM_HZ, events))
    return groups


SEED_QUIET, SEED_SLIP = 9_000, 9_100
"""Of simulated slip: nothing else was chosen or judged on these."""


def on_simulated(sensor: str, nuisance: str, hours: float, count: int) -> dict[str, list[dict[str, Any]]]:
    """A simulated sensor's slips, by the structure that is off; of each detector its curve."""
    found: dict[str, dict[str, list[Heard]]] = {name: {} for name in slip.judges()}
    for number, factors in enumerate(slip.OFF):
        plant = slip.sensor_off(sensor, nuisance, *factors)
        hz = plant.rate_hz
        quiet = [x[:, 0] for x in slip.recordings(plant, hours / len(slip.OFF), SEED_QUIET + number)]
        trials = list(slip.slips(plant, count // len(slip.OFF), SEED_SLIP + number))
        for name, judge in slip.judges().items():
            events = []
            for trial in trials:
                if trial.onset is not None:
                    events.append(around(judge(trial.values[:, 0], hz), hz, trial.onset))
            group = [Heard(judge(x, hz), hz, []) for x in quiet]
            found[name][str(number)] = [*group, Heard(np.empty(0), hz, events)]
    return {name: list(curve(groups)) for name, groups in found.items()}


SEED_SONIC = 81_000
KINDS: Sequence[pretouch.Kind] = ("nothing", "near", "touch")


STEP_S, REST_S = 0.016, 0.3
"""Of the rival of `level`: as long as its own longest span, and its rest. Over the half second before instead of the
rest the rival tells none of 200 touches."""


def steps_over_rest(values: Floats, rate_hz: float) -> Floats:
    """How far I and Q have gone in 16 ms, over the root mean square of that in the first 0.3 s; NaN in these."""
    n, rest = round(STEP_S * rate_hz), round(REST_S * rate_hz)
    gone = np.zeros(len(values))
    gone[n:] = np.hypot(*(values[n:, :2] - values[:-n, :2]).T)
    gone /= math.sqrt(float(np.mean(gone[n:rest] ** 2)))
    gone[:rest] = np.nan
    return gone


def on_sonic(count: int) -> dict[str, list[dict[str, Any]]]:
    """Passages of a sonic finger with the plant's own echo, in four folds. Contact: delay from the touch; quiet are
    passages before nothing and to 0.4 cm from the object. Pre-touch: how far away the object is when it is seen
    (`median_gap_m`, `p90_gap_m`); quiet are passages before nothing."""
    contacts: dict[str, Callable[[Floats, float], Floats]] = {
        "level": LevelDetector("level", LevelSettings()).statistic,
        **{
            f"level.paper, {window_s:g} s": LevelPaperDetector(
                "paper", LevelPaperSettings(window_s=window_s)
            ).statistic
            for window_s in (0.5, 2.0, 5.0)
        },
        "steps of 16 ms over own rest": steps_over_rest,
    }
    nears: dict[str, Callable[[Floats, float], Floats]] = {
        "pretouch": PreTouchDetector("pretouch", PreTouchSettings()).statistic,
        **{
            f"pretouch.paper, {window_s:g} s": PreTouchPaperDetector(
                "paper", PreTouchPaperSettings(window_s=window_s)
            ).statistic
            for window_s in (0.25, 0.5)
        },
    }
    at_speed = "I and Q at the commanded speed, 2"
    names, hz = [*contacts, *nears, at_speed], pretouch.RATE_HZ
    found: dict[str, dict[str, list[Heard]]] = {name: {str(k): [] for k in range(4)} for name in names}
    for number in range(count):
        side, speed_m_s = SIDES[number // 2 % 5], pretouch.SPEEDS_M_S[number % 2]
        nears[at_speed] = lambda x, hz, m_s=speed_m_s: commanded(x[:, 0] + 1j * x[:, 1], m_s, 2)  # type: ignore[misc]
        for kind in KINDS:
            thing = NOTHING if kind == "nothing" else SIX[number // 10 % 6]
            record = pretouch.passage(pretouch.Event(SEED_SONIC, number, kind, thing, side, speed_m_s))
            values = np.column_stack([record.z.real, record.z.imag, record.position_m])
            heard = {name: Heard(np.empty(0), hz, []) for name in names}
            for name, judge in contacts.items():
                s = judge(values[:, :2], hz)
                heard[name] = Heard(s, hz, [])
                if record.touched is not None:
                    heard[name] = Heard(np.empty(0), hz, [around(s, hz, record.touched)])
            for name, judge in nears.items() if kind != "touch" else ():
                s = judge(values, hz)
                if kind == "nothing":
                    heard[name] = Heard(s[record.begun :], hz, [])
                else:
                    come = slice(record.begun, record.arrived)
                    heard[name] = Heard(np.empty(0), hz, [(pretouch.START_M - record.gap_m[come], s[come])])
            for name in names:
                found[name][str(number % 4)].append(heard[name])
    curves = {name: list(curve(groups)) for name, groups in found.items()}
    for name in nears:
        for row in curves[name]:
            for key in ("median", "p90"):
                row[f"{key}_gap_m"] = [pretouch.START_M - each for each in row.pop(f"{key}_s")]
    return curves


RECORDED: Mapping[str, tuple[Callable[[], Mapping[str, Any]], Callable[[Any], Groups]]] = {
    "BioTac, drags of the judging half, a material left out": (slip.judges, on_biotac),
    "blows to a force sensor, a run left out": (knock_judges, on_blows),
    "an arm's impacts, a run left out": (knock_judges, on_arm),
    "beam, steps up or down, a run left out": (lambda: TRACKERS, on_beam),
}


def main(quick: bool = False) -> None:
    """Run the study; writes results/curves.json. Simulated parts are kept: an interrupted run continues."""
    rows: list[dict[str, Any]] = []

    def add(signal: str, found: Mapping[str, Sequence[dict[str, Any]]]) -> None:
        for name, curves in found.items():
            rows.extend({"signal": signal, "detector": name, **row} for row in curves)

    for signal, (judges, groups) in RECORDED.items():
        for name, judge in judges().items():
            made = groups(judge)
            try:
                add(signal, {name: list(curve(made))} if made else {})
            except ValueError as error:
                rows.append({"signal": signal, "detector": name, "refused": str(error)})
    hours, count = (0.7, 8) if quick else (4.0 / 3.0, 200)
    for sensor in slip.SENSORS:
        for nuisance in ("clean", "bumps"):
            part = partial(on_simulated, sensor, nuisance, hours, count)
            add(f"simulated {sensor}, {nuisance}", kept(f"curves_{sensor}_{nuisance}_{count}", part))
    some = 20 if quick else 400
    add("simulated sonic finger, passages", kept(f"curves_sonic_{some}", partial(on_sonic, some // 2)))
    save("curves", {"within_s": DELAY_S, "band_hz": BAND_HZ, "rows": rows}, quick=quick)
