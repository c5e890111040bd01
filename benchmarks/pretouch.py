"""Pre-touch and contact (C5) at the paper's true-negative rates, on simulated fingers: `python -m benchmarks pretouch`.

Passages of a finger to an object and back, without an object, and by the other finger: straight from the aura's plant,
with the arm's motion and encoder written down here, without driver and loop. What the plant assumes:
docs/explanation/aura.md. Thresholds are from some passages, rates from others.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Contact, ContactHeld, ContactLost, Detected, PreTouch
from benchmarks.results import in_parallel, progress, save, workers
from controller.detectors.level import LevelDetector, LevelPaperDetector, LevelPaperSettings, LevelSettings
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings
from controller.measures.trial import delay_s, not_before
from controller.reports.counts import wilson
from drivers.core.messages import Floats, SampleBlock
from simulator.physics.aura import BOTH, LEFT, RIGHT, AuraMotion, AuraPlant
from simulator.physics.aura_settings import NOTHING, OBJECTS, SIDES, SIX, SOFT, Side
from simulator.physics.gripper_part import AuraBenchSettings

Complexes = NDArray[np.complex128]

Kind = Literal["touch", "near", "nothing", "other_side", "drift"]
"""To the object, against it by 0.5 mm, and back; to 0.4 cm from it, and back; the same motion before nothing; the other
finger, which does not look at the object; standing still before nothing, while bridge and air warm up by 0.02 K/s."""

POSITIVE: tuple[Kind, ...] = ("touch", "near")
"""Of pre-touch; of contact only the first is."""

RATE_HZ = 1000.0
"""Of the envelope."""

ENCODER_HZ = 500.0
"""Of the arm's encoder (wire/rtde: 500 Hz)."""

ENCODER_NOISE_M = 1e-5
"""Standard deviation of its readings. Assumption: a third of the arm's repeatability of 0.03 mm."""

START_M, END_M = 0.055, 0.004
"""Rupavatharam et al., IV.A.1: from 5.5 cm to 0.4 cm."""

PRESS_M = 0.0005
"""Travel of the finger after the touch. Assumption: half of its foam."""

ACCELERATION_M_S2 = 0.5
"""Of the arm. Assumption: as the mock arm's."""

HOLD_S = 1.5
"""At the end of the way. Assumption; Fig. 7 shows about 2 s."""

SPEEDS_M_S = (0.01, 0.03)
"""Fig. 4d."""

LEVEL = 0.5
"""Of the drive."""

DRIVE_HZ = 40_000.0

SOUND_ERROR = 0.02
"""By how much the real speed of sound differs from the detectors' setting, either way."""

WARMING_K_S = 0.02
"""While it drifts. Assumption: a bridge in its first minutes."""

NOMINAL_K = 293.15


@dataclass(frozen=True)
class Event:
    """One passage to be simulated; equal events give identical passages. Seed (of the study's part) and number key the
    noise, the side goes ahead, the echo is weaker than the plant's default."""

    seed: int
    number: int
    kind: Kind
    object: str
    side: Side
    speed_m_s: float
    weaker_db: float = 0.0


@dataclass(frozen=True)
class PassageRecord:
    """Signals and truth of a passage.

    Attributes:
        z, times_s: Envelope and its instants, shape (n,).
        encoder, position_m: The encoder's readings, `arm.position`, and interpolated to those instants, shape (n,).
        gap_m: Distance to the object, infinite without an object, shape (n,).
        begun, arrived: Samples at which the approach began and ended.
        touched, released: Sample of the first touch, and the first after the last one; None without.
    """

    event: Event
    z: Complexes
    position_m: Floats
    encoder: SampleBlock
    gap_m: Floats
    begun: int
    arrived: int
    touched: int | None
    released: int | None

    times_s: Floats

    @property
    def block(self) -> SampleBlock:
        """The envelope as the detectors receive it, `signals.right`."""
        values = np.ascontiguousarray(self.z).view(np.float64).reshape(-1, 2)
        return SampleBlock("signals.right", 0, float(self.times_s[0]), values, rate_hz=RATE_HZ, unit="FS")


def settings_of(event: Event) -> AuraBenchSettings:
    """The plant's: air 2 % faster or slower than the detectors assume, in turn."""
    ratio = 1.0 + (SOUND_ERROR if event.number % 2 else -SOUND_ERROR)
    warming = WARMING_K_S if event.kind == "drift" else 0.0
    found = AuraBenchSettings(
        scene="ahead", temperature_k=NOMINAL_K * ratio * ratio, warming_k_s=warming, side=event.side
    )
    weaker_fs = found.reflection_fs * 10.0 ** (-event.weaker_db / 20.0)
    return found.model_copy(update={"reflection_fs": weaker_fs})


def ramp(times_s: Floats, length_m: float, speed_m_s: float) -> tuple[Floats, float]:
    """Way along a motion that begins at 0, and how long it takes."""
    rise_s = speed_m_s / ACCELERATION_M_S2
    total_s = length_m / speed_m_s + rise_s
    t = np.clip(times_s, 0.0, total_s)
    way_m = (
        0.5 * ACCELERATION_M_S2 * np.minimum(t, rise_s) ** 2
        + speed_m_s * np.clip(t - rise_s, 0.0, total_s - 2.0 * rise_s)
        + speed_m_s * np.maximum(t - (total_s - rise_s), 0.0)
        - 0.5 * ACCELERATION_M_S2 * np.maximum(t - (total_s - rise_s), 0.0) ** 2
    )
    return way_m, total_s


def duration_s(event: Event) -> float:
    """Of a passage."""
    return _rest_s(event) + 2.0 * (_length_m(event) / event.speed_m_s + 0.06) + HOLD_S + 0.5


def _length_m(event: Event) -> float:
    return START_M + PRESS_M if event.kind == "touch" else START_M - END_M


def _rest_s(event: Event) -> float:
    """Rest before the approach: not the same each time, so that no window of time is favoured."""
    draw = np.random.default_rng((event.seed, event.number, 1)).random()
    return 1.5 + float(draw)


def course(event: Event, times_s: Floats) -> tuple[AuraMotion, float, float]:
    """Positions of arm and object at instants since the passage began, and when the approach begins and ends."""
    rest_s, length_m = _rest_s(event), _length_m(event)
    forth_m, takes_s = ramp(times_s - rest_s, length_m, event.speed_m_s)
    back_m, _ = ramp(times_s - rest_s - takes_s - HOLD_S, length_m, event.speed_m_s)
    way_m = forth_m - back_m
    if event.kind == "drift":
        way_m = np.zeros_like(way_m)
    n = len(times_s)
    gap_m = np.full((n, 2), np.inf)
    if event.object != NOTHING:
        gap_m[:, RIGHT] = START_M - way_m
    force_n = np.zeros((n, 2))
    force_n[:, RIGHT] = AuraBenchSettings().press_n_m * np.maximum(-gap_m[:, RIGHT], 0.0)
    speed_m_s = np.abs(np.gradient(way_m, times_s)) if n > 1 else np.zeros(n)
    motion = AuraMotion(gap_m, np.zeros(n), np.zeros(n), np.full(n, 0.063), force_n, speed_m_s, way_m)
    return motion, rest_s, rest_s + takes_s


def plant_of(event: Event) -> AuraPlant:
    """The plant, at the beginning of the passage."""
    settings = settings_of(event)
    plant = AuraPlant(settings)
    thing = OBJECTS.get(event.object)
    plant.begin((event.seed, event.number), thing, settings.object_top_m, event.side)
    return plant


def finger_of(event: Event) -> int:
    """The receiving finger."""
    return LEFT if event.kind == "other_side" else RIGHT


def passage(event: Event) -> PassageRecord:
    """Simulate one, at envelope level."""
    n = round(duration_s(event) * RATE_HZ)
    numbers = np.arange(n, dtype=np.int64)
    times_s, finger = numbers / RATE_HZ, finger_of(event)
    motion, begun_s, arrived_s = course(event, times_s)
    drive = (np.full(n, DRIVE_HZ), np.full(n, LEVEL))
    z = plant_of(event).envelope(motion, numbers, times_s, *drive, (finger,))[:, finger]
    readings_s = np.arange(math.ceil(float(times_s[-1]) * ENCODER_HZ) + 2) / ENCODER_HZ
    noise = np.random.default_rng((event.seed, event.number, 2)).standard_normal(len(readings_s))
    values = course(event, readings_s)[0].x_m + ENCODER_NOISE_M * noise
    encoder = SampleBlock("arm.position", 0, 0.0, values[:, None], rate_hz=ENCODER_HZ, unit="m")
    position_m, gap_m = np.interp(times_s, readings_s, values), motion.gap_m[:, RIGHT]
    touching = np.flatnonzero(gap_m <= 0.0)
    touched, released = (int(touching[0]), int(touching[-1]) + 1) if len(touching) else (None, None)
    begun, arrived = np.searchsorted(times_s, (begun_s, arrived_s)).tolist()
    return PassageRecord(event, z, position_m, encoder, gap_m, begun, arrived, touched, released, times_s)


def template(event: Event) -> tuple[Complexes, Complexes, Floats]:
    """The plant's truth of a passage, for the clairvoyant.

    Returns:
        What the object adds to the envelope (before nothing: what an object of the six would have added), the envelope
        without object and noise, and the standard deviation of the noise on I and on Q, each shape (n,).
    """
    n = round(duration_s(event) * RATE_HZ)
    times_s = np.arange(n) / RATE_HZ
    frequency_hz, level = np.full(n, DRIVE_HZ), np.full(n, LEVEL)
    finger = finger_of(event)
    own = course(event, times_s)[0]
    without = replace(event, object=NOTHING)
    bare_motion = own._replace(gap_m=np.full((n, 2), np.inf), force_n=np.zeros((n, 2)))
    bare = plant_of(without).field(bare_motion, times_s, frequency_hz, level, BOTH)
    supposed = event if event.object != NOTHING else replace(event, object=SIX[event.number % len(SIX)])
    way_m = course(replace(supposed, kind="near"), times_s)[0].gap_m[:, RIGHT]
    near_motion = bare_motion._replace(gap_m=np.column_stack((way_m, np.full(n, np.inf))))
    seen = plant_of(supposed).field(near_motion, times_s, frequency_hz, level, (RIGHT,))
    settings = settings_of(event)
    quiet_fs = settings.noise_fs_rthz * math.sqrt(RATE_HZ / (1.0 + 2.0 * settings.noise_colour))
    sigma_fs = np.hypot(quiet_fs, settings.motion_fs * np.sqrt(own.speed_m_s / 0.01) * LEVEL)
    return seen[:, RIGHT] - bare[:, RIGHT], bare[:, finger], sigma_fs


def events(
    seed: int, counts: tuple[int, int, int], objects: tuple[str, ...] = SIX, weaker_db: float = 0.0
) -> Iterator[Event]:
    """The passages of one part of the study: touches and nears for each object, side and speed, and each other kind for
    each side and speed."""
    touches, nears, others = counts
    number = 0
    for speed_m_s in SPEEDS_M_S:
        for side in SIDES:
            wanted: list[tuple[Kind, str, int]] = []
            for name in objects:
                wanted += [("touch", name, touches), ("near", name, nears)]
            wanted += [("nothing", NOTHING, others), ("drift", NOTHING, others)]
            wanted += [("other_side", objects[i % len(objects)], 1) for i in range(others)]
            for kind, name, count in wanted:
                for _ in range(count):
                    yield Event(seed, number, kind, name, side, speed_m_s, weaker_db)
                    number += 1


# --- detectors and thresholds ------------------------------------------------------------------


PRETOUCH_TNR, CONTACT_TNR = 0.953, 0.987
"""At which all detectors are compared (Rupavatharam et al., IV.B)."""

WEAKER_DB = 17
"""By so much the echo must be weaker for the paper's own detector, windows of 0.5 s, to have the paper's own rate, 92.4
% (IV.B.1). Found by halving between 0 and 40 dB, on passages used for nothing else."""

SEED_CALIBRATION, SEED_TEST, SEED_SWEEP = 21_000, 22_000, 23_001
"""Keys of passages: no noise is used twice, nor in developing the detectors."""

BOTH_CHANNELS, CLAIRVOYANT = "pretouch.paper on I and Q", "clairvoyant"
"""Not detectors that anyone can use: compared with their thresholds here."""

AS_IT_IS = ", own threshold"
"""Ours with default settings, not calibrated."""

IN_MOTION = ", in motion"
SET_OUT_S = 0.3
"""The paper's z-score once more, of the approach alone, begun only this long after the arm's start: in a window that
begins at rest the noise of the start is the largest z. The paper gives no procedure for that."""

EMPTY = PreTouchSettings(background_fs=0.0, obliquity=(1.0,))
"""Ours, as set for a room without echoes and a straight path to the object."""

ONE_IN = 4
"""One in so many passages is given to the clairvoyant, which costs as much as the rest."""


class Judge(Protocol):
    """A detector of this study."""

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process a block."""

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """The number compared with the threshold."""


def pretouch_judges(thresholds: Mapping[str, float]) -> dict[str, Judge]:
    """Fresh detectors of pre-touch by name; thresholds that are not given stay as they are."""
    made: dict[str, Judge] = {}
    for window_s in (0.25, 0.5, 1.0):
        name = f"pretouch.paper, {window_s:g} s"
        made[name] = PreTouchPaperDetector(
            name, PreTouchPaperSettings(window_s=window_s, **_at(thresholds, name))
        )
    made["pretouch"] = PreTouchDetector("pretouch", EMPTY.model_copy(update=_at(thresholds, "pretouch")))
    made[f"pretouch{AS_IT_IS}"] = PreTouchDetector("pretouch", EMPTY)
    return made


def contact_judges(thresholds: Mapping[str, float]) -> dict[str, Judge]:
    """Fresh detectors of contact by name."""
    made: dict[str, Judge] = {}
    for window_s, part in ((0.5, ""), (1.0, ""), (5.0, ""), (0.5, IN_MOTION), (1.0, IN_MOTION)):
        name = f"level.paper, {window_s:g} s{part}"
        made[name] = LevelPaperDetector(name, LevelPaperSettings(window_s=window_s, **_at(thresholds, name)))
    made["level"] = LevelDetector("level", LevelSettings(**_at(thresholds, "level")))
    made[f"level{AS_IT_IS}"] = LevelDetector("level", LevelSettings())
    return made


def _at(thresholds: Mapping[str, float], name: str) -> dict[str, Any]:
    return {"threshold": thresholds[name]} if name in thresholds else {}


Size = Mapping[str, Any]
"""How many touches and nears for each object, side and speed, and others for each side and speed; the same three at the
plant's own echo; touches, and as many nears, of soft objects; nears and others that set thresholds."""

FULL: Size = {"all": (62, 38, 80), "plain": (8, 4, 12), "soft": 5, "calibration": (12, 60)}
QUICK: Size = {"all": (2, 2, 6), "plain": (1, 1, 3), "soft": 1, "calibration": (1, 16)}

SWEEP_DB = (0, 5, 10, 15, 20, 25, 30, 35, 40)

LATE_S = 0.5
"""A contact counts as felt if it is reported no later than this after the touch, s; its end likewise. Assumption: a
third of the hold."""


def both(values: Floats) -> Floats:
    """The paper's statistic, windows of 0.5 s, summed over I and Q."""
    judge = PreTouchPaperDetector("both", PreTouchPaperSettings())
    return judge.statistic(values[:, :1], RATE_HZ) + judge.statistic(values[:, 1:2], RATE_HZ)


def clairvoyant(record: PassageRecord) -> Floats:
    """The matched filter that knows the plant: echo, imbalance, drift and noise levels of this very passage.

    After each sample since the approach began, the optimum in white noise: the signal, projected on what the object
    would add, in standard deviations. Shape (n,).
    """
    echo, bare, sigma_fs = template(record.event)
    weights = 1.0 / sigma_fs**2
    weights[: record.begun] = 0.0
    projected = np.cumsum(weights * (np.conj(echo) * (record.z - bare)).real)
    energy = np.cumsum(weights * np.abs(echo) ** 2)
    found: Floats = np.full(len(echo), np.nan)
    np.divide(projected, np.sqrt(energy), out=found, where=energy > 0.0)
    return found


def statistics(record: PassageRecord) -> dict[str, Floats]:
    """Those that are no detectors, sample by sample."""
    found = {BOTH_CHANNELS: both(np.column_stack([record.z.real, record.z.imag]))}
    return found | ({CLAIRVOYANT: clairvoyant(record)} if record.event.number % ONE_IN == 0 else {})


def _part(record: PassageRecord, name: str) -> slice:
    """The samples of a passage that a contact detector receives."""
    if not name.endswith(IN_MOTION):
        return slice(0, len(record.z))
    return slice(record.begun + round(SET_OUT_S * RATE_HZ), record.arrived + round(LATE_S * RATE_HZ))


def loudest(event: Event) -> dict[str, float]:
    """Largest statistic of each detector in a passage without an event: for pre-touch one without an object, for
    contact one without a touch."""
    record = passage(event)
    values = np.column_stack([record.z.real, record.z.imag, record.position_m])
    traces: dict[str, Floats] = {}
    if event.kind not in POSITIVE:
        traces |= statistics(record)
        traces |= {name: judge.statistic(values, RATE_HZ) for name, judge in pretouch_judges({}).items()}
    if event.kind != "touch":
        for name, judge in contact_judges({}).items():
            traces[name] = judge.statistic(values[_part(record, name), :2], RATE_HZ)
    largest = {
        name: np.max(trace, initial=-math.inf, where=~np.isnan(trace)) for name, trace in traces.items()
    }
    return {name: float(value) for name, value in largest.items() if not name.endswith(AS_IT_IS)}


def threshold_at(maxima: Sequence[float], true_negative_rate: float) -> float:
    """The least threshold at which the given share of passages without an event stays quiet.

    Args:
        maxima: Largest statistic in each; one may equal the threshold.
        true_negative_rate: 0 to 1.
    """
    ordered = np.sort(np.asarray(maxima))
    return float(ordered[min(len(ordered) - 1, math.ceil(true_negative_rate * len(ordered)) - 1)])


def calibrate(weaker_db: float, size: Size, pool: ProcessPoolExecutor) -> dict[str, float]:
    """By detector, thresholds at the paper's true-negative rates and an echo's strength, from passages of their own."""
    work = events(SEED_CALIBRATION, (0, *size["calibration"]), weaker_db=weaker_db)
    maxima: dict[str, list[float]] = {}
    for found in in_parallel(loudest, work, pool):
        for name, value in found.items():
            maxima.setdefault(name, []).append(value)
    return {
        name: max(threshold_at(values, CONTACT_TNR if name.startswith("level") else PRETOUCH_TNR), 1e-300)
        for name, values in maxima.items()
    }


# --- verdicts ------------------------------------------------------------------------------------


def seen_at(events: Sequence[Detected], begun_s: float, until_s: float) -> float:
    """When pre-touch was first reported in an approach, else NaN; an earlier event that still stands does not count."""
    times_s = (event.t_s for event in events if isinstance(event, PreTouch))
    return next((t_s for t_s in times_s if begun_s <= t_s <= until_s), math.nan)


class ScoredTouch(NamedTuple):
    """Score of one touch.

    Attributes:
        delay_s: From touch to `Contact`, NaN where it was not felt in time.
        early: Contact was reported before the touch, which would have stopped the arm: it was not felt.
        held: It was felt, reported to persist, and not revoked before the finger was withdrawn.
        ended: It was felt, and its end was reported in time.
    """

    delay_s: float
    early: bool
    held: bool
    ended: bool


def touch(events: Sequence[Detected], touched_s: float, withdrawn_s: float, released_s: float) -> ScoredTouch:
    """Score the events of one touch, which ends from when the finger is withdrawn until its force is gone."""
    begins = [event.t_s for event in events if isinstance(event, Contact)]
    early = any(not not_before(t_s, touched_s) for t_s in begins)
    felt_s = next(iter(begins), math.inf)
    if early or felt_s > min(released_s, touched_s + LATE_S):
        return ScoredTouch(math.nan, early, False, False)
    lost_s = next((e.t_s for e in events if isinstance(e, ContactLost) and e.t_s > felt_s), math.inf)
    held = any(isinstance(event, ContactHeld) and felt_s < event.t_s <= released_s for event in events)
    kept = not_before(lost_s, withdrawn_s)
    ended = kept and lost_s <= released_s + LATE_S
    return ScoredTouch(delay_s(felt_s, touched_s), early, held and kept, ended)


class Verdict(NamedTuple):
    """Results of all detectors on one passage, by detector: the distance at which an approach was seen (NaN where it
    was not), whether pre-touch was reported without an object; the score of a touch, whether contact was reported
    without one."""

    event: Event
    seen_m: dict[str, float]
    near: dict[str, bool]
    touch: dict[str, ScoredTouch]
    touched: dict[str, bool]


def judge(event: Event, thresholds: Mapping[str, float]) -> Verdict:
    """Apply all detectors to one passage."""
    record, found = passage(event), Verdict(event, {}, {}, {}, {})
    until = record.arrived if record.touched is None else min(record.touched, record.arrived)
    begun_s, until_s = record.times_s[[record.begun, until]].tolist()
    for name, detector in pretouch_judges(thresholds).items():
        reported = [*detector.push(record.encoder), *detector.push(record.block)]
        t_s = seen_at(reported, begun_s, until_s)
        found.near[name] = any(type(each) is PreTouch for each in reported)
        found.seen_m[name] = (
            float(np.interp(t_s, record.times_s, record.gap_m)) if math.isfinite(t_s) else math.nan
        )
    for name, trace in statistics(record).items():
        above = np.flatnonzero(trace > thresholds[name])
        inside = above[(above >= record.begun) & (above <= until)]
        found.near[name] = bool(len(above))
        found.seen_m[name] = float(record.gap_m[inside[0]]) if len(inside) else math.nan
    (found.near if event.kind in POSITIVE else found.seen_m).clear()
    for name, detector in contact_judges(thresholds).items():
        part, block = _part(record, name), record.block
        t0_s = float(record.times_s[part.start])
        reported = list(detector.push(replace(block, seq=part.start, t0_s=t0_s, values=block.values[part])))
        if record.touched is not None and record.released is not None:
            indices = [record.touched, record.arrived + round(HOLD_S * RATE_HZ), record.released]
            found.touch[name] = touch(reported, *record.times_s[indices].tolist())
        else:
            found.touched[name] = any(type(each) is Contact for each in reported)
    return found


# --- rates ---------------------------------------------------------------------------------------

PRETOUCH, CONTACT = tuple(pretouch_judges({})), tuple(contact_judges({}))
MATCHED, OURS = "pretouch.paper, 0.5 s", "pretouch"
"""The paper's variant to whose printed rate the echo was matched, and ours: of the tables that compare two."""

STRONGEST = f"level.paper, 1 s{IN_MOTION}"
"""The paper's contact that feels most, of the tables that compare two."""


def rate(answers: Iterable[bool]) -> dict[str, Any]:
    """Of the true ones, with Wilson's 95 % interval; None of none."""
    known = list(answers)
    count, of = sum(known), len(known)
    numbers = (count / of, *wilson(count, of)) if of else (None, None, None)
    return {"count": count, "of": of, **dict(zip(("share", "low", "high"), numbers, strict=True))}


def quantiles(values: Sequence[float]) -> dict[str, float | None]:
    """10, 50 and 90 % quantiles of the values that are not NaN."""
    known = [value for value in values if not math.isnan(value)]
    found = np.quantile(known, (0.1, 0.5, 0.9)).tolist() if known else (None, None, None)
    return dict(zip(("p10", "median", "p90"), found, strict=True))


def pretouch_rates(verdicts: Sequence[Verdict], names: Sequence[str]) -> dict[str, Any]:
    """True positives with their distances (m), and true negatives."""
    found: dict[str, Any] = {}
    for name in names:
        seen = [v.seen_m[name] for v in verdicts if name in v.seen_m]
        quiet = rate(not v.near[name] for v in verdicts if name in v.near)
        found[name] = {
            "tpr": rate(not math.isnan(d) for d in seen),
            "tnr": quiet,
            "distance_m": quantiles(seen),
        }
    return found


def contact_rates(verdicts: Sequence[Verdict], names: Sequence[str]) -> dict[str, Any]:
    """True positives with their delays (s) and outcomes, and true negatives."""
    found: dict[str, Any] = {}
    for name in names:
        touches = [v.touch[name] for v in verdicts if name in v.touch]
        delays_s = [each.delay_s for each in touches]
        found[name] = {
            "tpr": rate(not math.isnan(d) for d in delays_s),
            "tnr": rate(not v.touched[name] for v in verdicts if name in v.touched),
            "delay_s": quantiles(delays_s),
            **{way: rate(getattr(each, way) for each in touches) for way in ("early", "held", "ended")},
        }
    return found


def _all_rates(verdicts: Sequence[Verdict], thresholds: Mapping[str, float]) -> dict[str, Any]:
    def by(what: Callable[[Event], str]) -> dict[str, Any]:
        groups: dict[str, list[Verdict]] = {}
        for verdict in verdicts:
            groups.setdefault(what(verdict.event), []).append(verdict)
        return {
            name: {
                "pretouch": pretouch_rates(own, (MATCHED, OURS)),
                "contact": contact_rates(own, (STRONGEST, "level")),
            }
            for name, own in groups.items()
        }

    return {
        "thresholds": dict(thresholds),
        "pretouch": pretouch_rates(verdicts, (*PRETOUCH, BOTH_CHANNELS, CLAIRVOYANT)),
        "contact": contact_rates(verdicts, CONTACT),
        "objects": by(lambda event: event.object),
        "sides": by(lambda event: f"{event.side}, {event.speed_m_s:g} m/s"),
        "kinds": by(lambda event: event.kind),
    }


def main(quick: bool = False) -> None:
    """Run the study, print its progress; writes results/pretouch.json."""
    started_s, size = time.perf_counter(), QUICK if quick else FULL
    with workers() as pool:

        def judged(thresholds: Mapping[str, float], work: Iterable[Event]) -> list[Verdict]:
            return in_parallel(partial(judge, thresholds=thresholds), work, pool)

        own = calibrate(0.0, size, pool)
        progress("thresholds at the plant's default echo")
        thresholds = calibrate(float(WEAKER_DB), size, pool)
        matched = judged(thresholds, events(SEED_TEST, size["all"], weaker_db=float(WEAKER_DB)))
        progress(f"{len(matched)} passages at that echo")
        plain = judged(own, events(SEED_TEST + 1, size["plain"]))
        soft, sweep = {}, {}
        for db in (0, WEAKER_DB):
            at = thresholds if db else own
            work = events(SEED_TEST + 2, (size["soft"], size["soft"], 0), SOFT, float(db))
            soft[str(db)] = _all_rates(judged(at, work), at)
        for db in SWEEP_DB:
            work = events(SEED_SWEEP, (0, 1, 0), weaker_db=float(db))
            sweep[str(db)] = pretouch_rates(judged(own, work), (MATCHED, OURS))
    bounded = [v for v in matched if CLAIRVOYANT in v.seen_m]
    study = {
        "simulated": True,
        "weaker_db": WEAKER_DB,
        "passages": len(matched),
        "matched": _all_rates(matched, thresholds),
        "matched_but_top": contact_rates([v for v in matched if v.event.side != "top"], CONTACT),
        "beside_the_bound": pretouch_rates(bounded, (CLAIRVOYANT, OURS)),
        "plain": _all_rates(plain, own),
        "soft": soft,
        "sweep": sweep,
        "wall_s": time.perf_counter() - started_s,
    }
    save("pretouch", study, quick=quick)
