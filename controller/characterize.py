"""What a sensor can do, from its recordings: one page and one JSON, in the same words and units for every sensor."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup

from behaviors.events import Onset
from controller.detectors.calibration import Statistic, calibrate_pieces, courses_of
from controller.detectors.onset import OnsetDetector, OnsetSettings
from controller.recording.run_folder import plain
from controller.recording.series import joined
from controller.replay import ALIKE, at_rail, between
from controller.reports.counts import median_within, wilson
from controller.reports.figures import FALSE, GOOD, OURS, RIVAL, Figures
from controller.reports.section import environment
from drivers.core.messages import Floats, SampleBlock

Span = tuple[float, float]

AN_HOUR = (1.0, 10.0, 100.0)
"""False alarms an hour at which delays are told."""

AFTER_S, DELAY_S = 1.0, 1.0
"""How long after an event it is looked for, and how late a detection still counts for it."""

EARLY_S = 0.05
"""What is above the threshold so long before an event is not of it."""

REFERENCE_SIGMA, REST_S, APART_S = 8.0, 0.5, 0.5
"""An event of the reference is beyond so many deviations of its first half second; the next one is as far away."""

OUTLIER = 5.0
"""Robust standard deviations beyond which a sample is an outlier; of a normal one 6 in ten million."""

MARGIN_S, MOST_PASTED = 0.1, 40
"""Quiet ends so long before the first knock that is heard; and so many are offered."""

MAINS_HZ = (50.0, 60.0)
MAINS_OFF_HZ = 0.3
"""How far mains, by a recorder's own clock, may seem to be off, Hz. Assumption: a grid's 0.2 and a clock of 0.1 %."""

MAINS_S, MAINS_STEP_HZ = 10.0, 0.02
"""Mains is looked for in stretches so long, at frequencies so far apart: it drifts, and a line in 10 s is 0.2 Hz wide
(Hann, to half its height)."""

SLOW_HZ, VIBRATES = 2.0, 0.5
"""Quiet vibrates where so large a share of what is faster than 2 Hz is within a tenth of one frequency (assumption)."""

DENSITY_HZ = (1.0, 10.0, 100.0, 1000.0, 10_000.0)


class SensorRecording(NamedTuple):
    """A recording: its name, the sensor's blocks, and those of a second channel that shows the touches (or none)."""

    name: str
    blocks: Sequence[SampleBlock]
    reference: Sequence[SampleBlock] = ()


class Truth(NamedTuple):
    """What is known of each recording, s: what is quiet, when something touched, from when to when it slid."""

    quiet: Sequence[Span]
    touches: Sequence[float] = ()
    slips: Sequence[Span] = ()


Row = dict[str, Any]
"""`quantity`, `value`, `unit`, `low` and `high` (95 % interval, None where there is none), `n`, `how`."""


def row(quantity: str, value: float, unit: str, how: str, **more: Any) -> Row:
    """A row of a certificate; what is no finite number is None."""
    known = {"quantity": quantity, "value": value, "unit": unit, "low": None, "high": None, "n": None}
    found: Row = plain(known | {"how": how} | more)
    return found


class _Sensor:
    """What is known of a sensor before anything is computed.

    Attributes:
        unit: Of its reading.
        quiet: The blocks of each stretch of quiet.
        rest: The values of each.
        longest: The values of the longest, those that are finite.
        touches: When something touched, s, of each recording.
    """

    def __init__(
        self, recordings: Sequence[SensorRecording], truth: Truth, rate_hz: float, per_newton: float | None
    ) -> None:
        self.recordings, self.truth, self.rate_hz, self.per_newton = recordings, truth, rate_hz, per_newton
        self.unit = recordings[0].blocks[0].unit or "unit"
        spans = [(max(begin_s, -1e18), end_s) for begin_s, end_s in truth.quiet or [(-math.inf, math.inf)]]
        self.quiet = [
            found for each in recordings for span in spans if (found := between(each.blocks, *span))
        ]
        if not self.quiet:
            first, last = recordings[0].blocks[0], recordings[0].blocks[-1]
            raise ValueError(
                "no quiet in it: name seconds in which nothing happens with --quiet T0:T1; its times go from"
                f" {first.times[0]:.6g} to {last.times[-1]:.6g} s"
            )
        self.rest = [joined(part).values[:, 0] for part in self.quiet]
        self.finite = [part[np.isfinite(part)] for part in self.rest]
        self.longest = max(self.finite, key=len)
        self.touches = [onsets(each.reference) if each.reference else truth.touches for each in recordings]

    @property
    def quiet_s(self) -> float:
        """How long it is quiet altogether."""
        return sum(map(len, self.rest)) / self.rate_hz

    @property
    def slid(self) -> list[tuple[SensorRecording, float]]:
        """The beginning of each slip, with its recording."""
        return [(each, begin_s) for each in self.recordings for begin_s, _ in self.truth.slips]

    @property
    def touched(self) -> list[tuple[SensorRecording, float]]:
        """Each touch, with its recording."""
        pairs = zip(self.recordings, self.touches, strict=True)
        return [(each, t_s) for each, at_s in pairs for t_s in at_s]


def certificate(
    recordings: Sequence[SensorRecording],
    truth: Truth,
    detectors: Mapping[str, Callable[[], Statistic]],
    *,
    name: str,
    per_newton: float | None = None,
) -> dict[str, Any]:
    """A sensor's certificate.

    Args:
        recordings: Of one sensor, all at one rate and in one unit; the first column counts.
        truth: Of every recording. Touches are taken from a reference where there is one.
        detectors: A fresh one of each kind.
        name: The sensor's.
        per_newton: Its reading for a newton, in its unit.

    Raises:
        ValueError: no quiet, samples at irregular times, or recordings of two rates or units.
    """
    first = recordings[0].blocks[0]
    for each in recordings:
        other, named = each.blocks[0], f"{each.name}: " * (each is not recordings[0])
        if first.rate_hz is None or other.rate_hz is None:
            raise ValueError(f"{named}samples at irregular times; give --rate HZ if the samples are regular")
        if abs(other.rate_hz / first.rate_hz - 1.0) > ALIKE or other.unit != first.unit:
            one, two = (f"{block.rate_hz:.6g} Hz, {block.unit or 'no unit'}" for block in (first, other))
            raise ValueError(
                f"{one}; but {named}{two}; a certificate is of one rate and one unit: make one of each"
            )
    assert first.rate_hz is not None
    rate_hz = first.rate_hz
    sensor = _Sensor(recordings, truth, rate_hz, per_newton)
    said = {each.name: at_rail(each.blocks).removeprefix("; ") for each in recordings}
    whose = _whose(sensor)
    gaps = [*([whose] if whose else []), *(f"{name}: {rail}" for name, rail in said.items() if rail)]
    rows = [*_at_rest(sensor), *_against_reference(sensor), *_spectrum_of_touches(sensor)]
    for kind, make in detectors.items():
        try:
            rows += _detector(kind, make, sensor)
        except ValueError as error:
            gaps.append(f"{kind}: {error}")
    return {
        "sensor": name,
        "recordings": [each.name for each in recordings],
        "rate_hz": rate_hz,
        "unit": sensor.unit,
        "quiet_s": sensor.quiet_s,
        "touches": len(sensor.touched),
        "slips": len(truth.slips) * len(recordings),
        "rows": rows,
        "cannot_say": gaps + list(_unsaid(rows, sensor)),
    }


# --- at rest -------------------------------------------------------------------------------------


def _at_rest(sensor: _Sensor) -> Iterator[Row]:
    rate_hz, unit, finite, longest = sensor.rate_hz, sensor.unit, sensor.finite, sensor.longest
    away = np.concatenate([part - np.median(part) for part in finite])
    n, sigma = len(away), float(away.std())
    free = n / _alike(longest, round(rate_hz))
    spread = 1.0 / math.sqrt(2.0 * free)
    interval = {"low": sigma * max(0.0, 1.0 - 1.96 * spread), "high": sigma * (1.0 + 1.96 * spread), "n": n}
    how = f"of a sample in quiet; as wide an interval as of {free:.3g} independent samples"
    yield row("noise, standard deviation", sigma, unit, how, **interval)
    hz, power, segments = _spectrum(longest, rate_hz)
    for at_hz in DENSITY_HZ:
        near = (hz > 0.7 * at_hz) & (hz < 1.4 * at_hz)
        if at_hz < 0.5 * rate_hz and near.any():
            density, low, high = (math.sqrt(each) for each in _typical(power[near], segments))
            what, how = f"noise density at {at_hz:g} Hz", "from the median, half an octave to each side"
            n = int(near.sum()) * segments
            yield row(what, density, f"{unit}/√Hz", how, low=low, high=high, n=n)
    steps = np.concatenate([np.abs(np.diff(part)) for part in finite])
    moved = steps[steps > 0.0]
    if len(moved):
        least = float(np.quantile(moved, 0.001))
        whole = np.abs(moved / least - np.round(moved / least))
        seen = bool(np.mean(whole[moved < 50 * least] < 0.02) > 0.9) if len(moved) > 20 else False
        how = "least step" if seen else "below what can be seen in the noise"
        yield row("quantisation", least if seen else math.nan, unit, how, n=len(moved))
    second = round(rate_hz)
    means = [part[: len(part) // second * second].reshape(-1, second).mean(axis=1) for part in finite]
    long = [each for each in means if len(each) > 2]
    slopes = [float(np.polyfit(np.arange(len(each)), each, 1)[0]) * 60.0 for each in long]
    how = "line through means of 1 s" if long else "it takes 3 s of quiet in a row"
    yield row("drift", float(np.median(slopes or [math.nan])), f"{unit}/min", how, n=len(slopes))
    robust = 1.4826 * float(np.median(np.abs(away)))
    if robust > 0.0:
        count = int(np.sum(np.abs(away) > OUTLIER * robust))
        low, high = wilson(count, n)
        how = f"beyond {OUTLIER:g} robust standard deviations"
        low = low if count else 0.0
        yield row("outliers, share of samples", count / n, "", how, low=low, high=high, n=n)
    yield from _mains(longest, hz, power, segments, rate_hz, unit)


def _mains(
    longest: Floats, hz: Floats, power: Floats, segments: int, rate_hz: float, unit: str
) -> Iterator[Row]:
    """Lines at 50 and 60 Hz, beside the spectrum of quiet."""
    size = min(len(longest), round(MAINS_S * rate_hz))
    for mains_hz in MAINS_HZ:
        if 2.5 * mains_hz < rate_hz and len(longest) > rate_hz:
            line, beside_hz = _line(
                longest[: len(longest) // size * size].reshape(-1, size), mains_hz, rate_hz
            )
            near = (np.abs(hz - mains_hz) > 3.0) & (np.abs(hz - mains_hz) < 12.0)
            beside = _typical(power[near], segments)[0] if near.any() else 0.0
            floor = math.sqrt(beside * 3.0 * rate_hz / size)
            quantity = f"mains at {mains_hz:g} Hz, amplitude"
            if line <= 3.0 * floor:
                yield row(quantity, math.nan, unit, f"none above {3.0 * floor:.3g}")
            elif abs(beside_hz) > MAINS_OFF_HZ + 1e-9:
                yield row(quantity, math.nan, unit, f"hidden by a line at {mains_hz + beside_hz:.4g} Hz")
            else:
                yield row(quantity, line, unit, "line above the noise beside it")


def _spectrum(x: Floats, rate_hz: float) -> tuple[Floats, Floats, int]:
    """Frequencies, the power density of quiet at each, and of how many overlapping stretches of two seconds."""
    from scipy.signal import welch

    size = min(len(x), max(64, round(2.0 * rate_hz)))
    hz, power = welch(x, rate_hz, nperseg=size)
    return hz, power, max(1, 2 * len(x) // size - 1)


SEGMENTS_SHARE, BINS_SHARE = (1 / 36,), (4 / 9, 1 / 36)
"""Correlation of the power of noise in stretches under a Hann window that overlap by half, and in bins one and two
apart. Source: Welch (1967): the square of the windows' overlap, 1/6; of their spectra's, 2/3 and 1/6."""


def _typical(power: Floats, segments: int) -> tuple[float, float, float]:
    """Power density of noise from the median of bins beside each other, and its 95 % interval.

    A bin's mean over `k` stretches is the density times Gamma(k)/k, and the rank of the median of `m` bins is
    Beta((m + 1)/2, (m + 1)/2): `k` and `m` count as many independent ones as there seem to be. Medians share less than
    means do: 2/π asin r in place of r, as of two normal values to be on one side.
    """
    from scipy.special import betaincinv, gammaincinv

    k = _independent(segments, SEGMENTS_SHARE)
    m = _independent(len(power), [2.0 / math.pi * math.asin(share) for share in BINS_SHARE])
    low, middle, high = gammaincinv(k, betaincinv(0.5 * (m + 1.0), 0.5 * (m + 1.0), [0.025, 0.5, 0.975])) / k
    median = float(np.median(power))
    return median / middle, median / high, median / low


def _independent(n: int, shares: Sequence[float]) -> float:
    """How many independent values have a mean as sure as that of `n`, correlated by so much with those 1, 2 … away."""
    return n / (1.0 + 2.0 * sum(max(0.0, 1.0 - lag / n) * share for lag, share in enumerate(shares, 1)))


def _alike(x: Floats, most: int) -> float:
    """How many samples in a row count as one for the interval of a variance: the sum of the squared autocorrelation.

    Source: Bartlett (1946), of a normal process; lags up to a second, or a tenth of the samples.
    """
    from scipy.signal import correlate

    centred = x - x.mean()
    found = correlate(centred, centred, "full", "fft")[len(x) - 1 :][: 1 + min(most, len(x) // 10)]
    return 1.0 + 2.0 * float(((found[1:] / found[0]) ** 2).sum()) if found[0] > 0.0 else 1.0


def _line(x: Floats, mains_hz: float, rate_hz: float) -> tuple[float, float]:
    """Amplitude of a line within `MAINS_OFF_HZ` of a frequency, the median over stretches, shape (stretches, n); and
    how far from that frequency the largest line within 6 Hz is, Hz."""
    from scipy.signal import zoom_fft

    window = np.hanning(x.shape[1])
    off_hz = MAINS_STEP_HZ * np.arange(-300, 301)
    ends_hz = [mains_hz + off_hz[0], mains_hz + off_hz[-1]]
    centred = (x - x.mean(axis=1, keepdims=True)) * window
    found = zoom_fft(centred, ends_hz, len(off_hz), fs=rate_hz, endpoint=True)
    size = 2.0 * np.abs(found) / float(window.sum())
    line = float(np.median(size[:, np.abs(off_hz) <= MAINS_OFF_HZ + 1e-9].max(axis=1)))
    return line, float(off_hz[int(np.argmax((size**2).mean(axis=0)))])


def _whose(sensor: _Sensor) -> str:
    """What is said of quiet in which something vibrates; "" where most of its power is not about one frequency."""
    hz, power, _ = _spectrum(sensor.longest, sensor.rate_hz)
    power = np.where(hz > SLOW_HZ, power, 0.0)
    at_hz = float(hz[int(np.argmax(power))])
    about = np.abs(hz - at_hz) <= max(0.1 * at_hz, 2.0 * float(hz[:2].sum()))
    share = float(power[about].sum() / power.sum()) if power.any() else 0.0
    if share < VIBRATES:
        return ""
    return (
        f"whose noise it is: {share:.0%} of the power in quiet is about {at_hz:.3g} Hz, as where something vibrates"
        " or hums; noise, densities and thresholds are upper bounds for the sensor: record it at rest too"
    )


# --- touches -------------------------------------------------------------------------------------


def onsets(blocks: Sequence[SampleBlock]) -> Sequence[float]:
    """When a channel leaves its rest, s: each first sample beyond `REFERENCE_SIGMA`, `APART_S` after the last one."""
    series = joined(blocks)
    x, t_s = series.values[:, 0], series.times_s
    rest = x[t_s < t_s[0] + REST_S]
    middle = float(np.median(rest))
    sigma = max(1.4826 * float(np.median(np.abs(rest - middle))), float(rest.std()), 1e-12)
    beyond = t_s[np.abs(x - middle) > REFERENCE_SIGMA * sigma]
    return [float(t) for t in beyond[np.diff(beyond, prepend=-math.inf) > APART_S]]


def knocks(blocks: Sequence[SampleBlock]) -> Sequence[float]:
    """When something knocked or touched by the channel's own `onset`, s; none that begins within `MARGIN_S`."""
    detector = OnsetDetector("onset", OnsetSettings())
    events = [event for block in _as_input(blocks, detector) for event in detector.push(block)]
    found = [event.began_s for event in events if isinstance(event, Onset)]
    return [t_s for t_s in found if t_s > blocks[0].times[0] + MARGIN_S]


def _against_reference(sensor: _Sensor) -> Iterator[Row]:
    late = []
    for each, t_s in sensor.touched:
        near = between(each.blocks, t_s - REST_S - 0.05, t_s + 0.2) if each.reference else ()
        late += [found - t_s for found in (onsets(near) if near else ()) if found > t_s - 0.05][:1]
    if len(late) < 3:
        how = f"touches that a second channel shows: {len(late)}; three are needed"
        yield row("latency", math.nan, "ms", how, n=len(late))
        yield row("jitter", math.nan, "ms", how, n=len(late))
        return
    jitter, middle = float(np.std(late, ddof=1)), float(np.median(late))
    enough = len(late) >= 6
    low, high = median_within(np.sort(late)) if enough else (math.nan, math.nan)
    how = "median; sensor's first reaction less the reference's" + "; an interval takes six" * (not enough)
    yield row("latency", 1e3 * middle, "ms", how, low=1e3 * low, high=1e3 * high, n=len(late))
    how = f"standard deviation of the latency; a sample is {1e3 / sensor.rate_hz:.3g} ms"
    yield row("jitter", 1e3 * jitter, "ms", how, n=len(late))


def _spectrum_of_touches(sensor: _Sensor) -> Iterator[Row]:
    """The bandwidth: of pure noise, fewer than one certificate in fifty tells any.

    Then the mean power of touches and of quiet in a bin are as two variances: their ratio is F distributed, two
    degrees of freedom for each stretch; all bins together pass it no more often than the sum of them (Bonferroni).
    """
    from scipy.special import fdtri

    size, what = round(0.1 * sensor.rate_hz), "bandwidth of touches"
    rest = max(sensor.rest, key=len)
    if size < 16 or len(rest) < 4 * size:
        yield row(what, math.nan, "Hz", "it takes 160 samples a second and 0.4 s of quiet", n=0)
        return
    window = np.hanning(size)

    def power(x: Floats) -> Floats:
        return np.abs(np.fft.rfft((x - x.mean()) * window)) ** 2

    quiet = [power(rest[k : k + size]) for k in range(0, len(rest) - size, size)]
    seen = []
    for each, t_s in sensor.touched:
        part = joined(between(each.blocks, t_s, t_s + 0.1)).values[:, 0]
        if len(part) == size:
            seen.append(power(part))
    if len(seen) < 3:
        yield row(what, math.nan, "Hz", f"touches that are whole: {len(seen)}; three are needed", n=len(seen))
        return
    own = slice(1, (size + 1) // 2)  # the mean and half the sample rate have half the freedom of the others
    hz = np.fft.rfftfreq(size, 1.0 / sensor.rate_hz)[own]
    beyond = max(4.0, float(fdtri(2 * len(seen), 2 * len(quiet), 1.0 - 0.02 / len(hz))))
    above = hz[np.mean(seen, axis=0)[own] > beyond * np.mean(quiet, axis=0)[own]]
    highest = float(above.max()) if len(above) else math.nan
    how = f"highest frequency at which touches have {beyond:.3g} times the power of quiet"
    yield row(what, highest, "Hz", how if len(above) else f"none: {how}", n=len(seen))


# --- detectors -----------------------------------------------------------------------------------


def _as_input(blocks: Sequence[SampleBlock], detector: Statistic) -> Sequence[SampleBlock]:
    return [replace(block, stream=detector.inputs[0]) for block in blocks]


def _detector(kind: str, make: Callable[[], Statistic], sensor: _Sensor) -> Iterator[Row]:
    pieces = []
    for part in sensor.quiet:
        detector = make()
        pieces.append((detector, _as_input(part, detector)))
    slides = kind.startswith("slip")
    word, events = ("slip", sensor.slid) if slides else ("contact", sensor.touched)
    courses = [_before(make, each, t_s, sensor.truth.quiet) for each, t_s in events]
    for an_hour in AN_HOUR:
        found = calibrate_pieces(pieces, 3600.0 / an_hour)
        at = f"{kind} at {an_hour:g} false alarms an hour"
        sure = "extrapolated" if found.extrapolated else "counted"
        how = f"{sure} from {found.recording_s:.3g} s of quiet; paste: threshold = {found.threshold:.4g}"
        if math.isfinite(found.checked_expected):
            told, expected = found.checked_found, found.checked_expected
            how += f"; in pieces that were left out {told:.0f} alarms, {expected:.0f} expected"
        yield row(f"{at}: threshold", found.threshold, "", how, low=found.low, high=found.high, n=len(pieces))
        if kind == "force.threshold":
            newton = abs(sensor.per_newton) if sensor.per_newton else math.nan
            least = [value / newton for value in (found.threshold, found.low, found.high)]
            said = "the threshold, as a force that lasts for its average"
            how = said if sensor.per_newton else "give --per-newton"
            yield row(f"{at}: smallest touch", least[0], "N", how, low=least[1], high=least[2])
        if events:
            yield from _delays(f"{at}: {word}", courses, found.threshold)


def _before(
    make: Callable[[], Statistic], each: SensorRecording, t_s: float, quiet: Sequence[Span]
) -> tuple[Floats, Floats]:
    """Times since an event, from `EARLY_S` before it on, and the statistic; it learns in the quiet before the event."""
    detector = make()
    begins_s = max((span[0] for span in quiet if span[1] <= t_s + 0.1), default=-1e18)
    blocks = _as_input(between(each.blocks, begins_s, t_s + AFTER_S), detector)
    courses = courses_of(detector, blocks) if blocks else []
    times_s = np.concatenate([np.empty(0), *(course.times_s for course in courses)])
    statistic = np.concatenate([np.empty(0), *(course.statistic for course in courses)])
    late = times_s >= t_s - EARLY_S
    return times_s[late] - t_s, statistic[late]


class Delays(NamedTuple):
    """How events were told at a threshold.

    Attributes:
        events: How many there were.
        told: How many within `DELAY_S`; what was above before is missed.
        early: How many of those missed were above before.
        median_s, p90_s: Of all, missed ones last, each with its 95 % interval by ranks; infinite where so many were
            missed, or so few there were.
    """

    events: int
    told: int
    early: int
    median_s: tuple[float, float, float]
    p90_s: tuple[float, float, float]


def delays_at(courses: Sequence[tuple[Floats, Floats]], threshold: float) -> Delays:
    """Delays of a detector at a threshold.

    Args:
        courses: Of each event: times since it, s, from a little before it on, and the statistic then.
    """
    delays, early = [], 0
    for since_s, statistic in courses:
        above = since_s[np.nan_to_num(statistic, nan=-math.inf) > threshold]
        known = len(above) and above[0] >= 0.0
        early += bool(len(above)) and not known
        delays.append(float(above[0]) if known else math.inf)
    ordered, n = np.sort(np.where(np.array(delays) > DELAY_S, math.inf, delays)), len(delays)

    def ranked(share: float) -> tuple[float, float, float]:
        rank = 1.96 * math.sqrt(n * share * (1.0 - share))
        places = [math.ceil(n * share + side * rank) - 1 for side in (0, -1, 1)]
        value, low, high = (float(ordered[max(0, place)]) if place < n else math.inf for place in places)
        return value, low, high

    return Delays(n, int(np.isfinite(ordered).sum()), early, ranked(0.5), ranked(0.9))


def _delays(what: str, courses: Sequence[tuple[Floats, Floats]], threshold: float) -> Iterator[Row]:
    found = delays_at(courses, threshold)
    n = found.events
    low, high = wilson(found.told, n)
    how = f"within {DELAY_S:g} s; {found.early} were above before, and count as missed"
    yield row(f"{what} told", found.told / n, "", how, low=low, high=high, n=n)
    for name, ends in (("median", found.median_s), ("90 %", found.p90_s)):
        value, low, high = (1e3 * end for end in ends)
        yield row(f"{what} delay, {name}", value, "ms", "of all, missed ones last", low=low, high=high, n=n)


# --- what it cannot say, and the page -------------------------------------------------------------


def _unsaid(rows: Sequence[Row], sensor: _Sensor) -> Iterator[str]:
    truth, touches, recordings, seconds = sensor.truth, sensor.touches, sensor.recordings, sensor.quiet_s
    if seconds < 5 * 3600.0 / AN_HOUR[-1]:
        yield (
            f"rare false alarms: {seconds:.3g} s of quiet are extrapolated at every rate; 100 an hour take 180 s,"
            " one an hour five hours, with the robot moving as in use"
        )
    heard = [] if truth.quiet and (any(touches) or truth.slips) else knocks(recordings[0].blocks)
    if not truth.quiet:
        yield "which part is quiet: all of it was taken for quiet, touches as well; name it with --quiet T0:T1"
    if heard:
        given = " ".join(f"--touch {t_s:.6g}" for t_s in heard[:MOST_PASTED])
        begin_s = recordings[0].blocks[0].times[0]
        yield (
            f"what onset hears in {recordings[0].name}: {len(heard)} knocks, releases too; paste what is a touch:"
            f" --quiet {begin_s:.4g}:{heard[0] - MARGIN_S:.4g} {given}"
        )
    told = [each["how"] for each in rows if each["quantity"].endswith(" told")]
    if any("; 0 were above before" not in how for how in told):
        yield (
            "what was above a threshold already before an event: it drifts, or the last event still lasts; name quiet"
            " shortly before the events too, so that it is learned there"
        )
    first_s = min((end_s for _, end_s in truth.quiet), default=-math.inf)
    at_s = [t_s for _, t_s in sensor.touched] + [begin_s for begin_s, _ in truth.slips]
    late = sum(t_s + 0.1 < first_s for t_s in at_s)
    if late:
        yield (
            f"delays of {late} of {len(at_s)} events: no quiet comes before them, and detectors learned from what is"
            " none; record quiet first"
        )
    if len(sensor.quiet) < 3:
        stretches = len(sensor.quiet)
        yield f"how recordings differ: stretches of quiet: {stretches}; record three, on other days and mountings"
    count = len(sensor.touched)
    if not count and any(each.reference for each in recordings):
        beyond = f"{REFERENCE_SIGMA:g} deviations of its first {REST_S:g} s"
        yield f"touches: the reference shows none, for it is never beyond {beyond}"
    elif not count and not heard:
        name = recordings[0].name
        yield f"touches: 0, and onset hears none in {name}; tap it with a second sensor, --reference COLUMN"
    elif count < 20:
        yield f"touches: {count}; twenty tell a miss rate to 15 %: tap with a second sensor, --reference COLUMN"
    if not any(each["quantity"] == "latency" and each["value"] is not None for each in rows):
        yield "latency and jitter: three taps seen by a second channel are needed, --reference COLUMN"
    if not truth.slips:
        yield "slip: none in it; drag it with an encoder and name when it slides, --slip T0:T1"
    if sensor.per_newton is None:
        yield "newtons: hang a weight on it and give --per-newton, its reading for 1 N"


DELAYS_MS = (0.01, 1000.0)
"""Ends of the figure's axis of delays."""


def curves(found: Mapping[str, Any]) -> str:
    """Delays against false alarms an hour, as SVG: median and its interval, the delay of 90 % dashed; "" without."""
    values = {each["quantity"]: each for each in found["rows"] if each["value"] is not None}
    kinds = dict.fromkeys(name.split(" at ")[0] for name in values if name.endswith("delay, median"))
    if not kinds:
        return ""
    least_ms, most_ms = DELAYS_MS
    with Figures(None).figure(2.8) as drawing:
        (axes,) = drawing.axes
        for kind, colour in zip(kinds, cycle((OURS, FALSE, GOOD, RIVAL)), strict=False):
            for name, dash, label in (("median", "-", kind), ("90 %", "--", None)):
                points = {
                    an_hour: values[key]
                    for an_hour in AN_HOUR
                    for key in values
                    if key.startswith(f"{kind} at {an_hour:g} false") and key.endswith(f"delay, {name}")
                }
                delays = [max(each["value"], least_ms) for each in points.values()]
                axes.plot(list(points), delays, dash, color=colour, label=label)
                if name == "median":
                    low = [each["low"] or least_ms for each in points.values()]
                    high = [most_ms if each["high"] is None else each["high"] for each in points.values()]
                    axes.vlines(list(points), low, high, colors=colour, alpha=0.5)
        axes.set(xscale="log", yscale="log", xlim=(1.2 * AN_HOUR[-1], AN_HOUR[0] / 1.2), ylim=DELAYS_MS)
        axes.set(xlabel="false alarms an hour", ylabel="delay (ms)")
        drawing.legend(axes, columns=3)
        return drawing.save("delays")


HEADS = ("quantity", "value", "95 % interval", "unit", "n", "how")


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def cells(each: Row) -> Sequence[str]:
    """A row as text, under `HEADS`."""
    ends = (each["low"], each["high"])
    interval = "" if ends == (None, None) else " to ".join(map(_number, ends))
    n = str(each["n"] or "")
    return each["quantity"], _number(each["value"]), interval, each["unit"], n, each["how"]


def page(found: Mapping[str, Any]) -> str:
    """The certificate as one HTML file."""
    rows = [dict(zip(HEADS, cells(each), strict=True)) for each in found["rows"]]
    template = environment().get_template("certificate.html.j2")
    return template.render(found, rows=rows, delays=Markup(curves(found)))


def differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> Iterator[str]:
    """Two certificates, a line for each quantity that both have."""
    others = {(each["quantity"], each["unit"]): each for each in second["rows"]}
    yield f"{first['sensor']} | {second['sensor']}"
    for each in first["rows"]:
        other = others.get((each["quantity"], each["unit"]))
        if other is None or each["value"] is other["value"] is None:
            continue
        one, two = each["value"], other["value"]
        ratio = f", x {two / one:.3g}" if one and two else ""
        yield f"{each['quantity']}: {_number(one)} | {_number(two)} {each['unit']}{ratio}".rstrip()
