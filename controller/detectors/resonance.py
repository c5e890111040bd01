"""Contact from the waveform of an oscillating finger: phase and amplitude against their prediction."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from behaviors.events import BaselineReady, BaselineRefused, Contact, ContactHeld, ContactLost, Detected
from controller.detectors.protocol import Quantity, decisions
from controller.detectors.stream import OnStream
from drivers.core.messages import Floats, SampleBlock
from drivers.core.settings import BaselineS, Settings, StreamName

HOPS = 9
"""Values of the envelope in a free period: one each 4 ms at 28 Hz."""

HORIZONS, PERIODS, LEVELS = (HOPS, 2 * HOPS), 6, 3
"""What is predicted: amplitude and phase one period and two ahead, in hops, from the frequencies of six periods and the
amplitudes of three. Chosen on the finger of mock/transient_hard (benchmarks/contact), where from four to ten periods
little changes."""

PERIODS_SHARE = 6
"""A baseline of fewer than four times `PERIODS` periods has one of the memory for each so many, one at least: 0.3 s are
eight periods at 28 Hz. Assumption."""

PRIOR_VALUES = 100.0
"""What the plain prediction (frequency and amplitude stay) is worth, in independent values of the baseline: of 14, 40,
100 and 300 the one with most contacts in time at few false ones, on 500 other approaches of that finger."""

DIRECTIONS = {
    "all": (-0.1, 1.0, -0.1, 1.0),
    "phase": (0.0, 1.0, 0.0, 1.0),
    "amplitude": (-1.0, 0.0, -1.0, 0.0),
    "frequency": (0.0, -1.0, 0.0, 1.0),
}
"""What a contact does, in deviations of the free finger: (logarithm of the amplitude, phase) for each horizon. A
contact stiffens the finger, so the phase leads; the swing's energy is cut a little. Frequency is the phase gained
between the two."""

QUIET, SURPRISE = 3.0, 4.5
"""Deviations within which the oscillation is as before the contact: frequency and amplitude, and the residual, which is
large while the loop locks again. Chosen on 224 approaches with a held contact."""

DOUBT = 3
"""A hop that is not as before cancels this many that were. Chosen there as well."""

NOISE_S, LOUDER = 0.15, 1.5
"""Memory of the noise that is followed, s: where it is so many times as loud as the baseline's, more than a quiet
stretch is by chance, deviations are over it. The last two periods are left out, a contact's own. Chosen on 60
approaches with louder noise (benchmarks/contact)."""

MAINS_HZ, HUM, LINE_HZ = (50.0, 60.0), 0.1, 1.0
"""Lines of the mains; a baseline with one beyond this share of the oscillation is refused, for a hum beats with the
finger; and how near the oscillation's own frequency a line cannot be told from it."""

FLOOR, LEAST_VALUES = 0.03, 12.0
"""Least deviation of a residual, rad or relative, in a baseline of fewer independent values: half a percent of the
frequency over a period. With it a short baseline is worth that many. Assumptions."""

SMOOTH = 20.0
"""What is this many times as fast as `free_hz_to`, or faster, is averaged away where the rate allows it. Assumption."""

PATIENCE = 2.0
"""A sample lost so many times `baseline_s` after the first, before a baseline was whole, refuses it. Assumption: the
cause is named before a trial's deadline."""

PERIODS_A_VALUE = 2.0
"""Values of the baseline this many periods apart are independent. Assumption: twice the window."""


class ResonanceSettings(Settings):
    """Settings of the detector. Times are in periods of the finger, which it learns, or in seconds."""

    input: StreamName = "board.accelerometer"
    """Waveform of the finger's oscillation, at a fixed rate of ten samples a period or more."""

    baseline_s: BaselineS = Field(default=10.0, ge=0.3, le=600.0)
    """Time without contact in which the free oscillation is learned, s. A short one raises the threshold, as
    Student's t does for a normal deviate."""

    threshold: float = Field(default=4.6, gt=0.0, le=1e3)
    """Contact threshold in deviations of the free finger, for a long baseline. Chosen on 500 simulated
    approaches to the hard finger: by the tail of their maxima one in 10,000 exceeds it (benchmarks/contact)."""

    senses: Literal["all", "phase", "amplitude", "frequency"] = "all"
    """Which quantity of the waveform is compared with the threshold."""

    stiffness: Literal["rises", "falls", "either"] = "rises"
    """What a contact does to the oscillator's stiffness. With "either" any departure counts, whatever `senses` says."""

    free_hz_from: float = Field(default=15.0, gt=0.0, le=1e4)
    """The free finger oscillates no slower, Hz: else the baseline is refused; the peak is looked for from half of this
    to half again `free_hz_to`. Assumption: half of the paper's 28."""

    free_hz_to: float = Field(default=42.0, gt=0.0, le=1e4)
    """And no faster, Hz. Assumption: half again the paper's 28, which leaves room for flexion; full contact has 50."""

    erratic: float = Field(default=0.05, gt=0.0, le=1.0)
    """Spread of the frequency from period to period, relative, beyond which a baseline is taken to be in contact. Light
    contact has 0.1 (paper IV.A, as text; the simulated finger), the hard finger 0.02 without contact."""

    creep: float = Field(default=0.06, gt=0.0, le=1.0)
    """A lasting rise of the frequency above the followed one, relative, is contact as well, however slow."""

    follow_s: float = Field(default=10.0, gt=0.0, le=3600.0)
    """Memory of that frequency, s. It stands still while there is contact."""

    hold_s: float = Field(default=0.1, ge=0.0, le=600.0)
    """Contact persists after this time, s."""

    release_s: float = Field(default=0.6, gt=0.0, le=600.0)
    """Contact has ended when the oscillation has been as it was before for so long, s: seventeen periods, for in light
    contact single ones look free."""

    max_gap_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """A longer silence clears the contact; the baseline stays."""


class ResonanceDetector(OnStream[ResonanceSettings]):
    """Contact where the oscillation leads the prediction from its last periods.

    The waveform is mixed with the free frequency and averaged over one free period, which leaves amplitude and phase.
    Phase and amplitude one and two periods ahead are predicted from the six periods before, with weights learned from
    the baseline. The statistic is a weighted sum of the four residuals, whitened by their covariance in the baseline:
    slow drift is followed, contact is not learned. Emits `BaselineReady` (`value`: the free frequency in Hz;
    `threshold`: the frequency that a lasting rise within a period would have to reach) or `BaselineRefused`, then
    `Contact`, `ContactHeld` once after `hold_s`, and `ContactLost`.

    Lost samples, or ones that are not finite, restart the memory: no events for some eight periods.
    """

    doing = "reading a waveform (period counts are for resonance.paper)"

    def __init__(self, name: str, settings: ResonanceSettings) -> None:
        sensed = "phase and amplitude" if settings.senses == "all" else settings.senses
        self.quantity = Quantity(f"departure of {sensed} from the prediction", "σ", learned="Hz")
        super().__init__(name, settings)

    def reset(self) -> None:
        """Return to the initial state."""
        super().reset()
        self._envelope: Envelope | None = None
        self._raw: list[Floats] = []
        self._raw_times: list[Floats] = []
        self._collected = 0
        self._refused = False
        self._first_s = self._last_s = math.nan
        self._broken = 0
        self._contact_s = math.nan
        self._held_reported = False
        self._forget()

    def _forget(self) -> None:
        """Restart the memory: the next prediction needs all of it."""
        self._past = np.empty((0, 3))  # time, logarithm of the amplitude, phase
        self._quiet_hops = 0
        self._noise, self._recent = 1.0, [1.0] * HORIZONS[-1]
        if self._envelope is not None:
            self._envelope.restart()

    def _channels(self) -> Sequence[int]:
        return (0,)

    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        return self._interrupted(block.times[:1])

    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        x, events = values[:, 0], list[Detected]()
        if math.isnan(self._first_s) and len(times_s):
            self._first_s = float(times_s[0])
        # runs of finite samples, one after the other
        edges = np.flatnonzero(np.diff(np.isfinite(x).astype(np.int8))) + 1
        for times, part in zip(np.split(times_s, edges), np.split(x, edges), strict=True):
            if not len(part):
                continue
            if not math.isfinite(part[0]):
                events += self._interrupted(times)
            elif not self._refused:
                events += self._finite(times, part, rate_hz)
                self._last_s = float(times[-1])
        return events

    def _interrupted(self, without_s: Floats) -> list[Detected]:
        self._forget()
        if self._envelope is None:
            return self._again(without_s)
        too_long_s = without_s[without_s - self._last_s > self.settings.max_gap_s]
        if math.isnan(self._contact_s) or not len(too_long_s):
            return []
        self._contact_s, self._held_reported = math.nan, False
        return [ContactLost(float(too_long_s[0]), self.name, 0.0, self._limit)]

    def _again(self, without_s: Floats) -> list[Detected]:
        """Begin the baseline again, for it must not span a gap, or refuse it."""
        self._broken += self._collected > 0
        self._raw, self._raw_times, self._collected = [], [], 0
        wanted_s = self.settings.baseline_s
        late_s = without_s[without_s - self._first_s > PATIENCE * wanted_s]
        if self._refused or not self._broken or not len(late_s):
            return []
        self._refused, t_s = True, float(late_s[0])
        every_s = (t_s - self._first_s) / self._broken
        reason = (
            f"samples are lost, or not finite, every {every_s:.2g} s: a baseline needs {wanted_s:g} s without a gap;"
            " is the line, or the computer, too slow?"
        )
        return [BaselineRefused(t_s, self.name, math.nan, math.nan, reason)]

    def _finite(self, times_s: Floats, x: Floats, rate_hz: float) -> list[Detected]:
        if self._envelope is not None:
            return self._follow(*self._envelope.push(times_s, x - self._mean))
        wanted = max(2, round(self.settings.baseline_s * rate_hz))
        taken = min(wanted - self._collected, len(x))
        self._raw.append(x[:taken])
        self._raw_times.append(times_s[:taken])
        self._collected += taken
        if self._collected < wanted:
            return []
        learnt = self._learn(np.concatenate(self._raw_times), np.concatenate(self._raw), rate_hz)
        self._raw, self._raw_times = [], []
        rest = (
            self._finite(times_s[taken:], x[taken:], rate_hz) if taken < len(x) and not self._refused else []
        )
        return [learnt, *rest]

    # the baseline

    def _learn(self, times_s: Floats, x: Floats, rate_hz: float) -> Detected:
        """Learn free frequency, and mean and covariance of the residuals."""
        t_s, settings = float(times_s[-1]), self.settings
        free_hz = _frequency(x - x.mean(), rate_hz, 0.5 * settings.free_hz_from, 1.5 * settings.free_hz_to)
        found, reason = np.empty((0, 3)), ""
        if not settings.free_hz_from <= free_hz <= settings.free_hz_to:
            reason = (
                f"the finger oscillates at {free_hz:.3g} Hz, free it would at {settings.free_hz_from:g} to"
                f" {settings.free_hz_to:g}: is the excitation on, is something touching?"
            )
        elif HOPS * free_hz > rate_hz:
            reason = f"{rate_hz:g} samples a second are too few for {free_hz:.3g} Hz"
        elif hum := _hum(x - x.mean(), rate_hz, free_hz):
            reason = hum
        else:
            periods = len(x) / rate_hz * free_hz
            self._periods = (
                PERIODS if periods >= 4 * PERIODS else max(1, min(PERIODS, int(periods / PERIODS_SHARE)))
            )
            self._memory = self._periods * HOPS
            smooth = max(1, int(rate_hz / (SMOOTH * settings.free_hz_to)))
            self._envelope = Envelope(free_hz, rate_hz, HOPS, smooth)
            self._mean = float(x.mean())
            found = np.column_stack(self._envelope.push(times_s, x - self._mean))
            reason = self._unfit(found, free_hz)
        if reason:
            self._refused = True
            return BaselineRefused(t_s, self.name, free_hz, math.nan, reason)
        assert self._envelope is not None
        self._past = found[-(self._memory + HORIZONS[-1]) :]
        self._reference_hz = self._slow_hz = free_hz + float(_rates_hz(found, HOPS).mean())
        # effect of a lasting rise of 1 Hz on the weighted sum: phase gained over each horizon
        gains = self._weights[1::2] * np.asarray(HORIZONS) * 2.0 * math.pi * self._envelope.hop_s
        rise_hz = self._limit / float(gains.sum()) if gains.sum() > 0.0 else math.nan
        rise_hz *= -1.0 if settings.stiffness == "falls" else 1.0
        return BaselineReady(t_s, self.name, self._reference_hz, self._reference_hz + rise_hz)

    def _unfit(self, found: Floats, free_hz: float) -> str:
        """Learn from the baseline's envelope; why it cannot be learned from, or ""."""
        plain, seen = _features(found, self._periods)
        values = len(plain) / (PERIODS_A_VALUE * HOPS)
        if values < 1.5:
            return f"{self.settings.baseline_s:g} s are too short: seven periods and a half are needed"
        rates_hz = _rates_hz(found, HOPS)
        spread = min(float(rates_hz.std()), _robust(rates_hz[:, None])[1][0]) / free_hz
        if not spread > 0.0:
            return "no variance: is the oscillation locked, is the converter alive?"
        if spread > self.settings.erratic:
            return f"the frequency varies by {spread:.1%} from period to period: is something touching?"
        self._teach = _regression(plain, seen, PRIOR_VALUES / values)
        features = _residuals(plain, seen, self._teach)
        # robust: single knocks in the baseline do not widen it
        middle, scale = _robust(features)
        if not (scale > 0.0).all():
            return "no variance: is the oscillation locked, is the converter alive?"
        if values < LEAST_VALUES:
            scale = np.maximum(scale, FLOOR)
        z = np.clip((features - middle) / scale, -3.0, 3.0)
        correlation = np.corrcoef(z.T) + 1e-3 * np.eye(len(scale))
        self._middle, self._directions = middle, {}
        for senses, direction in DIRECTIONS.items():
            weights = np.linalg.solve(correlation, np.asarray(direction))
            weights /= math.sqrt(float(weights @ correlation @ weights)) * max(1.0, float(z.std()))
            self._directions[senses] = weights / scale
        self._weights = self._directions[self.settings.senses]
        self._inverse = np.linalg.inv(correlation) / np.outer(scale, scale)
        self._levels = (float(np.median(found[:, 1])), max(0.02, float(found[:, 1].std())))
        slow_hz = _rates_hz(found, self._memory)
        self._creep_hz = max(
            self.settings.creep * free_hz, 6.0 * float(slow_hz.std()) if len(slow_hz) else 0.0
        )
        self._spread_hz = max(0.01 * free_hz, float(rates_hz.std()))
        self._values = max(values, LEAST_VALUES)
        self._limit = _students(self.settings.threshold, self._values)
        return ""

    # contact

    def deviations(self, times_s: Floats, x: Floats) -> tuple[Floats, Mapping[str, Floats]]:
        """The statistics of a recording whose first `baseline_s` are without contact.

        Args:
            times_s: At a fixed rate, shape (n,).
            x: The waveform, finite, shape (n,).

        Returns:
            Times, and the deviations for each value of `senses`; empty where the baseline is refused.
        """
        twin = ResonanceDetector(self.name, self.settings)
        rate_hz = (len(x) - 1) / float(times_s[-1] - times_s[0])
        wanted = round(self.settings.baseline_s * rate_hz)
        twin._learn(times_s[:wanted], x[:wanted], rate_hz)
        if twin._refused or twin._envelope is None:
            return np.empty(0), dict.fromkeys(DIRECTIONS, np.empty(0))
        follows = np.column_stack(twin._envelope.push(times_s[wanted:], x[wanted:] - twin._mean))
        joined = np.concatenate([twin._past, follows])
        features = _residuals(*_features(joined, twin._periods), twin._teach) - twin._middle
        found = {senses: (features * weights).sum(axis=1) for senses, weights in twin._directions.items()}
        return joined[twin._memory + HORIZONS[-1] :, 0], found | {"amplitude": np.abs(found["amplitude"])}

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """What `threshold` is compared with, for a recording whose first `baseline_s` are without contact, shape (n,);
        the first column is used. NaN where nothing is decided: in the baseline, all where it is refused."""
        twin = ResonanceDetector(self.name, self.settings)
        twin.push(SampleBlock(self.settings.input, 0, 0.0, values[:, :1], rate_hz=rate_hz))
        statistic = np.full(len(values), math.nan)
        if len(twin.readings):
            places = np.minimum(len(values) - 1, np.round(twin.readings[:, 0] * rate_hz).astype(int))
            # as rare as in a long baseline: `_students` the other way round
            deviations = np.maximum(0.0, twin.readings[:, 1])
            statistic[places] = np.sqrt(twin._values * np.log1p(deviations**2 / twin._values))
        return statistic

    def _deviations(self, off: Floats, surprise: Floats) -> Floats:
        """Of residuals (n, 4) and their Mahalanobis distances (n,): deviations toward a contact, shape (n,)."""
        if self.settings.stiffness == "either":
            return _normal(surprise**2, off.shape[1])
        s: Floats = (off * self._weights).sum(axis=1)
        if self.settings.senses == "amplitude":
            return np.abs(s)
        return -s if self.settings.stiffness == "falls" else s

    def _louder(self, surprise: float, free: bool) -> float:
        """How many times as loud the noise of the last moments is as the baseline's, 1 where that is not louder; not
        learned in contact."""
        assert self._envelope is not None
        scale = math.sqrt(self._noise) if self._noise > LOUDER**2 else 1.0
        # a single knock is no noise
        self._recent.append(min(surprise**2 / len(self._middle), QUIET**2))
        oldest = self._recent.pop(0)
        if free:
            keep = math.exp(-self._envelope.hop_s / NOISE_S)
            self._noise += (1.0 - keep) * (oldest - self._noise)
        return scale

    def _follow(self, times_s: Floats, levels: Floats, phases: Floats) -> list[Detected]:
        """Events from new values of the envelope."""
        fresh = len(times_s)
        if not fresh:
            return []
        self._past = np.concatenate([self._past, np.column_stack([times_s, levels, phases])])
        events: list[Detected] = []
        plain, seen = _features(self._past, self._periods)
        if len(plain):
            new = min(fresh, len(plain))
            features = _residuals(plain[-new:], seen[-new:], self._teach)
            events = self._decide_on(self._past[-new:], features, _rates_hz(self._past, HOPS)[-new:])
        self._past = self._past[-(self._memory + HORIZONS[-1]) :]
        return events

    def _decide_on(self, past: Floats, features: Floats, rates_hz: Floats) -> list[Detected]:
        assert self._envelope is not None
        off = features - self._middle
        surprise = np.sqrt((off * (off[:, :, None] * self._inverse).sum(axis=1)).sum(axis=1))
        s = self._deviations(off, surprise)
        rate_hz = self._envelope.free_hz + rates_hz
        keep = math.exp(-self._envelope.hop_s / self.settings.follow_s)
        slow_keep = math.exp(-1.0 / self._memory)
        rises, falls = (self.settings.stiffness != way for way in ("falls", "rises"))
        events: list[Detected] = []
        hops = zip(*(each.tolist() for each in (past[:, 0], past[:, 1], s, surprise, rate_hz)), strict=True)
        for i, (t_s, level, deviation, surprised, hop_hz) in enumerate(hops):
            self._slow_hz += (1.0 - slow_keep) * (hop_hz - self._slow_hz)
            free = math.isnan(self._contact_s)
            louder = self._louder(surprised, free)
            s[i] = value = deviation / louder
            gone_hz = self._slow_hz - self._reference_hz
            if free:
                crept = (rises and gone_hz > self._creep_hz) or (falls and -gone_hz > self._creep_hz)
                if value > self._limit or crept:
                    self._contact_s, self._held_reported, self._quiet_hops = t_s, False, 0
                    found, limit = value, self._limit
                    if value <= limit:
                        side = math.copysign(self._creep_hz, gone_hz)
                        found, limit = self._slow_hz, self._reference_hz + side
                    events.append(Contact(t_s, self.name, found, limit))
                else:
                    self._reference_hz += (1.0 - keep) * (hop_hz - self._reference_hz)
                continue
            if (
                not self._held_reported
                and t_s - self._contact_s >= self.settings.hold_s - 0.5 * self._envelope.hop_s
            ):
                self._held_reported = True
                events.append(ContactHeld(t_s, self.name, value, self._limit))
            # the frequency is not over the noise: a steady contact raises it by a few deviations
            quiet = (
                surprised / louder < SURPRISE
                and abs(hop_hz - self._reference_hz) < QUIET * self._spread_hz
                and abs(level - self._levels[0]) < QUIET * self._levels[1]
            )
            self._quiet_hops = self._quiet_hops + 1 if quiet else max(0, self._quiet_hops - DOUBT)
            if self._quiet_hops * self._envelope.hop_s >= self.settings.release_s:
                self._contact_s = math.nan
                self._slow_hz = self._reference_hz
                events.append(ContactLost(t_s, self.name, value, self._limit))
        self.readings = np.concatenate([self.readings, decisions(past[:, 0], s, self._limit)])
        return events


def _features(past: Floats, periods: int) -> tuple[Floats, Floats]:
    """Deviations from a steady oscillation, and the features that predict them.

    Args:
        past: Time, logarithm of the amplitude and phase, shape (n + periods * HOPS + HORIZONS[-1], 3).
        periods: That the prediction looks back.

    Returns:
        Logarithm of the amplitude and phase for each horizon, shape (n, 4); and for each horizon how the last periods'
        frequencies and amplitudes differ from their means, so that slow drift changes nothing, shape (n, horizons,
        periods + amplitudes).
    """
    first = periods * HOPS + HORIZONS[-1]
    n, levelled = max(0, len(past) - first), min(LEVELS, periods)
    found, seen = np.empty((n, 2 * len(HORIZONS))), np.empty((n, len(HORIZONS), periods + levelled))
    for place, horizon in enumerate(HORIZONS if n else ()):
        ends = [slice(first - horizon - k * HOPS, first - horizon - k * HOPS + n) for k in range(periods + 1)]
        phases = np.array([past[end, 2] for end in ends])
        levels = np.array([past[end, 1] for end in ends[:levelled]])
        turned = phases[:-1] - phases[1:]
        steady = turned.mean(axis=0)
        found[:, 2 * place] = past[first:, 1] - levels[0]
        found[:, 2 * place + 1] = past[first:, 2] - phases[0] - steady * (horizon / HOPS)
        seen[:, place, :periods] = (turned - steady).T
        seen[:, place, periods:] = (levels - levels.mean(axis=0)).T
    return found, seen


def _regression(plain: Floats, seen: Floats, prior: float) -> Floats:
    """Weights of the prediction, shrunk toward zero by a share `prior`, shape (horizons, features, 2)."""
    weights = np.empty((*seen.shape[1:], 2))
    for place in range(seen.shape[1]):
        x = seen[:, place]
        y = plain[:, 2 * place : 2 * place + 2]
        power = x.T @ x
        weights[place] = np.linalg.solve(
            power + prior * np.diag(np.diag(power)) + 1e-12 * np.eye(len(power)), x.T @ (y - y.mean(axis=0))
        )
    return weights


def _residuals(plain: Floats, seen: Floats, weights: Floats) -> Floats:
    """Deviations less their prediction, shape (n, 4); independent of the block size."""
    predicted: Floats = (seen[:, :, :, None] * weights).sum(axis=2).reshape(len(plain), -1)
    return plain - predicted


def _rates_hz(past: Floats, hops: int) -> Floats:
    """Frequency above the free one, from the phase gained in so many hops, Hz."""
    gained: Floats = (past[hops:, 2] - past[:-hops, 2]) / (2.0 * math.pi)
    return gained / (past[hops:, 0] - past[:-hops, 0])


def _frequency(x: Floats, rate_hz: float, from_hz: float, to_hz: float) -> float:
    """Centroid of the largest peak of the spectrum between two frequencies, Hz; 0 where there is none."""
    power = np.abs(np.fft.rfft(x * np.hanning(len(x)), 4 * len(x))) ** 2
    first, last = (round(hz * 4 * len(x) / rate_hz) for hz in (from_hz, to_hz))
    if not power[first : last + 1].any():
        return 0.0
    peak = first + int(np.argmax(power[first : last + 1]))
    near = slice(max(0, peak - 8), peak + 9)
    weight = power[near]
    return float((np.arange(len(power))[near] * weight).sum() / weight.sum() * rate_hz / (4 * len(x)))


def _hum(x: Floats, rate_hz: float, free_hz: float) -> str:
    """What is said of a baseline with a line of the mains in it; "" where there is none that disturbs."""
    n = np.arange(len(x))
    resolved_hz = max(LINE_HZ, 2.0 * rate_hz / len(x))
    window = np.hanning(len(x))

    def line(hz: float) -> float:
        return float(np.abs((x * window * np.exp(-2j * math.pi * hz / rate_hz * n)).sum()) / window.sum())

    for hz in MAINS_HZ:
        # a line stands above both sides, where broad noise does not
        beside = max(line(hz - 1.5 * resolved_hz), line(hz + 1.5 * resolved_hz))
        share = line(hz) / max(line(free_hz), 1e-300)
        if abs(hz - free_hz) > 2.0 * resolved_hz and share > HUM and line(hz) > 3.0 * beside:
            return (
                f"mains hum at {hz:g} Hz, {share:.0%} of the oscillation: it beats with the finger; ground or shield"
                " the sensor"
            )
    return ""


def _normal(chi2: Floats, freedom: int) -> Floats:
    """Normal deviates as rare as values of chi square, shape (n,) (E. B. Wilson and M. M. Hilferty, PNAS 17, 1931)."""
    part = 2.0 / (9.0 * freedom)
    found: Floats = (np.cbrt(chi2 / freedom) - (1.0 - part)) / math.sqrt(part)
    return found


def _robust(values: Floats) -> tuple[Floats, Floats]:
    """Medians, and standard deviations from the median's absolute ones, of columns, shape (columns,) each."""
    middle = np.median(values, axis=0)
    return middle, 1.4826 * np.median(np.abs(values - middle), axis=0)


def _students(threshold: float, values: float) -> float:
    """The threshold of Student's t as rare as a normal one (D. L. Wallace, 1959), for `values` values."""
    return math.sqrt(values * math.expm1(min(threshold**2 / values, 60.0)))


class Envelope:
    """Mixes with one frequency and averages over its period: a constant and the harmonics vanish.

    The same to the bit however the samples are cut.

    Args:
        free_hz: The frequency.
        hops: Values wanted in a period; rounded so that a hop is whole samples.
        smooth: Samples of a second average, against what is far above the oscillation.

    Attributes:
        free_hz: The frequency.
        hop_s: From one value to the next.
    """

    def __init__(self, free_hz: float, rate_hz: float, hops: int, smooth: int = 1) -> None:
        self.free_hz = free_hz
        self._hop = max(1, round(rate_hz / free_hz / hops))
        self.hop_s = self._hop / rate_hz
        self._turn = free_hz / rate_hz
        period = rate_hz / free_hz
        whole = math.floor(period)
        self._window = np.full(whole + 1, 1.0 / period)
        self._window[0] = (period - whole) / period  # of the oldest sample, the part that is within a period
        self._window = np.convolve(self._window, np.full(smooth, 1.0 / smooth))
        self.restart()

    def restart(self) -> None:
        """Restart: the next value comes a period later."""
        self._mixed = np.empty(0, dtype=np.complex128)
        self._times = np.empty(0)
        self._count = 0
        self._last = complex(math.nan, math.nan)
        self._phase = 0.0

    def push(self, times_s: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Process the next samples.

        Args:
            times_s: Shape (n,).
            x: Shape (n,), finite.

        Returns:
            Times, logarithms of the amplitude and phases (rad, continuous) of the new values, shape (m,) each.
        """
        count = self._count + np.arange(len(x))
        self._count += len(x)
        mixed = x * np.exp(-2j * math.pi * np.mod(self._turn * count, 1.0))
        mixed, times_s = np.concatenate([self._mixed, mixed]), np.concatenate([self._times, times_s])
        size, first = len(self._window), self._count - len(mixed)
        ends = np.arange(size - 1, len(mixed))
        ends = ends[(first + ends) % self._hop == 0]
        ends = ends[ends >= len(mixed) - len(x)]
        self._mixed, self._times = mixed[-(size - 1) :], times_s[-(size - 1) :]
        if not len(ends):
            return np.empty(0), np.empty(0), np.empty(0)
        windows = mixed[ends[:, None] + np.arange(1 - size, 1)]
        values = (windows * self._window).sum(axis=1)
        before = np.concatenate([[self._last], values[:-1]])
        turned = np.angle(values * np.conj(before))
        if math.isnan(self._last.real):
            turned[0] = 0.0
        # one addition after the other: however the samples are cut
        phases = np.cumsum(np.concatenate([[self._phase], turned]))[1:]
        self._last, self._phase = complex(values[-1]), float(phases[-1])
        return times_s[ends], np.log(np.abs(values) + 1e-12), phases
