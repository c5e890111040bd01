"""Input of a measure: the trial's events and streams, live or from a recording."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from behaviors.events import BaselineReady, BaselineRefused, Contact, Event
from controller.detectors.protocol import Detector
from controller.recording.series import Series, Span, TrialRecording
from drivers.core.messages import Floats, Lost, Sent, Stop, StreamInfo

E = TypeVar("E", bound=Event)

Measured = tuple[str, dict[str, Any]]
"""What `measure` of every module here gives: a trial's outcome, and its row; None for what did not occur."""

EDGE_S = 0.1
"""How late a stream may begin after it was subscribed, and how long before the end of a span its last sample may be:
samples in transit when a state ends are not awaited. As long as `limits.stale_s` is by default."""


class MissingDataError(Exception):
    """A span that a measure uses is not covered by samples."""


@dataclass(slots=True)
class TrialEvidence:
    """Events and data of a trial.

    Attributes:
        recording: The streams; a measure reads them through `stream`, `series` and `covered`.
        events: In the order in which they were handled.
        entered_s: Bench time at which each state was last entered, by name.
        visits: Every state in order of entry, with the bench time.
        truth: Instants at which contact really began and ended, on simulated benches; else None.
        slips: Instants at which slip really did, on benches that simulate slip; else None.
        lifts: While an object is held, what is true of it (`simulator.physics.aura_scene.Lift`), on benches that
            simulate weight; else None.
        slides: When all of it really began and ceased to slide in the fingers, on the same benches.
        notes: What the behavior concluded on the way, by name.
        sources: Input streams of each signal, by the signal's stream.
    """

    factors: Mapping[str, Any]
    recording: TrialRecording
    events: list[Event] = field(default_factory=list)
    entered_s: dict[str, float] = field(default_factory=dict)
    visits: list[tuple[str, float]] = field(default_factory=list)
    truth: Sequence[tuple[float, bool]] | None = None
    slips: Sequence[tuple[float, bool]] | None = None
    lifts: Sequence[Any] | None = None
    slides: Sequence[tuple[float, bool]] | None = None
    notes: Mapping[str, Sequence[float]] = field(default_factory=dict)
    detectors: Mapping[str, Detector] = field(default_factory=dict)
    streams: Mapping[str, StreamInfo] = field(default_factory=dict)
    sources: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def touched_s(self, since_s: float = -math.inf) -> float | None:
        """When contact first began from some time on, in truth; None where it did not, or that is not known."""
        return next((t_s for t_s, made in self.truth or () if made and t_s >= since_s), None)

    @property
    def ended_s(self) -> float:
        """The last that is known of the trial, bench time."""
        last_s = [t_s for _, t_s in self.visits[-1:]] + [event.t_s for event in self.events[-1:]]
        return max(last_s, default=math.inf)

    def covered(
        self,
        stream: str,
        since_s: float = -math.inf,
        until_s: float = math.inf,
        channels: slice = slice(None),
    ) -> Series:
        """A whole stream, of which a span is to be used.

        Args:
            channels: Those that are. What a device sends in them that is no number is missing, too.

        Raises:
            MissingDataError: nothing of the span was subscribed, or samples are missing in what was.
        """
        series = self.recording.stream(stream)
        since_s, until_s = max(since_s, 0.0), min(until_s, self.ended_s)
        if until_s <= since_s:
            return series
        lost_s, times_s = self._lost_s(stream), series.times_s
        if stream not in self.sources:  # a signal has nothing to say at times
            wrong = ~np.isfinite(series.values[:, channels]).all(axis=1)
            lost_s, times_s = [*lost_s, *times_s[wrong].tolist()], times_s[~wrong]
        hole = next(_holes(series, times_s, since_s, until_s, self._longest_s(stream), lost_s), None)
        if hole is not None:
            raise MissingDataError(
                f"{stream}: no samples from {hole[0]:.3f} to {hole[1]:.3f} s, which are measured; look at the cable,"
                f" the power and the load of {self._device(stream)}, then run this trial again"
            )
        return series

    def stream(self, stream: str, since_s: float = -math.inf, until_s: float = math.inf) -> Series:
        """The samples of a span, since_s <= t < until_s.

        Raises:
            MissingDataError: as `covered`.
        """
        return self.covered(stream, since_s, until_s).between(since_s, until_s)

    def series(
        self, stream: str | None, since_s: float = -math.inf, until_s: float = math.inf, channel: int = 0
    ) -> tuple[Floats, Floats]:
        """Times (n,) in seconds and values (n,) of a stream's channel, in its unit, within a span; none of None.

        Raises:
            MissingDataError: as `covered`.
        """
        if stream is None:
            return np.empty(0), np.empty(0)
        series = self.covered(stream, since_s, until_s, slice(channel, channel + 1))
        wanted = (series.times_s >= since_s) & (series.times_s <= until_s)
        return series.times_s[wanted], series.values[wanted, channel]

    def periods(self, stream: str | None, since_s: float, until_s: float) -> tuple[Floats, Floats]:
        """As `series`, of a stream of periods, in s.

        Raises:
            MissingDataError: as `covered`; or one of them is not above zero.
        """
        times_s, periods_s = self.series(stream, since_s, until_s)
        wrong = np.flatnonzero(~(periods_s > 0.0))
        if len(wrong):
            raise MissingDataError(
                f"{stream}: {periods_s[wrong[0]]:g} s at {times_s[wrong[0]]:.3f} s is no period; look at the"
                f" comparator of {self._device(str(stream))}, then run this trial again"
            )
        return times_s, periods_s

    def require_samples(self, detector: str, since_s: float, until_s: float) -> None:
        """Check that a detector's inputs cover a span in which its events are counted.

        Raises:
            MissingDataError: as `covered`.
        """
        for stream in self.detectors[detector].inputs if detector in self.detectors else ():
            self.covered(stream, since_s, until_s)

    def _longest_s(self, stream: str) -> float:
        """Longest time between two samples that is no hole."""
        info = self.streams.get(stream)
        if info is not None and info.longest_s is not None:
            return info.longest_s
        rate_hz = next((block.rate_hz for block in self.recording.blocks(stream)), None)
        if rate_hz is not None:
            return 1.5 / rate_hz
        return max((self._longest_s(source) for source in self.sources.get(stream, ())), default=math.inf)

    def _lost_s(self, stream: str) -> Sequence[float]:
        """When samples of a stream, or of what it is made of, were noticed to be lost."""
        own = [event.t_s for event in self.events if isinstance(event, Lost) and event.stream == stream]
        return [*own, *(t_s for source in self.sources.get(stream, ()) for t_s in self._lost_s(source))]

    def _device(self, stream: str) -> str:
        while stream in self.sources:
            stream = self.sources[stream][0]
        return stream.partition(".")[0]

    def stop_sent_s(self, mover: str, from_s: float) -> float | None:
        """When the first `Stop` from some time on left the host (its last byte), or None."""
        sent = (event for event in self.events if isinstance(event, Sent) and isinstance(event.command, Stop))
        return next((event.t_s for event in sent if event.device == mover and event.t_s >= from_s), None)

    def first(
        self, kind: type[E], since_s: float = -math.inf, until_s: float = math.inf, **wanted: object
    ) -> E | None:
        """First event of a kind in a span (since_s <= t < until_s) whose attributes are as wanted, or None."""
        return next(_matching(self.events, kind, since_s, until_s, wanted), None)

    def last(self, kind: type[E], until_s: float = math.inf, **wanted: object) -> E | None:
        """Last event of a kind up to a time (t < until_s) whose attributes are as wanted, or None."""
        return next(_matching(reversed(self.events), kind, -math.inf, until_s, wanted), None)

    def ending_contact(self, detector: str) -> Contact | None:
        """The contact that ended the approach, or the last one where none did; the detector may stay armed after it."""
        stopped_s = self.entered_s.get("STOPPING", math.inf)
        return self.last(Contact, math.nextafter(stopped_s, math.inf), detector=detector)

    def unlearnt(self, detector: str) -> bool:
        """Whether a detector refused its baseline and has learned none since: its silence means nothing."""
        refused, ready = (self.last(kind, detector=detector) for kind in (BaselineRefused, BaselineReady))
        return refused is not None and (ready is None or ready.t_s < refused.t_s)


def _matching(
    events: Iterable[Event], kind: type[E], since_s: float, until_s: float, wanted: Mapping[str, object]
) -> Iterator[E]:
    for event in events:
        own = isinstance(event, kind) and since_s <= event.t_s < until_s
        if own and all(getattr(event, name) == value for name, value in wanted.items()):
            yield event  # type: ignore[misc]


def _holes(
    series: Series,
    times_s: Floats,
    since_s: float,
    until_s: float,
    longest_s: float,
    lost_s: Sequence[float],
) -> Iterator[tuple[float, float]]:
    """Where samples are missing in a span: no subscription, lost samples, a late start, a silence, an early end. Where
    a loss was noticed at `lost_s`, no sample is in transit; it is noticed when the next sample is read, which is up to
    `EDGE_S` after its time."""
    for gap in series.gaps:
        if min(gap.t1_s, until_s) - max(gap.t0_s, since_s) > longest_s:
            yield gap.t0_s, gap.t1_s
    subscribed = list(without(since_s, until_s, series.skipped))
    if not subscribed:
        yield since_s, until_s
    patience_s = max(longest_s, EDGE_S)
    for begin_s, end_s in subscribed:
        inside = times_s[(times_s >= begin_s) & (times_s <= end_s)]
        edges_s = np.concatenate(([begin_s], inside, [end_s] if math.isfinite(end_s) else []))
        for place in np.flatnonzero(np.diff(edges_s) > longest_s):
            from_s, to_s = float(edges_s[place]), float(edges_s[place + 1])
            read_s = to_s if to_s == end_s else to_s + EDGE_S
            if to_s - from_s > patience_s or any(from_s < t_s <= read_s for t_s in lost_s):
                yield from_s, to_s


def without(since_s: float, until_s: float, skipped: Sequence[Span]) -> Iterator[tuple[float, float]]:
    """What of a span is left between the skipped ones."""
    here_s = since_s
    for span in sorted(skipped, key=lambda span: span.t0_s):
        if span.t0_s >= until_s:
            break
        if span.t0_s > here_s:
            yield here_s, span.t0_s
        here_s = max(here_s, span.t1_s)
    if here_s < until_s:
        yield here_s, until_s


STEP_S = 1e-3
"""How well the time of a simulated touch or slip is known, s: one step of the benches, which look for them at the
samples of the aura (`ENVELOPE_HZ`) and of the slip plant (`SlipPlantSettings.rate_hz`), each 1 kHz. The resonant
finger's touch is located exactly."""

ROUNDING_S = 1e-9
"""Of times that are a step apart, s."""


def not_before(reported_s: float, true_s: float, step_s: float = STEP_S) -> bool:
    """Whether an event was reported no sooner than it happened, beyond the uncertainty of the truth's own time.

    What is reported sooner is a false alarm, however soon the event follows.

    Args:
        step_s: That uncertainty.
    """
    return reported_s >= true_s - step_s - ROUNDING_S


def delay_s(reported_s: float, true_s: float) -> float:
    """From what happened to its report, s; 0 within the uncertainty of the truth's own time."""
    return max(0.0, reported_s - true_s)


def spans_of(visits: Iterable[tuple[str, float]], state: str) -> list[tuple[float, float]]:
    """From when to when a state lasted, each time; from the states in order of entry, with the bench time."""
    listed = [*visits, ("", math.inf)]
    return [(t_s, listed[i + 1][1]) for i, (name, t_s) in enumerate(listed[:-1]) if name == state]


def spans_within(changes: Iterable[tuple[float, bool]]) -> list[tuple[float, float]]:
    """From when to when something held, from instants at which it began and ended; what overlaps is one."""
    spans: list[tuple[float, float]] = []
    held, begun_s = 0, math.nan
    for t_s, began in changes:
        if began and held == 0:
            begun_s = t_s
        held += 1 if began else -1
        if held == 0:
            spans.append((begun_s, t_s))
    return [*spans, (begun_s, math.inf)] if held > 0 else spans
