"""For every stream: numbers that never wrap, loss detection, times, and blocks without a gap. Pure.

A device with its own clock time-stamps its samples, and some also count them; `StreamTrack` turns both into numbers
and host times. Where the host polls each sample it knows these already, and needs `Samples` alone.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.core.clock import Clock
from drivers.core.clock_model import SETTLING_S, DeviceClock
from drivers.core.messages import SampleBlock, StreamInfo

ENDLESS: Final = 1 << 64
"""Modulus of a counter that never wraps."""

SLACK_S: Final = 0.05
"""How far a counter and device time may disagree. Assumption: firmware stamps that late."""

LATE_S: Final = 0.1
"""A counter that does not go on is one that slipped where its frame is no later than this (assumption)."""

FOLLOW: Final = 0.5
"""Of how far a time stamp is from where it is due, the next are due later or sooner. Assumption: a rate that is off by
less than a quarter loses nothing."""

STEADY: Final = 0.25
"""Of a period: time stamps that fall back by more towards where they are due are late, and still catching up
(assumption)."""

ASTRAY_S: Final = 5.0
"""A device time this far from its arrival is another clock's. Assumption: no first frame is so late."""

STEP_MAX_S: Final = 40e-6
"""Later no two blocks of a stream are put closer together or further apart than they were by more than this: with what
is not yet known of the drift, 50 us."""

SLEW: Final = 4e-3
"""Nor by more than this for each second between them, which is 40 us for blocks of 10 ms (assumption)."""

GAP: Final = 0.1
"""Of a period stays between two samples, however late the line finds the first of them to have been (assumption)."""


class Placed(NamedTuple):
    """Where samples stand.

    Attributes:
        seq: Number of the first.
        t0_s: Its monotonic host time in seconds.
        device_s: Its extended device time in seconds.
        lost: How many are missing before it; 0 where its counter or clock restarted and the number is unknown;
            None where it follows on the one before, or begins with a subscription.
    """

    seq: int
    t0_s: float
    device_s: float
    lost: int | None


class StreamTrack:
    """One stream of a device with a clock of its own.

    Device time and the counter, where there is one, must agree on the number of missing samples. Where they do not, or
    time goes back, device time decides: if it agrees with the arrivals, the counter has slipped, and the stream begins
    a new segment on the same clock; if not, the device has restarted, and with it its clock and every stream. A new
    segment is numbered by host time, and never directly follows the last: no gap looks closed.

    Args:
        rate_hz: Of the stream; None where samples are irregular.
        counter_modulus: At what the device's counter of samples is zero again: 256 for 8 bits, `ENDLESS` for never;
            None where it has none. Device time must be right to half of what the counter spans.
    """

    def __init__(self, clock: DeviceClock, rate_hz: float | None, counter_modulus: int | None = None) -> None:
        self._clock = clock
        self._modulus = counter_modulus
        self._rate_hz = rate_hz
        self._period_s = 0.0 if rate_hz is None else 1.0 / rate_hz
        self._restarts = 0
        self._begins = True
        self._seq: int | None = None
        # What the next sample has if nothing is missing.
        self._counter = 0
        self._due_s = 0.0
        self._last_s = -math.inf  # host time of the last sample
        self._dated = (0.0, 0.0)  # device and host time of the last that was dated by the line

    def begin(self) -> None:
        """The stream was subscribed again: what is missing before the next sample is not lost."""
        self._begins = True

    def place(
        self,
        shown_s: float,
        arrival_s: float,
        n: int = 1,
        span_s: float = 0.0,
        counter: int | None = None,
        joins: bool = False,
        missing: int | None = None,
    ) -> Placed:
        """Number and date samples that were in hand at monotonic time `arrival_s`.

        Args:
            shown_s: What the device's clock showed at the first of them.
            arrival_s: In seconds.
            span_s: Device time from the first to the last; of a regular stream it is known.
            counter: Number of the first by the device; None where it has none.
            joins: They may become part of the block of those before, whose times then go on.
            missing: How many are missing before them, where that is known better than by device time.

        Raises:
            ValueError: a counter, and no `counter_modulus`: each of its wraps would be a loss.
        """
        if counter is not None and self._modulus is None:
            raise ValueError("a counter of samples without a counter_modulus; at what does it wrap to zero?")
        clock = self._clock
        if self._rate_hz is not None:
            span_s = (n - 1) * self._period_s
        first_s, ahead_s = clock.extended(shown_s, arrival_s)
        goes_on = not self._begins and self._restarts == clock.restarts
        found = self._missing(first_s, counter) if goes_on else None
        missing = found if found is None or missing is None else missing
        if self._restarted(goes_on, missing, first_s, ahead_s + span_s):
            clock.restart()
            first_s, missing, goes_on = shown_s, None, False
        clock.observe(first_s + span_s, arrival_s)
        joined = missing == 0 and joins
        host_s = self._last_s + self._period_s if joined else self._date(first_s, goes_on)
        seq = self._number(counter, missing, host_s)
        lost = None if self._begins else 0 if missing is None else missing or None
        self._last_s = host_s + span_s * (1.0 if self._rate_hz else clock.pace)
        self._begins, self._restarts = False, clock.restarts
        self._seq, self._counter = seq + n, (counter or 0) + n
        self._due_s = first_s + span_s + self._period_s
        return Placed(seq, host_s, first_s, lost)

    def _missing(self, first_s: float, counter: int | None) -> int | None:
        """Samples missing before this one; None where counter and time do not go on from where they were."""
        elapsed = (first_s - self._due_s) * (self._rate_hz or 0.0)
        if counter is None:
            return max(0, round(elapsed)) if elapsed >= -1.0 else None
        modulus = self._modulus or ENDLESS
        missing = (counter - self._counter) % modulus
        if self._rate_hz is None:
            return missing if missing < modulus // 2 and first_s >= self._due_s else None
        # A gap may be longer than the counter: device time shows how often it wrapped.
        missing += modulus * round((elapsed - missing) / modulus)
        agree = missing >= 0 and abs(missing - elapsed) <= max(1.0, SLACK_S * self._rate_hz)
        return missing if agree else None

    def _restarted(self, goes_on: bool, missing: int | None, first_s: float, ahead_s: float) -> bool:
        """Whether the device's clock is another one than before; else a counter that does not go on has slipped."""
        if ahead_s > ASTRAY_S or missing is not None:
            return ahead_s > ASTRAY_S
        if not goes_on:
            return ahead_s < -ASTRAY_S
        return first_s < self._due_s - SLACK_S or not -LATE_S <= ahead_s <= SLACK_S

    def _number(self, counter: int | None, missing: int | None, host_s: float) -> int:
        if self._seq is None:
            return counter or 0
        if missing is not None:
            return self._seq + missing
        return self._seq + max(1, round((host_s - (self._last_s + self._period_s)) * (self._rate_hz or 0.0)))

    def _date(self, first_s: float, goes_on: bool) -> float:
        """Host time of a block's first sample, at extended device time `first_s`: times ascend, and follow the line by
        steps too small to see.

        Between two blocks the stream's distance from the line shrinks by `SLEW` and `STEP_MAX_S` at most. At once it
        vanishes only while the line settles, after a gap of `SETTLING_S`, and where the stream does not go on by the
        same clock.
        """
        host_s = self._clock.host_s(first_s)
        since_s = first_s - self._dated[0]
        if goes_on and self._clock.settled and since_s < SETTLING_S:
            carried_s = self._dated[1] + since_s * self._clock.pace
            limit_s = min(STEP_MAX_S, SLEW * since_s)
            host_s = min(max(host_s, carried_s - limit_s), carried_s + limit_s)
        host_s = max(host_s, self._last_s + GAP * self._period_s)
        self._dated = (first_s, host_s)
        return host_s


class Samples:
    """Samples of one stream that come one by one, made into blocks without a gap."""

    def __init__(self, info: StreamInfo, dtype: type[np.generic]) -> None:
        self.info = info
        self._dtype = dtype
        self._runs: list[tuple[int, list[float], list[ArrayLike], list[float], float | None]] = []

    def __bool__(self) -> bool:
        return bool(self._runs)

    def push(
        self, seq: int, t_s: float, arrival_s: float, values: ArrayLike, device_s: float | None = None
    ) -> None:
        """Take the sample number `seq`, of shape (channels,); one that does not follow on the last begins a block.

        Args:
            t_s: Its time, in seconds.
            arrival_s: When it was in hand, in seconds.
            device_s: The device's own time, in seconds.
        """
        if not self._runs or seq != self._runs[-1][0] + len(self._runs[-1][1]):
            self._runs.append((seq, [], [], [], device_s))
        _, times_s, samples, arrivals_s, _ = self._runs[-1]
        times_s.append(t_s)
        samples.append(values)
        arrivals_s.append(arrival_s)

    def take(self, origin_s: float = 0.0) -> list[SampleBlock]:
        """Blocks since the last call; the times pushed count from `origin_s` of bench time."""
        runs, self._runs = self._runs, []
        return [
            self.info.block(
                seq,
                times_s[0] + origin_s,
                np.array(samples, dtype=self._dtype),
                times_s=None if self.info.rate_hz else np.array(times_s) + origin_s,
                device_t0_s=device_s,
                arrival_s=arrivals_s[-1] + origin_s,
            )
            for seq, times_s, samples, arrivals_s, device_s in runs
        ]


class _Stamped(NamedTuple):
    """A sample; all times in seconds.

    Attributes:
        first_s: Its extended device time.
        shown_s: What the device's clock showed.
    """

    values: ArrayLike
    first_s: float
    shown_s: float
    arrival_s: float


class SampleStream:
    """One stream of samples that come one by one, from a device with a clock of its own, made into blocks.

    A regular stream without a counter is numbered by its time stamps alone. A sample that is stamped late by more than
    half a period, and no more than `SLACK_S`, is kept until the next one shows whether that lasts: then samples are
    missing before it; else it counts as stamped when it was due.

    Args:
        bench: Turns monotonic time into bench time.
    """

    def __init__(
        self,
        info: StreamInfo,
        clock: DeviceClock,
        bench: Clock,
        dtype: type[np.generic],
        counter_modulus: int | None = None,
    ) -> None:
        self.info = info
        self._clock = clock
        self._bench = bench
        self._track = StreamTrack(clock, info.rate_hz, counter_modulus)
        self._samples = Samples(info, dtype)
        self._rate_hz = info.rate_hz or 0.0
        self._restarts = clock.restarts
        # Without a counter: device time at which the next sample is due, by all stamps.
        self._grid_s = math.nan
        self._kept: _Stamped | None = None

    def begin(self) -> None:
        """See `StreamTrack.begin`; a sample that is kept is of the subscription before."""
        self._grid_s, self._kept = math.nan, None
        self._track.begin()

    def push(
        self, values: ArrayLike, shown_s: float, arrival_s: float, counter: int | None = None
    ) -> tuple[float, int | None]:
        """Take a sample; returns its bench time and what was lost before it, as `Placed` has it. Of one that is kept
        the next call returns both.

        Args:
            arrival_s: Monotonic time at which it was in hand.
            counter: Its number by the device, where it has one.
        """
        if self._restarts != self._clock.restarts:  # another stream's sample showed it
            self._grid_s, self._kept = math.nan, None
        now = _Stamped(values, self._clock.extended(shown_s, arrival_s)[0], shown_s, arrival_s)
        if counter is not None or not self._rate_hz:
            return self._told(self._place(now, counter))
        told = None
        if (kept := self._kept) is not None:
            before, lasts = self._behind(kept), self._behind(now) - 1.0
            told = self._settle(kept, min(before, lasts) if lasts > before - STEADY else 0.0)
            self._kept = None
        behind = self._behind(now)
        if 0.5 < behind <= SLACK_S * self._rate_hz:
            self._kept = now
            return told or (self._bench.from_monotonic(arrival_s), None)
        found = self._settle(now, behind)
        return found if told is None or told[1] is None else told

    def take(self) -> list[SampleBlock]:
        """Blocks since the last call."""
        return self._samples.take(self._bench.from_monotonic(0.0))

    def _behind(self, sample: _Stamped) -> float:
        """By how many periods it is stamped later than due; 0 where that is not known."""
        return 0.0 if math.isnan(self._grid_s) else (sample.first_s - self._grid_s) * self._rate_hz

    def _settle(self, sample: _Stamped, skipped: float) -> tuple[float, int | None]:
        """Place a sample before which so many periods were skipped; stamped later than that by more than half a period,
        it counts as stamped when it was due. Returns as `push`."""
        missing = max(0, round(skipped))
        late = self._behind(sample) - missing
        if late > 0.5:
            sample, late = sample._replace(shown_s=sample.shown_s - late / self._rate_hz), 0.0
        placed = self._place(sample, missing=missing)
        self._grid_s += (missing + 1.0 + FOLLOW * late) / self._rate_hz
        if math.isnan(self._grid_s) or placed.lost == 0:
            self._grid_s = placed.device_s + 1.0 / self._rate_hz
        return self._told(placed)

    def _place(self, sample: _Stamped, counter: int | None = None, missing: int | None = None) -> Placed:
        joins = bool(self._samples) and self.info.rate_hz is not None  # else each has its own time
        placed = self._track.place(
            sample.shown_s, sample.arrival_s, counter=counter, joins=joins, missing=missing
        )
        self._restarts = self._clock.restarts
        self._samples.push(placed.seq, placed.t0_s, sample.arrival_s, sample.values, placed.device_s)
        return placed

    def _told(self, placed: Placed) -> tuple[float, int | None]:
        return self._bench.from_monotonic(placed.t0_s), placed.lost
