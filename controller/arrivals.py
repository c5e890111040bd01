"""Whether what is subscribed arrives: a stream that falls silent, sends what is no number or sticks ends the trial, in
motion and at rest."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import PROGRAM
from drivers.core.messages import Failed, Floats, SampleBlock, StreamInfo

REST = 4.0
"""Times `limits.stale_s` that a stream may be silent where no motion depends on it. Assumption: buffers keep what comes
while a host is away for less, and a record of half a second that gets no sample is noticed."""

EQUAL = 50
"""As many equal samples at least are a sensor that is stuck, however long a slow one takes for them. Assumption: where
the noise is half a count, one chance in 1e8 that a sensor which works repeats one value so often."""

SHOWN = 3
"""How many channels are shown of a stream that is wrong."""

REMEDY = f"look at its power and cable, then: {PROGRAM} check PROFILE --connect"


class Arrivals:
    """Follows every subscribed stream.

    Args:
        stale_s: Longest silence of a stream that a motion depends on, while anything moves.
        stuck_s: Longest time for which a stream with noise may repeat one raw value, in `EQUAL` samples or more; None
            does not judge.
    """

    def __init__(self, stale_s: float, stuck_s: float | None) -> None:
        self._stale_s = stale_s
        self._stuck_s = stuck_s
        self._infos: Mapping[str, StreamInfo] = {}
        self._sources: Mapping[str, Sequence[str]] = {}
        self.begin()

    def begin(self) -> None:
        """Begin a trial: nothing is subscribed."""
        self._seen_s: dict[str, float] = {}
        # of each stream with noise the value that it shows, since when, and in how many samples
        self._held: dict[str, tuple[NDArray[np.generic], float, int]] = {}
        self._wrong: dict[str, Floats] = {}  # of each stream whose newest sample is no number, that sample
        self._urgent: frozenset[str] = frozenset()
        self._moves_since_s: float | None = None

    def know_streams(self, infos: Mapping[str, StreamInfo], sources: Mapping[str, Sequence[str]]) -> None:
        """Register the streams: their descriptions, and of which others a signal is made."""
        self._infos, self._sources = infos, sources

    def depend(self, urgent: frozenset[str]) -> None:
        """Name the streams that a motion depends on."""
        self._urgent = urgent

    def expect(self, streams: frozenset[str], t_s: float) -> None:
        """Subscribe to these from now on, and to no others; those that stay keep their age."""
        self._seen_s = {stream: self._seen_s.get(stream, t_s) for stream in sorted(streams)}
        self._held = {stream: held for stream, held in self._held.items() if stream in streams}
        self._wrong = {stream: wrong for stream, wrong in self._wrong.items() if stream in streams}

    def move(self, t_s: float, moving: bool) -> None:
        """Note whether anything moves in the turn at `t_s`, the first of those that are processed as one."""
        if not moving:
            self._moves_since_s = None
        elif self._moves_since_s is None:
            self._moves_since_s = t_s

    def check(
        self, t_s: float, blocks: Iterable[SampleBlock], moving: bool, late_s: float = 0.0
    ) -> Failed | None:
        """See one turn of the loop.

        Args:
            late_s: How much later than planned the turn began: a late loop polled no device.

        Returns:
            Which device no longer sends what it should, and why; None while all arrives.
        """
        self.move(t_s, moving)
        stuck = None
        for block in blocks:
            if len(block) and block.stream in self._seen_s:
                # A time stamp from the future keeps nothing alive.
                last_s = max(self._seen_s[block.stream], min(self._last_s(block), t_s))
                self._seen_s[block.stream] = last_s
                stuck = self._sticks(block, last_s) or stuck
        return self._silent(t_s, late_s) or stuck

    def whole_until_s(self, t_s: float, blocks: Iterable[SampleBlock]) -> float:
        """Until when no stream is silent, in turns that are processed as one; infinite: beyond `t_s`.

        A sample reaches its turn a little later than it is taken: half of what is allowed is left for that.

        Args:
            t_s: Bench time of the last of the turns.
        """
        arrived: dict[str, list[SampleBlock]] = {}
        for block in blocks:
            if len(block) and self._in_numbers(block).all():
                arrived.setdefault(block.stream, []).append(block)
        whole_s = math.inf
        for stream, seen_s in self._seen_s.items():
            since_s, limit_s, _ = self._limit_s(stream, seen_s)
            if limit_s < math.inf:
                whole_s = min(whole_s, _within(since_s, limit_s / 2.0, arrived.get(stream, ()), t_s))
        return whole_s

    def _limit_s(self, stream: str, seen_s: float) -> tuple[float, float, bool]:
        """Since when a stream is silent, how long it may be, and whether a late loop counts."""
        if self._moves_since_s is not None and stream in self._urgent:
            # A stream that was not needed before the motion is not stale, it is about to start.
            return max(seen_s, self._moves_since_s), self._stale_s, True
        return seen_s, self._patience_s(stream), False

    def _silent(self, t_s: float, late_s: float) -> Failed | None:
        for stream, seen_s in self._seen_s.items():
            since_s, limit_s, urgent = self._limit_s(stream, seen_s)
            if t_s - since_s - (0.0 if urgent else late_s) > limit_s:
                reason = (
                    f"{self.named(stream)} {self._fault(stream)} for {t_s - seen_s:.3f} s, since {seen_s:.3f} s"
                    f" (limits.stale_s = {self._stale_s:g}); {REMEDY}"
                )
                return Failed(t_s, self._device(stream), reason)
        return None

    def _fault(self, stream: str) -> str:
        wrong = self._wrong.get(stream)
        if wrong is None:
            return "is silent"
        named = zip(self._infos[stream].channels, wrong, strict=True)
        odd = [f"{channel} = {value}" for channel, value in named if not np.isfinite(value)]
        return f"sends no numbers: {', '.join(odd[:SHOWN])}{', …' * (len(odd) > SHOWN)}"

    def _in_numbers(self, block: SampleBlock) -> NDArray[np.bool_]:
        """Which samples (n,) are: all channels of a device's own stream. A signal has nothing to say at times."""
        if block.values.dtype.kind != "f" or block.stream in self._sources:
            return np.ones(1, dtype=bool)
        return np.asarray(np.isfinite(block.values).all(axis=1))

    def _last_s(self, block: SampleBlock) -> float:
        """When the last sample in numbers was taken; before all time where there is none."""
        numbers = self._in_numbers(block)
        if numbers[-1]:
            self._wrong.pop(block.stream, None)
            return block.last_s
        self._wrong[block.stream] = block.values[-1]
        places = np.flatnonzero(numbers)
        return float(block.times[places[-1]]) if len(places) else -math.inf

    def _patience_s(self, stream: str) -> float:
        """Longest silence at rest; a signal is silent where its sources are, and begins when it can."""
        info = self._infos.get(stream)
        if info is None or info.longest_s is None or stream in self._sources:
            return math.inf
        return max(REST * self._stale_s, 2.0 * info.longest_s)

    def _sticks(self, block: SampleBlock, last_s: float) -> Failed | None:
        info = self._infos.get(block.stream)
        if self._stuck_s is None or info is None or not info.noisy:
            return None
        values, before = block.values, self._held.get(block.stream)
        changes = np.flatnonzero((values[1:] != values[:-1]).any(axis=1)) + 1
        same = before is not None and not (values[0] != before[0]).any()
        if not same and len(changes) == len(values) - 1:
            self._held[block.stream] = values[-1], last_s, 1
            return None
        times_s = block.times
        first_s, earlier = (before[1], before[2]) if before is not None and same else (times_s[0], 0)
        starts_s = np.concatenate(([first_s], times_s[changes]))
        equal = np.diff(changes, prepend=-earlier, append=len(values))
        self._held[block.stream] = values[-1], float(min(starts_s[-1], last_s)), int(equal[-1])
        ends_s = np.minimum(np.concatenate((times_s[changes - 1], times_s[-1:])), last_s)
        beyond = np.flatnonzero((ends_s - starts_s > self._stuck_s) & (equal >= EQUAL))
        if not len(beyond):
            return None
        last = int(beyond[-1])  # however the stream is cut into blocks
        since_s, until_s = float(starts_s[last]), float(ends_s[last])
        stuck = block.physical[changes[last - 1] if last else 0]
        reason = (
            f"{block.stream} sticks at {', '.join(f'{value:.6g}' for value in stuck[:SHOWN])} {info.unit}"
            f" for {until_s - since_s:.3f} s, since {since_s:.3f} s (limits.stuck_s = {self._stuck_s:g}):"
            f" no sensor is so quiet; {REMEDY}"
        )
        return Failed(until_s, self._device(block.stream), reason)

    def named(self, stream: str) -> str:
        """A stream, and of which others it is made."""
        made_of = self._sources.get(stream)
        return f"{stream} (of {', '.join(made_of)})" if made_of else stream

    def _device(self, stream: str) -> str:
        while stream in self._sources:
            stream = self._sources[stream][0]
        return stream.partition(".")[0]


def stuck_after_s(info: StreamInfo, stuck_s: float) -> float:
    """After how long a stream that repeats one value is stuck: where it is slow, `EQUAL` samples take longer."""
    period_s = 1.0 / info.rate_hz if info.rate_hz else info.longest_s or 0.0
    return max(stuck_s, (EQUAL - 1) * period_s)


def _within(since_s: float, gap_s: float, blocks: Iterable[SampleBlock], t_s: float) -> float:
    """When samples first stay out for longer than a gap, from `since_s` to `t_s`; infinite where they never do."""
    for block in blocks:
        times_s = np.append(since_s, block.t0_s if block.times_s is None else block.times_s)
        if max(float(np.diff(times_s).max()), 1.0 / (block.rate_hz or math.inf)) > gap_s:
            return since_s + gap_s
        since_s = max(since_s, block.last_s)
    return math.inf if t_s - since_s <= gap_s else since_s + gap_s
