"""Slip detectors at equal false alarms, on recordings and simulated: `python -m benchmarks slip [--quick]`.

The paper's, ours, and textbook rivals, each a function from a recording to a statistic; all are causal, none knows the
sensor. Thresholds come from quiet that is not judged. Settings of ours were chosen on the choosing half of the
recordings and on simulated seeds from 40,000 on. What is reported is the judging half, seeds from 8,000 to 8,300, and
the blows, which chose nothing.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi

from behaviors.events import BaselineRefused, Detected, SlipEnded, SlipStarted
from benchmarks.results import kept, save
from controller.detectors.calibration import span_maxima, threshold_for
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.reports.counts import wilson
from drivers.core.messages import Floats, SampleBlock
from simulator.physics.slip import SENSORS as PLANTS
from simulator.physics.slip import SlipNuisances, SlipPlant, SlipPlantSettings

Bools = NDArray[np.bool_]

OFF = ((0.7, 3.0), (1.3, 1.0 / 3.0), (0.7, 1.0 / 3.0), (1.3, 3.0))
"""Factors on frequency and damping of the structure that the detectors are scored on: 30 % and 3 either way."""

NUISANCES: Mapping[str, Mapping[str, Any]] = {
    "clean": {},
    "bumps": {"bumps_hz": 1.0},
    "loads": {"loads_hz": 0.5},
    "tails": {"nuisances": SlipNuisances(tails=1.4)},
    "tremor": {"nuisances": SlipNuisances(tremor_n=0.05)},
    "smooth": {"nuisances": SlipNuisances(smoothness=10.0)},
    "bouncing": {"bumps_hz": 0.2, "nuisances": SlipNuisances(bounces=3)},
    "impacts": {"bumps_hz": 0.2, "nuisances": SlipNuisances(bounces=3, tremor_n=0.05)},
    "rolling, 0.6 N": {"rolling_n": 0.6},
    "rolling, 1 N": {"rolling_n": 1.0},
    "rolling, 2 N": {"rolling_n": 2.0},
    "table moves": {"nuisances": SlipNuisances(table_m_s=0.01)},
    "noise of 0.1 steps": {"nuisances": SlipNuisances(converter=10.0)},
    "noise of 0.2 steps": {"nuisances": SlipNuisances(converter=5.0)},
    "noise of 0.3 steps": {"nuisances": SlipNuisances(converter=1.0 / 0.3)},
}
"""What is different from rolling on a smooth table under the sensor's noise. Bumps are exponential, 1.5 slip events in
the mean, load steps of 0.3 to 1 V; steps are those of the converter."""

COARSE = tuple(name for name in NUISANCES if name.endswith("steps"))

DRIFTS_HZ = (0.02, 0.1, 0.5)
"""Of a coarse sensor at rest, steps of its converter a second."""

SPEED_M_S = 0.01
"""Of the slip. Assumption: the paper prints none."""

PRELOAD = 0.85
RAMP_PRELOAD = 0.98
"""Share of the mean friction that the tip already carries when the arm starts: rolling has loaded it. Assumption;
for the ramp almost all of it, so that the slip begins while the arm is slow."""

START_S = 0.03
RAMP_S = 0.05
"""How long the arm takes to its speed: smoothly (assumption), and linearly for the 50 ms ramp."""

RECORDING_S = 600.0
"""Length of one recording without slip; each has its own key."""

BEFORE_S = 3.0
AFTER_S = 1.0
"""Of a slip trial: before the arm starts and after."""

FIRM_M = 0.01
LIGHT_M = 0.001
"""How far the arm presses: firmly where nothing may slip, as the paper does where something shall."""


def sensor_off(name: str, nuisance: str, frequency: float = 1.0, damping: float = 1.0) -> SlipPlantSettings:
    """A sensor of the paper, its last bridge alone, under a nuisance, its structure off by these factors.

    The stiffness stays; the mass changes.
    """
    base = PLANTS[name]
    structure = {"mode_hz": base.mode_hz * frequency, "mass_kg": base.mass_kg / frequency**2}
    other = {"bridges": base.bridges[-1:], "damping_ratio": base.damping_ratio * damping}
    return base.model_copy(update={**structure, **other, **NUISANCES[nuisance]})


def recordings(settings: SlipPlantSettings, hours: float, seed: int) -> Iterator[Floats]:
    """Recordings without slip, shape (n, 1) each; the arm rolls to and fro all the time."""
    plant = SlipPlant(settings)
    n = round(RECORDING_S * settings.rate_hz)
    t_s = np.arange(1, n + 1) / settings.rate_hz
    roll_rad = 0.5 * np.abs((t_s / 10.0) % 2.0 - 1.0)
    for number in range(round(hours * 3600.0 / RECORDING_S)):
        plant.begin(key=(seed, number), press_m=FIRM_M)
        values = plant.advance(np.zeros(n), np.full(n, FIRM_M), roll_rad)
        if np.ptp(plant.slid_m) != 0.0:
            raise RuntimeError("a recording without slip slipped: press harder")
        yield values


def drifting(settings: SlipPlantSettings, hours: float, seed: int) -> Iterator[Floats]:
    """Recordings of a sensor at rest that drifts slowly over the codes of its converter, shape (n, 1) each."""
    noise, t_s = (
        settings.bridges[-1].noise,
        np.arange(round(RECORDING_S * settings.rate_hz)) / settings.rate_hz,
    )
    step = settings.nuisances.converter * noise
    for number in range(round(hours * 3600.0 / RECORDING_S)):
        rng = np.random.default_rng((seed, number))
        place = rng.uniform() + DRIFTS_HZ[number % len(DRIFTS_HZ)] * t_s
        yield step * np.round(place + noise / step * rng.standard_normal(t_s.size))[:, None]


def thinned(values: Floats, lost: float, seed: int) -> Floats:
    """Samples, shape (n,), of which this share is lost at random: NaN."""
    found: Floats = np.where(
        np.random.default_rng((seed, len(values))).random(len(values)) < lost, np.nan, values
    )
    return found


def joined(values: Floats) -> Floats:
    """Lost samples lie on a straight line between their neighbours: what a filter that takes no gap is given."""
    known = np.flatnonzero(np.isfinite(values))
    found: Floats = np.interp(np.arange(len(values)), known, values[known])
    return found


STEP_S = 4.0
"""Before a step of the noise, and after."""


def stepped(kind: str, rate_hz: float, factor: float, seed: int) -> Floats:
    """The fingertip in the air while its noise steps: white, hum of one sine from 50 to 500 Hz that is switched on, or
    noise below a converter's step."""
    hum_hz = float(np.random.default_rng(seed).uniform(50.0, min(500.0, 0.4 * rate_hz)))
    changes: Mapping[str, dict[str, Any]] = {
        "white": {"noise_factor": factor},
        "hum": {"hum": math.sqrt(factor**2 - 1.0), "hum_hz": (hum_hz,)},
        "converter": {"noise_factor": factor, "converter": 2.0},
    }
    nuisances = SlipNuisances.model_validate({"change_s": STEP_S, **changes[kind]})
    settings = sensor_off("fingertip", "clean").model_copy(
        update={"rate_hz": rate_hz, "nuisances": nuisances}
    )
    plant = SlipPlant(settings)
    plant.begin(key=(seed, 0), press_m=-LIGHT_M)
    n = round(2.0 * STEP_S * rate_hz)
    values: Floats = plant.advance(np.zeros(n), np.full(n, -LIGHT_M), np.zeros(n))[:, 0]
    return values


AIR_S, CONTACT_S = 3.0, 60.0
"""In the air, where a detector learns, and then in contact."""


def contact(settings: SlipPlantSettings, seed: int, press_m: float, rolls: bool) -> tuple[Floats, int, bool]:
    """A tip that is lowered to the table and stays: its signal, the sample of the touch, and whether it slid."""
    plant = SlipPlant(settings)
    touch = round(AIR_S * settings.rate_hz)
    n = touch + round(CONTACT_S * settings.rate_hz)
    press = np.where(np.arange(n) < touch, -LIGHT_M, press_m)
    t_s = np.arange(1, n + 1) / settings.rate_hz
    roll_rad = 0.5 * np.abs((t_s / 10.0) % 2.0 - 1.0) if rolls else np.zeros(n)
    plant.begin(key=(seed, 0), press_m=-LIGHT_M, roll_rad=float(roll_rad[0]))
    values = plant.advance(np.zeros(n), press, roll_rad)[:, 0]
    return values, touch, bool(np.ptp(plant.slid_m[touch + 1 :]) > 0.0)


class SlipTrial(NamedTuple):
    """One slip trial: the sensor's signal, shape (n, 1), the sample at which the arm starts, that at which the contact
    has first moved after that (None where it never does), and whether a push had moved it before, and it held again."""

    values: Floats
    start: int
    onset: int | None
    moved_before: bool


def slips(settings: SlipPlantSettings, count: int, seed: int, *, ramp: bool = False) -> Iterator[SlipTrial]:
    """Slip trials: the tip is loaded slowly, held while it rolls, and then dragged."""
    plant = SlipPlant(settings)
    rate_hz = settings.rate_hz
    n = round((BEFORE_S + AFTER_S) * rate_hz)
    t_s = np.arange(1, n + 1) / rate_hz
    spring_n_m = settings.mass_kg * (2.0 * math.pi * settings.mode_hz) ** 2
    friction_n = settings.friction * settings.normal_n_m * LIGHT_M
    # the arm that loads the tip stretches the sensor's spring and the contact, one behind the other
    whole_m = friction_n / spring_n_m * (1.0 + 1.0 / settings.contact_ratio)
    loading = 0.5 - 0.5 * np.cos(np.pi * np.clip(t_s - 0.5, 0.0, 1.0))
    for number in range(count):
        # the golden ratio spreads the starts evenly over the paper's blocks
        start_s = BEFORE_S - 0.2 + 0.1 * (number * 0.6180339887 % 1.0)
        since_s = np.maximum(0.0, t_s - start_s)
        if ramp:
            way_m = np.where(since_s < RAMP_S, since_s**2 / (2.0 * RAMP_S), since_s - RAMP_S / 2.0)
        else:
            smooth = 0.5 * (since_s - START_S / np.pi * np.sin(np.pi * since_s / START_S))
            way_m = np.where(since_s < START_S, smooth, since_s - START_S / 2.0)
        arm_m = SPEED_M_S * way_m + (RAMP_PRELOAD if ramp else PRELOAD) * whole_m * loading
        plant.begin(key=(seed, number), press_m=LIGHT_M)
        values = plant.advance(arm_m, np.full(n, LIGHT_M), 0.1 * t_s)
        moved = np.flatnonzero(np.diff(plant.slid_m) != 0.0) + 1
        start = int(start_s * rate_hz)
        # tips that a push had moved before the arm started slip as well: omitting them would favour calm trials
        slid = moved[moved >= start]
        yield SlipTrial(values, start, int(slid[0]) if slid.size else None, slid.size < moved.size)


# --- detectors ---------------------------------------------------------------------------------


Rival = Callable[[Floats, float], Floats]
"""From samples, shape (n,), and their rate to the statistic, shape (n,)."""

LEARN_S = 1.0
OURS = "slip"
ORDER = 16
"""Past values that the prediction uses, as ours."""


def _mean(values: Floats, size: int) -> Floats:
    """Of the last `size` values; of fewer at the beginning."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    begins = np.maximum(0, ends - size)
    found: Floats = np.maximum(0.0, total[ends] - total[begins]) / (ends - begins)
    return found


def _armed(statistic: Floats, rate_hz: float) -> Floats:
    statistic[: round(LEARN_S * rate_hz)] = np.nan
    return statistic


def _above(values: Floats, rate_hz: float) -> Floats:
    """What is above 20 Hz (Butterworth, second order)."""
    sections = butter(2, 20.0, "highpass", fs=rate_hz, output="sos")
    found: Floats = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])[0]
    return found


def highpass_rms(values: Floats, rate_hz: float, *, window_s: float = 0.01) -> Floats:
    """Root mean square above 20 Hz."""
    return _armed(np.sqrt(_mean(_above(values, rate_hz) ** 2, round(window_s * rate_hz))), rate_hz)


def own_quiet_rms(values: Floats, rate_hz: float) -> Floats:
    """The same over that of the recording's own first second."""
    quiet = float(np.sqrt(np.mean(_above(values, rate_hz)[: round(LEARN_S * rate_hz)] ** 2)))
    return highpass_rms(values, rate_hz) / max(quiet, 1e-300)


def difference_rms(values: Floats, rate_hz: float, *, window_s: float = 0.008) -> Floats:
    """Root mean square of the second difference."""
    second = np.diff(values, n=2, prepend=[values[0], values[0]])
    return _armed(np.sqrt(_mean(second**2, round(window_s * rate_hz))), rate_hz)


def teager_kaiser(values: Floats, rate_hz: float, *, window_s: float = 0.01) -> Floats:
    """Mean of the Teager-Kaiser energy of the signal above 20 Hz (J. F. Kaiser, ICASSP 1990)."""
    x = _above(values, rate_hz)
    energy = np.zeros_like(x)
    energy[2:] = x[1:-1] ** 2 - x[2:] * x[:-2]
    return _armed(_mean(np.abs(energy), round(window_s * rate_hz)), rate_hz)


def _residual(values: Floats, rate_hz: float) -> Floats:
    """What sixteen coefficients, fitted to the first second (Yule-Walker), leave; in standard deviations of then."""
    learn = round(LEARN_S * rate_hz)
    x = values - values[:learn].mean()
    lags = np.array([np.dot(x[: learn - k], x[k:learn]) for k in range(ORDER + 1)]) / learn
    lags[0] = lags[0] * (1.0 + 1e-9) + 1e-300
    taps = np.concatenate([[1.0], -solve_toeplitz(lags[:-1], lags[1:])])
    left = np.asarray(lfilter(taps, np.ones(1), x), dtype=np.float64)
    found: Floats = left / max(float(left[ORDER:learn].std()), 1e-300)
    return found


def residual_glr(values: Floats, rate_hz: float, *, longest_s: float = 0.032) -> Floats:
    """Generalized likelihood ratio of a larger variance in the last 1, 2, 4 ... samples of the residual."""
    squared = _residual(values, rate_hz) ** 2
    best = np.zeros_like(squared)
    size = 1
    while size <= longest_s * rate_hz:
        ratio = np.maximum(1.0, _mean(squared, size))
        best = np.maximum(best, 0.5 * size * (ratio - 1.0 - np.log(ratio)))
        size *= 2
    return _armed(best, rate_hz)


def _cusum(gains: Floats, first: int) -> Floats:
    """Page's sum from a sample on, kept from falling below zero."""
    gains[:first] = 0.0
    total = np.cumsum(gains)
    found: Floats = total - np.minimum(0.0, np.minimum.accumulate(total))
    return found


def residual_cusum(values: Floats, rate_hz: float, *, ratio: float = 4.0) -> Floats:
    """CUSUM for a residual of four times the variance."""
    squared = _residual(values, rate_hz) ** 2
    gains = 0.5 * (1.0 - 1.0 / ratio) * squared - 0.5 * np.log(ratio)
    return _armed(_cusum(gains, round(LEARN_S * rate_hz)), rate_hz)


def knock_cusum(values: Floats, rate_hz: float) -> Floats:
    """Poisson CUSUM of knocks, 100 a second against one: residuals beyond four standard deviations, one in 9 ms."""
    candidates, dead_s, slip_hz, rest_hz = (
        np.flatnonzero(np.abs(_residual(values, rate_hz)) > 4.0),
        0.009,
        100.0,
        1.0,
    )
    gains = np.full(len(values), -(slip_hz - rest_hz) / rate_hz)
    free, worth = -1.0, np.log(slip_hz / rest_hz)
    for place in candidates.tolist():
        if place >= free:
            gains[place] += worth
            free = place + dead_s * rate_hz
    return _armed(_cusum(gains, round(LEARN_S * rate_hz)), rate_hz)


def judges() -> Mapping[str, Rival]:
    """Every detector, as a function: ours, the paper's, and the rivals."""

    def paper(values: Floats, rate_hz: float, *, block_s: float) -> Floats:
        detector = SlipPaperDetector("paper", SlipPaperSettings(block_s=block_s))
        return _armed(detector.statistic(values[:, None], rate_hz), rate_hz)

    return {
        OURS: lambda values, rate_hz: SlipDetector(OURS, SlipSettings()).statistic(values[:, None], rate_hz),
        "slip.paper, 64 ms": partial(paper, block_s=0.064),
        "slip.paper, 32 ms": partial(paper, block_s=0.032),
        "high-pass RMS, 10 ms": highpass_rms,
        "high-pass RMS, 10 ms, over own quiet": own_quiet_rms,
        "second-difference RMS, 8 ms": difference_rms,
        "Teager-Kaiser, 10 ms": teager_kaiser,
        "AR(16) residual, GLR": residual_glr,
        "AR(16) residual, CUSUM": residual_cusum,
        "whitened knocks, Poisson CUSUM": knock_cusum,
    }


# --- delays and shares -------------------------------------------------------------------------


MISSED_S = 0.75
RESAMPLED, EDGES = 1000, (0.025, 0.975)

THRESHOLDS = (11.0, 25.0)
"""For ours, beside those of equal false alarms: a little more than that of the recordings, and the default."""

HOLD_S = SlipSettings().hold_s
"""Slip is over for a rival, too, where its number has stayed below the threshold for so long."""


def quantile(delays: Floats, share: float) -> float:
    """Of delays; infinite where so many are missed."""
    return float(np.sort(delays)[max(1, math.ceil(share * len(delays))) - 1]) if len(delays) else math.nan


def _picks(count: int) -> NDArray[np.int64]:
    """The same in each call for as many."""
    return np.random.default_rng(1).integers(0, count, (RESAMPLED, count))


def resampled(delays: Floats, share: float) -> Floats:
    """A quantile of delays resampled, the same slips in each call of as many, shape (RESAMPLED,)."""
    place = max(1, math.ceil(share * len(delays))) - 1
    found: Floats = np.partition(np.minimum(delays, MISSED_S)[_picks(len(delays))], place, axis=1)[:, place]
    return found


def first_above(statistic: Floats, threshold: float) -> float:
    """Samples to the first value above; infinite without."""
    above = np.flatnonzero(np.nan_to_num(statistic, nan=-math.inf) > threshold)
    return float(above[0]) if above.size else math.inf


def _pushed(values: Floats, rate_hz: float, **settings: float) -> Sequence[Detected]:
    """Our detector's events on a stretch."""
    detector = SlipDetector(OURS, SlipSettings.model_validate(settings))
    return detector.push(SampleBlock("board.tangential", 0, 0.0, values[:, None], rate_hz=rate_hz))


def refusals(quiet: Sequence[Floats], slipping: Sequence[Floats], rate_hz: float) -> dict[str, Any]:
    """Ours, with the level of each quiet stored, on a slip that runs while it begins: how often it refuses the baseline
    or detects the slip, and how often it reports anything."""
    detected = something = 0
    for calm, each in zip(quiet, slipping, strict=True):
        events = _pushed(each, rate_hz, quiet_rms=_pushed(calm, rate_hz)[0].value)
        detected += any(isinstance(event, BaselineRefused | SlipStarted) for event in events)
        something += bool(events)
    return {"stored": True, **share_of(detected, len(quiet)), "something_reported": something}


def share_of(detected: int, slips: int) -> dict[str, Any]:
    """A share of slips with its 95 % interval (Wilson)."""
    return {"slips": slips, "detected": detected, "detected_95": wilson(detected, slips)}


def called(name: str, values: Floats, statistic: Floats, rate_hz: float, threshold: float) -> Bools:
    """Where a detector reports slip, shape (n,): ours by its events, a rival from a number above the threshold until
    none has been for `HOLD_S`.

    A number at the end of a block stands until the next. A CUSUM is capped just above its threshold, so that old
    evidence does not delay the end.
    """
    if name == OURS:
        marks = np.zeros(len(values) + 1)
        for event in _pushed(values, rate_hz, threshold=threshold):
            if isinstance(event, SlipStarted | SlipEnded):
                marks[round(event.t_s * rate_hz)] += 1.0 if isinstance(event, SlipStarted) else -1.0
        ours: Bools = np.cumsum(marks)[:-1] > 0.0
        return ours
    places = np.arange(len(statistic))
    known = np.maximum.accumulate(np.where(np.isnan(statistic), 0, places))
    held = np.nan_to_num(statistic[known])
    if name.endswith("CUSUM"):
        held = _held(held, 1.01 * threshold)
    last = np.maximum.accumulate(np.where(held > threshold, places, -(10**9)))
    found: Bools = places - last <= HOLD_S * rate_hz
    return found


def _held(total: Floats, ceiling: float) -> Floats:
    """A sum that is kept from falling below zero, kept from rising above a ceiling as well."""
    found, value = np.empty_like(total), 0.0
    for place, step in enumerate(np.diff(total, prepend=0.0).tolist()):
        value = 0.0 if total[place] <= 0.0 else min(ceiling, max(0.0, value + step))
        found[place] = value
    return found


# --- simulated sensors -------------------------------------------------------------------------


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


def on_steps(kind: str, rate_hz: float) -> Iterator[dict[str, Any]]:
    """How often each detector calls a step of the noise a slip, and for how long: at one false alarm an hour where
    nothing steps, and ours at thresholds from elsewhere as well."""
    begin = round(STEP_S * rate_hz)
    steps = range(SEED_STEPS, SEED_STEPS + STEPS_EACH)
    after = {factor: [stepped(kind, rate_hz, factor, seed) for seed in steps] for factor in STEPS}
    quiet = [stepped(kind, rate_hz, 1.0, seed) for seed in range(SEED_QUIET, SEED_QUIET + QUIET_EACH)]
    for name, judge in judges().items():
        maxima = np.concatenate([span_maxima(judge(each, rate_hz), rate_hz) for each in quiet])
        equal = threshold_for(maxima, INTERVAL_S).threshold
        for factor, recordings in after.items():
            found = [judge(each, rate_hz)[begin:] for each in recordings]
            for threshold in (equal, *(THRESHOLDS if name == OURS else ())):
                ends = [np.flatnonzero(np.nan_to_num(each) > threshold) for each in found]
                alarmed = sum(bool(above.size) for above in ends)
                longest_s = max(((above[-1] + 1) / rate_hz for above in ends if above.size), default=0.0)
                about = {"kind": kind, "rate_hz": rate_hz, "factor": factor, "detector": name}
                counts = {"steps": STEPS_EACH, "alarmed": alarmed, "alarmed_95": wilson(alarmed, STEPS_EACH)}
                yield {**about, "threshold": threshold, **counts, "longest_s": longest_s}


def in_contact(sensor: str, nuisance: str, thresholds: Thresholds) -> Iterator[dict[str, Any]]:
    """Share of the time in contact without slip in which each detector reports slip, from the touch on, once for each
    structure that is off."""
    recordings = []
    for number, factors in enumerate(OFF):
        settings = sensor_off(sensor, nuisance, *factors)
        rolls = nuisance.startswith("rolling")
        values, touch, slid = contact(settings, SEED_QUIET + number, FIRM_M, rolls=rolls)
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
            about = {"sensor": sensor, "nuisance": nuisance, "detector": name, "from": source}
            yield {**about, "threshold": threshold, "share": float(np.mean(slipping))}


def at_simulated_reset(sensor: str, thresholds: Thresholds) -> Iterator[dict[str, Any]]:
    """A table that moves under the tip while a detector starts, and goes on: how many it then detects. Ours as well
    with the quiet level of the air stored."""
    quiet, slipping = [], []
    for number, factors in enumerate(OFF * 5):
        settings = sensor_off(sensor, "table moves", *factors)
        values, touch, _ = contact(settings, SEED_SLIP + number, LIGHT_M, rolls=False)
        begin = touch + round(0.5 * settings.rate_hz)
        quiet.append(values[:touch])
        slipping.append(values[begin : begin + touch])
    for name, judge in judges().items():
        detected = sum(
            math.isfinite(first_above(judge(each, settings.rate_hz), thresholds[name]["clean"]))
            for each in slipping
        )
        about = {"sensor": sensor, "detector": name, "stored": False}
        yield {**about, **share_of(detected, len(slipping))}
    yield {"sensor": sensor, "detector": OURS, **refusals(quiet, slipping, settings.rate_hz)}


SOME = (OURS, "high-pass RMS, 10 ms", "high-pass RMS, 10 ms, over own quiet", "AR(16) residual, GLR")
"""Of the detectors on coarse converters and where samples are lost."""


def simulated(
    sensor: str, nuisance: str, hours: float, count: int, lost: float = 0.0
) -> list[dict[str, Any]]:
    """Every detector on one sensor under one nuisance: one false alarm an hour, the first seconds included. Of lost
    samples ours knows."""
    plants = [sensor_off(sensor, nuisance, *factors) for factors in OFF]
    rate_hz = plants[0].rate_hz
    chosen = {
        name: judge for name, judge in judges().items() if name in SOME or not (lost or nuisance in COARSE)
    }

    def judged(name: str, values: Floats, seed: int) -> Floats:
        heard = thinned(values[:, 0], lost, seed) if lost else values[:, 0]
        return chosen[name](heard if name == OURS or not lost else joined(heard), rate_hz)

    maxima: dict[str, list[Floats]] = {name: [] for name in chosen}
    for number, plant in enumerate(plants):
        quiet = [recordings(plant, hours / len(plants), SEED_QUIET + number)]
        if nuisance in COARSE:
            quiet.append(drifting(plant, hours / len(plants), SEED_QUIET + number))
        for place, values in enumerate(chain(*quiet)):
            for name in chosen:
                maxima[name].append(span_maxima(judged(name, values, place), rate_hz))
    found = {name: threshold_for(np.concatenate(parts), INTERVAL_S) for name, parts in maxima.items()}
    rows = []
    about_lost = f", {100.0 * lost:g} % lost" if lost else ""
    for ramp in (False, True) if nuisance == "clean" and not lost else (False,):
        trials = [
            trial
            for number, plant in enumerate(plants)
            for trial in slips(plant, count // len(plants), SEED_SLIP + number, ramp=ramp)
            if trial.onset is not None
        ]
        for name, equal in found.items():
            delays, early = [], 0
            for place, trial in enumerate(trials):
                assert trial.onset is not None
                statistic = judged(name, trial.values, place)
                if math.isfinite(first_above(statistic[trial.start : trial.onset], equal.threshold)):
                    early += 1
                delay_s = first_above(statistic[trial.onset :], equal.threshold) / rate_hz
                delays.append(delay_s if delay_s <= MISSED_S else math.inf)
            what = "ramp" if ramp else nuisance + about_lost
            about = {"sensor": sensor, "nuisance": what, "detector": name}
            limit = {"threshold": equal.threshold, "extrapolated": equal.extrapolated}
            rows.append({**about, **limit, "early": early, "delays_s": delays})
    return rows


# --- all of it ---------------------------------------------------------------------------------


HOURS, TRIALS = 4.0 / 3.0, 400
"""Simulated without slip, and slips, for each sensor and nuisance: a quarter on each structure that is off."""

BASIC = ("clean", "bumps", "loads")
MORE = ("tails", "tremor", "smooth", "bouncing")
"""On the fingertip alone, as are coarse converters."""

LOST = (0.1, 0.2)
"""Shares of the samples that are lost, in calm and among bumps."""


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
    """Run all of it; writes results/slip.json. Simulated parts are kept, so that an interrupted run continues."""
    from benchmarks.recordings import at_reset, drags, on_blows, on_drags, on_tribometer

    count, known = 8 if quick else TRIALS, bool(drags("judging"))
    parts = [(sensor, nuisance) for nuisance in BASIC for sensor in SENSORS]
    parts += [(SENSORS[0], nuisance) for nuisance in (*MORE, *COARSE)]
    rows = [
        row for part in parts for row in _kept(f"{part[0]}_{part[1]}_{count}", simulated, *part, HOURS, count)
    ]
    rows += [
        row
        for sensor, nuisance, lost in product(SENSORS, BASIC[:2], LOST)
        for row in _kept(
            f"{sensor}_{nuisance}_{lost:g}_{count}", simulated, sensor, nuisance, HOURS, count, lost
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
        "at_simulated_reset": [row for sensor in SENSORS for row in at_simulated_reset(sensor, hour[sensor])],
        "steps": [
            row
            for kind in ("white", "hum", "converter")
            for rate_hz in (1000.0, 2200.0, 10_000.0)
            for row in _kept(f"steps_{kind}_{rate_hz:g}", on_steps, kind, rate_hz)
        ],
        "contact": [
            row
            for nuisance in CONTACTS
            for sensor in SENSORS
            for row in _kept(
                f"contact_{sensor}_{nuisance}_{count}", in_contact, sensor, nuisance, hour[sensor]
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


def _kept(
    name: str, function: Callable[..., Iterable[dict[str, Any]]], *arguments: Any
) -> list[dict[str, Any]]:
    """The rows of a simulated part, or as they are kept."""
    return kept(f"slip_{name}", lambda: list(function(*arguments)))
