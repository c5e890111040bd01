"""From a recording without events to the threshold that gives a false alarm once in a stated time."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from drivers.core.messages import Floats, Ints, SampleBlock

SPAN_S = 1.0
"""Alarms closer together than this count as one. Assumption: longer than a bump rings, shorter than a user
forgives."""

SHORT_SPAN_S = 0.05
SHORT_S = 40.0
"""Of recordings shorter than the second, that time is shorter in proportion, down to the first: a few seconds of quiet
then suffice, though neighbouring maxima may belong to one disturbance."""

ENOUGH = 5
"""Expected alarms within the recording for its own quantile to be used; below, the tail is extrapolated.
With 5 the interval is known to within a factor of about 2.5 either way (Poisson, 95 %)."""

TAIL = 0.02
TAIL_LEAST = 20
"""Share of the spans, and at least how many, whose maxima the tail is fitted to where it is extrapolated; half of the
spans where there are fewer than twice as many."""

LEAST = 10
"""Least number of spans. Assumption: a tail through five maxima is known to a factor of two."""

FOLDS = 5
"""Parts of a single recording of which each is left out in turn."""

CHECKED = 10
"""False alarms expected in the parts left out, where the requested interval is too long to be checked there: a
threshold for a shorter interval is then checked instead. With 10, half or twice as many are seen by chance alone
once in a hundred checks each (Poisson)."""

PAUSE = 10
"""A detector whose next decision takes more than so many times the usual step between two does not decide meanwhile: it
learns anew, or its mover stands (assumption)."""

WHOLE = 0.5
"""A recording of which a larger share was lost is refused. Assumption: what is left is then no longer what it was."""


@runtime_checkable
class Statistic(Protocol):
    """A detector that can return the statistic it compares with its threshold."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Streams it subscribes to; its statistic is computed from the first one."""

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """The statistic after each sample of a whole recording, shape (n,); NaN where a sample decides nothing."""


@runtime_checkable
class Joined(Statistic, Protocol):
    """A detector whose statistic is computed from several streams."""

    def columns(self, values: Floats, times_s: Floats, blocks: Sequence[SampleBlock]) -> Floats:
        """Input of `statistic`, a row for each sample of the first input, shape (n, columns).

        Args:
            values: The first input, NaN where samples were lost, shape (n, channels).
            times_s: Their times, NaN likewise, shape (n,).
        """


@runtime_checkable
class Proposing(Statistic, Protocol):
    """A detector with further settings that a recording without events decides."""

    def proposed(self, values: Floats, rate_hz: float) -> Mapping[str, float]:
        """The settings that this recording asks for; of several recordings the largest counts."""

    def set_to(self, **settings: float) -> Statistic:
        """The same detector in its initial state, set otherwise."""


class Calibration(NamedTuple):
    """A threshold and its uncertainty.

    Attributes:
        threshold: One false alarm in `false_alarm_interval_s`, on average.
        low: Lower end of its 95 % confidence interval.
        high: Upper end; infinite where the recording is too short to have one.
        recording_s: Length of the recording used: the seconds in which the detector decides.
        sees_s: Longest interval for which such a recording contains enough alarms; longer ones are extrapolated.
        extrapolated: True where the recording is too short to contain the alarms in question, so that the tail
            beyond its largest values was assumed to be exponential.
        pieces: Number of pieces of the recording; the detector is reset before each.
        checked_interval_s: Interval of the thresholds of the cross-validation: each piece (each fifth of a single
            one) is left out in turn and then tested; NaN where too little is left to set a threshold.
        checked_expected: False alarms expected in the cross-validation.
        checked_found: False alarms found there.
    """

    threshold: float
    low: float
    high: float
    false_alarm_interval_s: float
    recording_s: float
    sees_s: float
    extrapolated: bool
    pieces: int = 1
    checked_interval_s: float = math.nan
    checked_expected: float = math.nan
    checked_found: float = math.nan


def limits_of(found: Calibration) -> Sequence[str]:
    """What the recordings could not carry, and how the thresholds held on those left out: a line each."""
    lines = []
    asked_s = found.false_alarm_interval_s
    if found.extrapolated:
        lines.append(
            f"{found.recording_s:.4g} s in which the detector decides carry one false alarm in {found.sees_s:.3g} s;"
            f" one in {asked_s:g} s is extrapolated: record {ENOUGH * asked_s - found.recording_s:.4g} s more"
        )
    if math.isfinite(found.checked_found):
        times = found.checked_found / found.checked_expected
        low, high = (end / found.checked_expected for end in poisson_interval(found.checked_found))
        lines.append(
            f"left out in turn, {found.pieces if found.pieces > 1 else FOLDS} pieces had"
            f" {found.checked_found:.0f} false alarms where one in {found.checked_interval_s:.4g} s"
            f" was asked for: {times:.2g} times as many"
            f" (95 %: {low:.2g} to {high:.2g})"
            + ("; they differ, and so may the next: record more kinds of quiet" if low > 1.0 else "")
        )
    return lines


def calibrate_pieces(
    pieces: Sequence[tuple[Statistic, Sequence[SampleBlock]]], false_alarm_interval_s: float
) -> Calibration:
    """Calibrate the threshold on recorded streams, with cross-validation over the pieces.

    The detector is reset before each piece and after each gap longer than a second; a shorter loss is a gap to it.

    Args:
        pieces: Detector, whose own threshold setting is ignored, and recording: each stream in order, the detector's
            first input at one rate.

    Raises:
        ValueError: the recording is too short or too quiet, or the detector decides nothing on it; values that are not
            finite, irregular times, more than half lost.
    """
    courses = [course for detector, blocks in pieces for course in courses_of(detector, blocks)]
    if not courses:
        raise ValueError("the recording holds no sample")
    spans = spans_of(courses)
    dead = all(_dead(course.values) for course in courses)
    found = _sound(threshold_for(spans.maxima, false_alarm_interval_s, spans.span_s), spans.maxima, dead)
    return _checked(found._replace(pieces=len(courses)), spans)


def proposed(
    pieces: Sequence[tuple[Statistic, Sequence[SampleBlock]]], fixed: Container[str] = ()
) -> tuple[Mapping[str, float], Sequence[tuple[Statistic, Sequence[SampleBlock]]]]:
    """The other settings that recordings without events ask for, but those that are `fixed`; and the pieces with
    detectors set to them.

    Raises:
        ValueError: as `calibrate_pieces`.
    """
    found: dict[str, float] = {}
    for detector, blocks in pieces:
        if isinstance(detector, Proposing):
            for columns, _, _, rate_hz in _inputs_of(detector, blocks):
                for name, value in detector.proposed(columns, rate_hz).items():
                    if name not in fixed:
                        found[name] = max(value, found.get(name, value))
    return found, [
        (detector.set_to(**found) if found and isinstance(detector, Proposing) else detector, blocks)
        for detector, blocks in pieces
    ]


class StatisticCourse(NamedTuple):
    """A stretch of a recording with the detector's statistic; NaN where samples were lost.

    Attributes:
        times_s: Shape (n,).
        values: Of the detector's first input, shape (n, channels).
        statistic: Shape (n,).
    """

    times_s: Floats
    values: Floats
    statistic: Floats
    rate_hz: float


def courses_of(detector: Statistic, blocks: Sequence[SampleBlock]) -> Sequence[StatisticCourse]:
    """A detector's statistic along a recording, restarted after each long gap.

    Raises:
        ValueError: values that are not finite, irregular times, more than half lost.
    """
    return [
        StatisticCourse(times_s, values, detector.statistic(columns, rate_hz), rate_hz)
        for columns, values, times_s, rate_hz in _inputs_of(detector, blocks)
    ]


def _inputs_of(
    detector: Statistic, blocks: Sequence[SampleBlock]
) -> Iterator[tuple[Floats, Floats, Floats, float]]:
    """For each stretch of a recording without a long gap: what the statistic is computed from, the first input, its
    times and its rate."""
    for stretch in _stretches([b for b in blocks if len(b) and b.stream == detector.inputs[0]]):
        values, times_s, rate_hz = _joined(stretch)
        columns = detector.columns(values, times_s, blocks) if isinstance(detector, Joined) else values
        yield columns, values, times_s, rate_hz


def _dead(values: Floats) -> bool:
    """Whether all known values are equal."""
    known = values[~np.isnan(values).any(axis=1)]
    return bool((known == known[:1]).all())


def _sound(found: Calibration, maxima: Floats, dead: bool) -> Calibration:
    """The same calibration, if it is plausible."""
    if (dead and not found.threshold > 0.0) or not found.threshold < math.inf:
        raise ValueError(
            f"the recording asks for a threshold of {found.threshold:g}, which is none; is the sensor alive, is its "
            "range exceeded?"
        )
    # a detector that looks for a shape returns 0 where it finds none: no tail can be fitted to such seconds
    moved = int(np.count_nonzero(maxima > 0.0))
    if not found.threshold > 0.0 or (found.extrapolated and moved <= _tail(len(maxima))):
        raise ValueError(
            f"only {moved} of {len(maxima)} pieces hold anything that could be taken for an event: too quiet to"
            " ask for a threshold; record more of what it shall bear (approaches, starts, stops), or keep its own"
        )
    return found


def _checked(found: Calibration, spans: Spans) -> Calibration:
    """The same calibration with the results of the cross-validation."""
    maxima, owners, span_s = spans
    if found.pieces == 1:  # its first fifths are longer by a span, where there is a rest
        owners = np.repeat(np.arange(FOLDS), [len(part) for part in np.array_split(maxima, FOLDS)])
    interval_s = min(found.false_alarm_interval_s, len(maxima) * span_s / CHECKED)
    alarms = 0
    for left_out in np.unique(owners):
        others = maxima[owners != left_out]
        if len(others) < LEAST or interval_s <= span_s:
            return found
        threshold = threshold_for(others, interval_s, span_s).threshold
        alarms += int(np.count_nonzero(maxima[owners == left_out] >= threshold))
    return found._replace(
        checked_interval_s=interval_s,
        checked_expected=len(maxima) * span_s / interval_s,
        checked_found=alarms,
    )


def _stretches(blocks: Sequence[SampleBlock]) -> Sequence[Sequence[SampleBlock]]:
    """The blocks of a stream, cut where more than a second is missing or the stream restarts."""
    cuts = [
        place
        for place, (a, b) in enumerate(pairwise(blocks), start=1)
        if b.seq < a.seq + len(a) or (b.rate_hz and b.seq - a.seq - len(a) > SPAN_S * b.rate_hz)
    ]
    return [
        blocks[first:last]
        for first, last in zip([0, *cuts], [*cuts, len(blocks)], strict=True)
        if first < last
    ]


def _joined(blocks: Sequence[SampleBlock]) -> tuple[Floats, Floats, float]:
    """All samples of a stream, shape (n, channels), and their times, shape (n,), NaN where lost; and their rate."""
    rates = {block.rate_hz for block in blocks}
    rate_hz = blocks[0].rate_hz
    if rate_hz is None or len(rates) > 1:
        raise ValueError(
            "samples at irregular times have no threshold; where they are regular, pass --rate HZ"
        )
    received = sum(len(block) for block in blocks)
    begin = blocks[0].seq
    length = blocks[-1].seq + len(blocks[-1]) - begin
    if received < (1.0 - WHOLE) * length:
        raise ValueError(
            f"{length - received} of {length} samples are missing; record more of it in one piece"
        )
    values = np.full((length, blocks[0].values.shape[1]), np.nan)
    times_s = np.full(length, np.nan)
    for block in blocks:
        physical = block.physical
        bad = np.flatnonzero(~np.isfinite(physical).all(axis=1))
        if bad.size:
            raise ValueError(f"a value at {block.times[bad[0]]:.6g} s is not finite; cut the recording there")
        place = slice(block.seq - begin, block.seq - begin + len(block))
        values[place], times_s[place] = physical, block.times
    return values, times_s, rate_hz


class Spans(NamedTuple):
    """The time in which a detector decides, cut into spans.

    Attributes:
        maxima: Largest value in each, shape (spans,).
        owners: Number of the course that it is in, shape (spans,).
        span_s: Length of each.
    """

    maxima: Floats
    owners: Ints
    span_s: float


def span_in(decided_s: float) -> float:
    """Length of a span in recordings in which the detector decides for so long, s."""
    return SPAN_S * min(1.0, max(SHORT_SPAN_S / SPAN_S, decided_s / SHORT_S))


def spans_of(courses: Sequence[StatisticCourse]) -> Spans:
    """The time in which the detector decides, of all courses end to end, in spans of a second, of less where there are
    less than `SHORT_S`; a rest of more than half a span is one."""
    decided, step = _decided(courses)
    ends = np.cumsum([len(each) for each in decided])
    decided_s = sum(len(each) / course.rate_hz for each, course in zip(decided, courses, strict=True))
    # of pieces at several rates the mean one: as many spans as there are seconds
    rate_hz = int(ends[-1]) / decided_s if decided_s else courses[0].rate_hz
    span_s = span_in(decided_s)
    size = max(step, round(span_s * rate_hz))
    rest = np.full(max(0, round(int(ends[-1]) / size) * size - int(ends[-1])), np.nan)
    joined = np.concatenate([*decided, rest])
    places = _largest_places(joined, size)
    owners = np.searchsorted(ends, places, side="right")
    return Spans(joined[places], owners, round(size / rate_hz, 6))


def _decided(courses: Sequence[StatisticCourse]) -> tuple[Sequence[Floats], int]:
    """Of each course the statistic in the time in which the detector decides, and the usual step between two decisions,
    samples: a decision stands for the time since the last one, the first one and that after a pause for a step."""
    at = [np.flatnonzero(~np.isnan(course.statistic)) for course in courses]
    steps = [float(np.median(np.diff(each))) for each in at if len(each) > 1]
    step = max(1, round(float(np.median(steps)))) if steps else 1
    found = []
    for course, each in zip(courses, at, strict=True):
        runs = np.split(each, np.flatnonzero(np.diff(each) > PAUSE * step) + 1) if len(each) else []
        parts = [course.statistic[max(0, run[0] - step + 1) : run[-1] + 1] for run in runs]
        found.append(np.concatenate(parts) if parts else np.empty(0))
    return found, step


def _largest_places(statistic: Floats, size: int) -> Ints:
    """Where the largest value of each whole span of `size` samples is; spans without a decision left out."""
    count = len(statistic) // size
    spans = np.where(np.isnan(statistic), -math.inf, statistic)[: count * size].reshape(count, size)
    places: Ints = spans.argmax(axis=1) + size * np.arange(count)
    return places[statistic[places] > -math.inf]


def span_maxima(statistic: Floats, rate_hz: float, span_s: float = SPAN_S) -> Floats:
    """Largest value in each whole span of one recording, from its first sample on, spans without a decision left out,
    shape (spans,)."""
    return statistic[_largest_places(statistic, max(1, round(span_s * rate_hz)))]


def threshold_for(maxima: Floats, false_alarm_interval_s: float, span_s: float = SPAN_S) -> Calibration:
    """The threshold from the maxima of event-free spans.

    Args:
        maxima: Largest value in each span, shape (spans,).

    Raises:
        ValueError: too few spans, or an interval of no more than one.
    """
    recording_s = len(maxima) * span_s
    if not false_alarm_interval_s > span_s:
        raise ValueError(
            f"a false-alarm interval of {false_alarm_interval_s:g} s is too short; ask for more than {span_s:g} s"
        )
    if len(maxima) < LEAST:
        raise ValueError(
            f"{recording_s:g} s in which the detector decides are too few; record {LEAST * span_s:g} s more, and what"
            " the detector learns from before"
        )
    ordered = np.sort(maxima)[::-1]
    expected, sees_s = recording_s / false_alarm_interval_s, recording_s / ENOUGH
    if expected >= ENOUGH:
        low, high = poisson_interval(expected)
        ranks = [min(len(ordered), round(rank)) for rank in (high, expected, low)]
        # just above the value of rank k: k - 1 spans alarm; a rank below 1 lies beyond the recording
        levels = [float(ordered[rank - 1]) if rank >= 1 else math.inf for rank in ranks]
        return Calibration(
            levels[1], levels[0], levels[2], false_alarm_interval_s, recording_s, sees_s, False
        )
    return _extrapolated(ordered, expected, false_alarm_interval_s, recording_s)


def poisson_interval(count: float) -> tuple[float, float]:
    """95 % confidence interval of a Poisson mean of which `count` were seen (F. Garwood, Biometrika 28, 1936)."""
    from scipy.special import gammaincinv  # a third of what all of scipy.stats takes to load

    low = float(gammaincinv(count, 0.025)) if count > 0.0 else 0.0
    return low, float(gammaincinv(count + 1.0, 0.975))


def _extrapolated(
    ordered: Floats, expected: float, false_alarm_interval_s: float, recording_s: float
) -> Calibration:
    """An exponential tail through the largest maxima.

    Where it starts is known to a standard error of scale / sqrt(used), its scale as a mean of exponentials is (chi
    square), and the two are independent (A. Renyi, Acta Math. Acad. Sci. Hung. 4, 1953): together they make the
    interval.
    """
    from scipy.special import gammaincinv

    used = _tail(len(ordered))
    start = float(ordered[used])
    scale = float(np.mean(ordered[:used])) - start
    reach = math.log(used / expected)
    threshold = start + scale * reach
    of_start = 1.96 * scale / math.sqrt(used)
    low, high = (used / float(gammaincinv(used, p)) for p in (0.975, 0.025))
    return Calibration(
        threshold,
        threshold - math.hypot(of_start, reach * scale * (1.0 - low)),
        threshold + math.hypot(of_start, reach * scale * (high - 1.0)),
        false_alarm_interval_s,
        recording_s,
        recording_s / ENOUGH,
        True,
    )


def _tail(count: int) -> int:
    """How many of `count` maxima the tail is fitted to."""
    return max(min(TAIL_LEAST, count // 2), int(TAIL * count))
