"""Contact from the finger's resonance: the paper's detector, its best rival and ours on simulated approaches.

`python -m benchmarks contact`. The plant alone, without loop and devices. Thresholds at equal false contacts are set on
separate approaches. Detectors learn from the same baseline of 10 s; a rival's best settings are chosen on the ones that
set the thresholds.
"""

import math
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from hashlib import sha256
from typing import Any

import numpy as np
from scipy.stats import norm

from behaviors.events import BaselineRefused, Contact, ContactLost
from benchmarks.results import ROOT, in_parallel, kept, save, workers
from controller.detectors.resonance import ResonanceDetector, ResonanceSettings
from controller.detectors.resonance_paper import ResonancePaperDetector, ResonancePaperSettings
from drivers.core.messages import Floats, SampleBlock
from simulator.physics.finger import FingerPlant, FingerSettings

Trace = tuple[Floats, Floats]
"""Times, s, and a statistic that a contact raises."""

SEED_SET, SEED_JUDGED, SEED_HELD, SEED_BOUND = 11, 12, 13, 14
"""Of approaches that set thresholds, and of those judged."""

PROFILES = ROOT / "config" / "profiles" / "mock"

RATE_HZ = 1000.0
"""Of the waveforms, as on the bench's board."""

SETTLE_S, BASELINE_S = 90.0, 10.0
"""Settling: paper III.B. Baseline: what every detector but the paper's own is given."""

STOPS_S, HOLD_S, RETRACT_M_S, AFTER_S = 0.15, 1.5, 0.010, 1.0
"""The probe stops this long after the first touch, stands, retracts; then the finger is recorded on."""

LISTENS_S = 0.6
"""How long after the touch a detector may take where nothing is held."""

GAP_M = (0.003, 0.004)
"""The probe's travel before the touch, uniformly distributed: the first touch meets the oscillation at any phase."""


def rows() -> list[tuple[str, float]]:
    """Location and speed (m/s) of Table I's rows, as `mock/transient` has them."""
    trials = tomllib.loads((PROFILES / "transient.toml").read_text(encoding="utf-8"))["trials"]["list"]
    return [(str(row["location"]), float(row["speed_m_s"])) for row in trials]


def level(name: str) -> FingerSettings:
    """The finger of `mock/transient_NAME`."""
    profile = tomllib.loads((PROFILES / f"transient_{name}.toml").read_text(encoding="utf-8"))
    return FingerSettings(**profile["plant"])


@dataclass(frozen=True, eq=False)
class ApproachScene:
    """The board's recording of one approach, from the baseline's start on, and the truth.

    Attributes:
        ends_s, periods_s: The oscillator's periods.
        times_s, accelerometer, force_n: Waveforms at `RATE_HZ`.
        starts_s: Start of the probe's motion and end of the baseline.
        contacts: (time, made or lost).
        stops_s: When the probe stands.
    """

    ends_s: Floats
    periods_s: Floats
    times_s: Floats
    accelerometer: Floats
    force_n: Floats
    starts_s: float
    contacts: tuple[tuple[float, bool], ...]
    stops_s: float

    @property
    def touch_s(self) -> float:
        """The first touch."""
        return next(t_s for t_s, made in self.contacts if made)


def approach(
    s: FingerSettings,
    seed: int,
    trial: int,
    row: tuple[str, float],
    hold_s: float = HOLD_S,
    noise: float = 1.0,
    touching: bool = True,
) -> ApproachScene:
    """One approach: settle, baseline, approach until `STOPS_S` after the touch, hold, retract.

    Args:
        s: The finger.
        seed, trial: They key the noise and draw the gap.
        row: Location and speed, m/s.
        hold_s: Time at standstill; 0 ends the scene where the probe would stop.
        noise: Factor on every noise once the baseline has ended.
        touching: Whether the probe is there: without it the same finger in the same noise is recorded for as long.
    """
    location, speed_m_s = row
    rng = np.random.default_rng((seed, trial))
    gap_m = float(rng.uniform(*GAP_M))
    plant = FingerPlant(s)
    plant.begin(key=(seed, trial), location=location, gap_m=gap_m if touching else 1.0)
    plant.excite(True)
    plant.advance(SETTLE_S)
    starts_s = SETTLE_S + BASELINE_S
    plan = [(SETTLE_S, 0.0, 0.0, 0.0), (starts_s, 0.0, speed_m_s, 0.0)]
    plant.move_probe(plan)
    observed = frozenset({"accelerometer", "load_cell", "period"})
    pieces: dict[str, list[Floats]] = {"accelerometer": [], "load_cell": []}
    contacts: list[tuple[float, bool]] = []
    ends: list[Floats] = []
    periods: list[Floats] = []
    now = round(SETTLE_S * RATE_HZ)

    def until(t_s: float) -> None:
        nonlocal now
        plant.advance(t_s, observed)
        last = int(np.floor(t_s * RATE_HZ + 1e-6))
        times_s = np.arange(now + 1, last + 1) / RATE_HZ
        for name in observed - {"period"}:
            pieces[name].append(plant.sample(name, times_s))
        e, p = plant.periods()
        ends.append(e)
        periods.append(p)
        contacts.extend(plant.contacts())
        now = last

    if noise != 1.0:
        until(starts_s)
        plant.settings = s.model_copy(update={"noise_scale": noise * s.noise_scale})
        plant.set_tendon(0.0)  # its former value: the finger is rebuilt from its settings
    reach_s = starts_s + (gap_m - 0.001) / speed_m_s
    until(round(reach_s, 3))
    while (
        touching and not contacts
    ):  # the swing meets the probe up to a millimetre before the resting surface
        until(round(plant.t_s + 0.02, 3))
    touch_s = contacts[0][0] if touching else reach_s + 0.5
    stops_s = round(touch_s + (STOPS_S if hold_s else LISTENS_S), 3)
    until(stops_s)
    if hold_s:
        there_m, leaves_s = (stops_s - starts_s) * speed_m_s, stops_s + hold_s
        away_s = 0.004 / RETRACT_M_S
        gone = (leaves_s + away_s, there_m - 0.004, 0.0, 0.0)
        plant.move_probe([(stops_s, there_m, 0.0, 0.0), (leaves_s, there_m, -RETRACT_M_S, 0.0), gone])
        until(round(leaves_s + away_s + AFTER_S, 3))
    times_s = np.arange(round(SETTLE_S * RATE_HZ) + 1, now + 1) / RATE_HZ
    accelerometer, force_n = (np.concatenate(parts) for parts in pieces.values())
    found = (np.concatenate(ends), np.concatenate(periods), times_s, accelerometer, force_n)
    return ApproachScene(*found, starts_s, tuple(contacts), stops_s)


# --- detectors ---------------------------------------------------------------------------------


def average(scene: ApproachScene, samples: int, sample_hz: float | None) -> Trace:
    """The paper's: a moving average of the frequency, in standard deviations of the baseline's averages."""
    settings = ResonancePaperSettings(
        average_samples=samples, sample_hz=sample_hz, baseline_s=BASELINE_S - 1.0
    )
    times_s, found = ResonancePaperDetector("contact", settings).deviations(scene.ends_s, scene.periods_s)
    return times_s, found["average"]


def period_innovations(scene: ApproachScene, order: int) -> Trace:
    """Innovations of an autoregressive model of the periods' frequencies, in deviations of the baseline's, whose first
    second is left out."""
    frequency, times_s = 1.0 / scene.periods_s, scene.ends_s
    n = int(np.sum(times_s < scene.starts_s))
    y = frequency - frequency[:n].mean()
    off: Floats = np.convolve(y, np.concatenate([[1.0], -_predicting(y[:n], order)]))[: len(y)]
    off[:order] = 0.0
    base = off[(times_s >= SETTLE_S + 1.0) & (times_s < scene.starts_s)]
    return times_s, (off - base.mean()) / base.std(ddof=1)


def _predicting(x: Floats, order: int) -> Floats:
    """Weights of the last values, which predict the next: least squares."""
    past = np.column_stack([x[order - lag - 1 : -lag - 1] for lag in range(order)])
    return np.asarray(np.linalg.lstsq(past, x[order:], rcond=None)[0])


def ours(scene: ApproachScene, senses: str = "all") -> Trace:
    """The detector of the program, its deviations."""
    times_s, found = _deviations(scene)
    return times_s, found[senses]


@lru_cache(maxsize=1)
def _deviations(scene: ApproachScene) -> tuple[Floats, Mapping[str, Floats]]:
    detector = ResonanceDetector("contact", ResonanceSettings(baseline_s=BASELINE_S))
    return detector.deviations(scene.times_s, scene.accelerometer)


PAPER, AR, OURS = "paper's criterion at its best", "AR innovations", "ours"

VARIANTS: Mapping[str, Mapping[str, Callable[[ApproachScene], Trace]]] = {
    PAPER: {
        f"{samples} {'period' if rate is None else 'sample'}{'s' * (samples > 1)}"
        f"{'' if rate is None else f' at {rate:g} Hz'}": partial(average, samples=samples, sample_hz=rate)
        for samples in (1, 2, 10)
        for rate in (15.0, None)
    },
    AR: {f"order {order}": partial(period_innovations, order=order) for order in (4, 6)},
    OURS: {"all": ours},
    **{
        f"ours, {senses} alone": {senses: partial(ours, senses=senses)}
        for senses in ("phase", "frequency", "amplitude")
    },
}
"""Every detector with the settings it may choose from: rivals, and ours in parts."""

# --- equal false contacts ----------------------------------------------------------------------


IN_TIME_S = 0.07
"""The goal: two periods."""

Key = tuple[str, str]
"""Detector and variant."""

RATES = (1e-1, 1e-2, 1e-3, 1e-4)
"""False contacts an approach at which all are compared; `EQUAL` of them in the table."""

EQUAL = 1e-3
"""One false contact in 1,000 approaches, from an exponential fitted to the tail of another 1,000. For a normal
tail this exceeds the largest of them."""


@dataclass
class Record:
    """Results of one variant: the largest statistic before each touch, and its rising maxima after it."""

    before: list[float] = field(default_factory=list)
    after: list[tuple[Floats, Floats]] = field(default_factory=list)
    mean_n: list[Floats] = field(default_factory=list)


def add(records: dict[Key, Record], scene: ApproachScene) -> None:
    """Apply every variant to an approach."""
    for name, variants in VARIANTS.items():
        for variant, detector in variants.items():
            times_s, s = detector(scene)
            mine = records.setdefault((name, variant), Record())
            free = (times_s > scene.starts_s) & (times_s < scene.touch_s)
            late = times_s >= scene.touch_s
            mine.before.append(float(s[free].max()) if free.any() else 0.0)
            highest = np.maximum.accumulate(s[late]) if late.any() else np.empty(0)
            new = np.flatnonzero(np.diff(highest, prepend=-np.inf) > 0.0)
            mine.after.append((times_s[late][new] - scene.touch_s, highest[new]))
            mine.mean_n.append(_mean_force(scene, times_s[late][new]))


def _mean_force(scene: ApproachScene, at_s: Floats) -> Floats:
    """Force over the oscillation that ends at some times, as Table I's measure has it, N."""
    sums = np.concatenate([[0.0], np.cumsum(scene.force_n)])
    period = round(1000.0 * float(np.median(scene.periods_s)))
    ends = np.searchsorted(scene.times_s, at_s, side="right")
    means: Floats = (sums[ends] - sums[ends - period]) / period
    return means


def batch(settings: Mapping[str, Any], seed: int, trials: Iterable[int], **scene: Any) -> dict[Key, Record]:
    """Results of all variants on some approaches over Table I's rows."""
    records: dict[Key, Record] = {}
    finger, places = FingerSettings.model_validate(settings), rows()
    for trial in trials:
        add(records, approach(finger, seed, trial, places[trial % len(places)], hold_s=0.0, **scene))
    return records


def joined(parts: Sequence[Mapping[Key, Record]]) -> dict[Key, Record]:
    """Results of several batches joined."""
    return {
        key: Record(
            [value for part in parts for value in part[key].before],
            [value for part in parts for value in part[key].after],
            [value for part in parts for value in part[key].mean_n],
        )
        for key in parts[0]
    }


def threshold(before: Sequence[float], rate: float) -> float:
    """Threshold exceeded in a share `rate` of approaches: exponential fitted to the largest twentieth."""
    ordered = np.sort(before)[::-1]
    tail = max(5, len(ordered) // 20)
    base = float(ordered[tail])
    scale = float((ordered[:tail] - base).mean())
    return base + scale * float(np.log(tail / len(ordered) / rate))


def judged(record: Record, limit: float) -> dict[str, float]:
    """False contacts, delays (s) and forces (N) at a threshold."""
    delays = np.full(len(record.after), np.inf)
    forces = np.zeros(len(record.after))
    for i, (times_s, highest) in enumerate(record.after):
        place = int(np.searchsorted(highest, limit, side="right"))
        if place < len(times_s):
            delays[i], forces[i] = times_s[place], record.mean_n[i][place]
    found = np.isfinite(delays)
    return {
        "false": float(np.sum(np.asarray(record.before) > limit)),
        "missed": float(np.sum(~found)),
        "median_s": float(np.median(delays)),
        "p95_s": float(np.sort(delays)[int(np.ceil(0.95 * len(delays))) - 1]),
        "in_time": float(np.mean(delays <= IN_TIME_S)),
        "force_max_n": float(forces.max()) if found.any() else float("nan"),
        "threshold": limit,
    }


def compared(
    setting: Mapping[Key, Record], test: Mapping[Key, Record], rate: float = EQUAL
) -> dict[str, dict[str, Any]]:
    """Each detector at its best variant: the one with most contacts in time on the approaches that set thresholds."""
    found: dict[str, dict[str, Any]] = {}
    for name, variants in VARIANTS.items():
        limits = {variant: threshold(setting[name, variant].before, rate) for variant in variants}
        own = {variant: judged(setting[name, variant], limits[variant]) for variant in variants}
        _, _, best = max((own[variant]["in_time"], -own[variant]["p95_s"], variant) for variant in variants)
        found[name] = {"variant": best, **judged(test[name, best], limits[best])}
    return found


# --- hold and end ------------------------------------------------------------------------------


FELT_N, FELT_S = 0.005, 0.1
"""The load cell feels the finger above this force (paper IV.B), and between two such moments no farther apart."""

MEAN_SAMPLES = 10
"""Of the load cell, 10 ms: a single sample of the hard finger's, with 1.6 mN of noise, exceeds that force by itself."""


def felt_s(scene: ApproachScene) -> Floats:
    """When the load cell feels the finger."""
    force_n = np.convolve(scene.force_n, np.full(MEAN_SAMPLES, 1.0 / MEAN_SAMPLES))[: len(scene.force_n)]
    return scene.times_s[force_n > FELT_N]


def held(name: str, count: int) -> dict[str, float]:
    """Gaps in contact while the load cell feels it, and delay of the end; with default settings."""
    gaps, ends = [], []
    for trial in range(count):
        scene = approach(level(name), SEED_HELD, trial, rows()[trial % len(rows())])
        values, begin_s = scene.accelerometer[:, None], float(scene.times_s[0])
        block = SampleBlock("board.accelerometer", 0, begin_s, values, rate_hz=RATE_HZ, unit="m/s2")
        events = ResonanceDetector("contact", ResonanceSettings()).push(block)
        begun = [event.t_s for event in events if isinstance(event, Contact)]
        lost = [event.t_s for event in events if isinstance(event, ContactLost)]
        felt = felt_s(scene)
        left_s = max(t_s for t_s, made in scene.contacts if not made)
        spans = np.split(felt, np.flatnonzero(np.diff(felt) > FELT_S) + 1)
        off = [(t_s, min([b for b in begun if b > t_s], default=np.inf)) for t_s in lost]
        lasting = (min(to, span[-1]) - max(since, span[0]) for since, to in off for span in spans)
        gaps.append(max(lasting, default=0.0))
        ends.append(lost[-1] - left_s if lost and lost[-1] > left_s else np.inf)
    return {
        "approaches": count,
        "held": float(np.mean(np.asarray(gaps) <= 0.1)),
        "longest_gap_s": float(max(0.0, *gaps)),
        "end_median_s": float(np.median(ends)),
        "end_detected": float(np.mean(np.asarray(ends) <= 1.0)),
    }


# --- the bound for any detector ----------------------------------------------------------------


HELD = 8
"""Samples that are averaged, 8 ms: the plant holds its noise so long, and below that there is none to be whitened."""

ORDER = 30
"""Of the autoregressive model of the free waveform: 0.24 s."""

STEPS = 38
"""Steps evaluated after the touch: 0.3 s."""

KNOWN, UNKNOWN = (float(norm.isf(rate)) for rate in (1e-3, 1e-3 * 0.008 / 0.7))
"""Thresholds for one false contact in 1,000 approaches: for a known instant, and for a look every 8 ms of 0.7 s."""


def separations(name: str, count: int, first: int = 0) -> Floats:
    """Deflection of the matched filter after each 8 ms, in standard deviations, shape (count, STEPS).

    The same approach is simulated with and without the probe, in the same noise: the difference is the
    contact's effect. Whitened by the model learned from the free finger's baseline, and divided by its deviation, its
    norm is the distance of the two hypotheses for an observer that knows it (Neyman and Pearson); in Gaussian noise no
    test does better.
    """
    found = np.zeros((count, STEPS))
    for i in range(count):
        there, free = (
            approach(
                level(name), SEED_BOUND, first + i, rows()[(first + i) % 14], hold_s=0.0, touching=touching
            )
            for touching in (True, False)
        )
        x = free.accelerometer[: round(BASELINE_S * RATE_HZ)].reshape(-1, HELD).mean(axis=1)
        x = x - x.mean()
        whitener = np.concatenate([[1.0], -_predicting(x, ORDER)])
        sigma = float(np.convolve(x, whitener)[ORDER : len(x)].std())
        begins = int(np.searchsorted(there.times_s, there.touch_s))
        span = slice(begins, begins + STEPS * HELD)
        added = (there.accelerometer[span] - free.accelerometer[span]).reshape(-1, HELD).mean(axis=1)
        white = np.convolve(added, whitener)[:STEPS]
        found[i] = np.sqrt(np.cumsum(white**2)) / sigma
    return found


def bound(found: Floats) -> dict[str, dict[str, float]]:
    """Share detected within 36 and 70 ms, and when half and 95 % are (s; infinity beyond 0.3 s)."""
    result = {}
    for name, limit in (("known", KNOWN), ("unknown", UNKNOWN)):
        shares = norm.cdf(found - limit).mean(axis=0)
        after = [float(HELD / RATE_HZ * (1 + int(np.argmax(shares >= q)))) for q in (0.5, 0.95)]
        result[name] = {
            "within_36_ms": float(shares[3]),
            "within_70_ms": float(shares[7]),
            "half_s": after[0] if shares[-1] >= 0.5 else float("inf"),
            "p95_s": after[1] if shares[-1] >= 0.95 else float("inf"),
        }
    return result


# --- louder noise, and hum ---------------------------------------------------------------------


FRESH = 1000
"""First of the approaches judged here: no constant was chosen on these."""

HARMONIC = 0.71
"""The oscillation's own share of the simulated waveform's deviation; the rest is noise and harmonics."""

DISTURBED: Mapping[str, tuple[float, float, bool]] = {
    "as in the baseline": (1.0, 0.0, False),
    "noise +30 % after the baseline": (1.3, 0.0, False),
    "noise twice as large after the baseline": (2.0, 0.0, False),
    "hum of 20 %, always": (1.0, 0.2, False),
    "hum of 20 %, after the baseline": (1.0, 0.2, True),
}
"""Factor on the noise, a hum's share of the oscillation at 50 Hz, and whether it begins with the motion."""


def disturbed(finger: str, count: int) -> dict[str, dict[str, int]]:
    """False, in time, late, missed and refused of approaches in each disturbance, with default settings."""
    found: dict[str, dict[str, int]] = {}
    for trial in range(count):
        for name, (noise, hum, later) in DISTURBED.items():
            row = rows()[trial % len(rows())]
            scene = approach(level(finger), SEED_JUDGED, FRESH + trial, row, hold_s=0.0, noise=noise)
            t_s, x = scene.times_s, scene.accelerometer
            amplitude = hum * math.sqrt(2.0) * HARMONIC * float(x[:10_000].std())
            begins_s = scene.starts_s if later else 0.0
            x = x + amplitude * np.sin(2.0 * math.pi * 50.0 * t_s + 0.7) * (t_s >= begins_s)
            block = SampleBlock("board.accelerometer", 0, float(t_s[0]), x[:, None], rate_hz=RATE_HZ)
            events = ResonanceDetector("contact", ResonanceSettings()).push(block)
            at_s = [event.t_s - scene.touch_s for event in events if isinstance(event, Contact)][:1]
            verdict = "missed"
            if isinstance(events[0], BaselineRefused):
                verdict = "refused"
            elif at_s:
                verdict = "false" if at_s[0] < 0.0 else "in time" if at_s[0] <= IN_TIME_S else "late"
            counts = found.setdefault(
                name, dict.fromkeys(("false", "in time", "late", "missed", "refused"), 0)
            )
            counts[verdict] += 1
    return found


# --- all of it ---------------------------------------------------------------------------------


CHUNK = 50

SOME = 28
"""Approaches with each assumption broken: two per row of Table I."""

LEVELS = ("printed", "hard")

CHANGES: Mapping[str, Mapping[str, float]] = {
    "tendon friction of 50 uN m": {"tendon_friction_n_m": 5e-5},
    "ripple of 10 % at 100 Hz": {"drive_ripple": 0.1},
    "drift of the frequency by 1 % a minute": {"drift_1_s": 2.0 * 0.01 / 60.0},
    # a fortieth of the oscillation
    "vibration at 12 Hz": {"vibration_m_s2": 0.05, "vibration_hz": 12.0},
    "vibration at 28 Hz": {"vibration_m_s2": 0.05, "vibration_hz": 28.0},
    "sliding probe, 0.3 times 8 mm": {"slide_m": 0.0024},
}
"""Further effects of a real finger, one by one. Their sizes are assumptions."""

BROKEN = (0.05, 0.1, 0.3)

TAKEN: Mapping[str, tuple[Sequence[str], int]] = {
    "resonance higher": (("joint_n_m_rad",), 2),
    "Q lower": (("joint_n_m_s_rad", "base_n_m_s_rad"), 1),
    "drive weaker": (("drive_n_m",), -1),
    "contact softer": (("pad_n_m", "back_n_m"), -1),
    "more of the noise slow": (("wander",), 1),
}
"""Settings of the finger that differ from the one used for thresholds, and the exponent."""


def tasks(quick: bool) -> Iterator[tuple[str, partial[Any]]]:
    """All parts by name: what is judged, the bound, the hold, louder noise, and each assumption broken."""
    some = 7 if quick else SOME
    for name in LEVELS:
        finger = level(name).model_dump()
        for seed, many in ((SEED_SET, 500), (SEED_JUDGED, 1000)):
            for first in range(0, CHUNK if quick else many, CHUNK):
                yield f"{name}|{seed}|{first}", partial(batch, finger, seed, range(first, first + CHUNK))
        yield f"{name}|held", partial(held, name, 7 if quick else 98)
        yield f"{name}|bound", partial(separations, name, 7 if quick else 56)
        yield f"{name}|disturbed", partial(disturbed, name, 14 if quick else 100)
    printed, own = level("printed").model_dump(), range(some)
    yield "none|broken", partial(batch, printed, SEED_JUDGED, own)
    for share in BROKEN:
        about = f"noise {share:.0%} larger after the baseline"
        yield f"{about}|broken", partial(batch, printed, SEED_JUDGED, own, noise=1.0 + share)
    for name, (settings, power) in TAKEN.items():
        for share in BROKEN:
            changed = {each: printed[each] * (1.0 + share) ** power for each in settings}
            yield f"{name} by {share:.0%}|broken", partial(batch, printed | changed, SEED_JUDGED, own)
    for name, other in CHANGES.items():
        yield f"{name}|broken", partial(batch, {**printed, **other}, SEED_JUDGED, own)


def _done(task: tuple[str, partial[Any]]) -> Any:
    name, compute = task
    return kept(
        "contact_" + sha256(repr((name, compute.args, compute.keywords)).encode()).hexdigest()[:16], compute
    )


def main(quick: bool = False) -> None:
    """Run the study, or the rest of it; writes results/contact.json."""
    wanted = list(tasks(quick))
    with workers() as pool:
        done = in_parallel(_done, wanted, pool)
    save("contact", figures({name: each for (name, _), each in zip(wanted, done, strict=True)}), quick=quick)


def figures(done: Mapping[str, Any]) -> dict[str, Any]:
    """All figures of the study."""

    def records(name: str, seed: int) -> dict[Key, Record]:
        return joined([each for key, each in done.items() if key.startswith(f"{name}|{seed}|")])

    setting = {name: records(name, SEED_SET) for name in LEVELS}
    test = {name: records(name, SEED_JUDGED) for name in LEVELS}
    tables = {name: [compared(setting[name], test[name], rate) for rate in RATES] for name in LEVELS}
    broken = {key.split("|")[0]: each for key, each in done.items() if key.endswith("|broken")}
    return {
        "approaches": [len(each["hard"][OURS, "all"].before) for each in (setting, test)],
        "levels": {name: compared(setting[name], test[name]) for name in LEVELS},
        "curves": {
            name: {detector: [table[detector] for table in tables[name]] for detector in VARIANTS}
            for name in LEVELS
        },
        "broken": {name: compared(setting["printed"], each) for name, each in broken.items()},
        "held": {name: done[f"{name}|held"] for name in LEVELS},
        "bound": {name: bound(done[f"{name}|bound"]) for name in LEVELS},
        "disturbed": {name: done[f"{name}|disturbed"] for name in LEVELS},
    }
