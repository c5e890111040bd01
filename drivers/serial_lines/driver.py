"""Any board that prints a line of numbers for each sample: columns, units and rate are the profile's."""

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from drivers.core.clock_model import DeviceClock, HostClock
from drivers.core.errors import CodecError, DeviceError, PortError, ProtocolError, SilentError
from drivers.core.line_sensor import LineSample, LineSensor
from drivers.core.links import SerialLink
from drivers.core.messages import Command, DeviceInfo, Listen, Tare
from drivers.core.numbering import ENDLESS, SampleStream
from drivers.core.scaled import ScaledStreams
from drivers.core.wire import TURN_S, check_sensor
from drivers.serial_lines.codec import SHOWN
from drivers.serial_lines.settings import SerialLinesSettings

RATE_ERROR = 0.03
"""How far the rate by the board's time may be from the profile's. Assumption: an interval of 30 is one too many."""

RATE_ERROR_ARRIVALS = 0.3
"""Likewise by arrivals, where the board has no time: those of the first lines are irregular (assumption)."""

APART_S = 1e-6
"""Least time between two samples that are dated by their arrivals."""


class SerialLines(LineSensor):
    """A board that prints lines.

    Nothing is sent to it. A port that is opened resets most boards: it is open once the board prints sound lines
    without a break, whatever its boot loader and its sketch print before that.
    """

    query = start = stop = b""
    settled: ClassVar[tuple[float, int]] = (0.3, 3)
    """Sound lines without a break, in seconds and in lines, after which it is open (assumption)."""

    _settings: SerialLinesSettings

    def parse(self, line: bytes) -> LineSample:
        """See `LineSensor.parse`: all numbers of the line."""
        s, self._latest = self._settings, line
        self._seen += 1
        numbers = self._format.decode(line)
        if len(numbers) != (self._width or max(len(numbers), s.fields)):
            wanted = self._width or f"{s.fields} or more"
            raise CodecError(f"{line[:SHOWN]!r} has {len(numbers)} numbers, not {wanted}")
        return LineSample(numbers, *self._clocked(numbers))

    def _clocked(self, numbers: Sequence[float]) -> tuple[float, int | None]:
        """What the board says of when a line was sampled: its time, s, and its count; raises `CodecError`."""
        s, counter, shown_s = self._settings, None, math.nan
        if s.counter_column is not None and s.counter_modulus is not None:
            counter = _whole(numbers, s.counter_column, s.counter_modulus)
            shown_s = counter / s.rate_hz if s.rate_hz else math.nan
        elif s.rate_hz is None:
            counter = self._seen  # a line that made no sense was a sample
        if s.time_column is not None:
            shown_s = _whole(numbers, s.time_column, s.time_modulus or ENDLESS) * s.time_unit_s
        return shown_s, counter

    def zero_setting(self, stream: str) -> str:
        """See `OwnZero.zero_setting`."""
        return self._scaled.setting(stream)

    def account(self) -> Mapping[str, object]:
        """Lines that made no sense, the drift of the board's clock, and what is printed at zero."""
        malformed = self._malformed + self._lines.dropped
        return {**super().account(), "malformed": malformed, "offsets": dict(self._scaled.zeros)}

    def _prepare(self) -> None:
        s = self._settings
        self._format = s.format
        self._scaled = ScaledStreams(self.name, s.streams, s.rate_hz)
        self._forget()

    def _forget(self) -> None:
        super()._forget()
        self._lines = self._format.buffer()
        self._width: int = 0
        self._seen: int = 0
        self._bytes = 0
        self._latest = b""
        self._shown_s = -math.inf
        self._scaled.forget()

    def _identify(self, link: SerialLink) -> DeviceInfo:
        s = self._settings
        sound = self._first_lines(link)
        self._width, self._malformed = len(sound[-1][1].counts), 0  # what came before does not count
        rate_hz = self._check_rate(sound)
        own = s.time_column is not None or s.rate_hz is not None
        clock = DeviceClock(s.max_drift_ppm, wrap_s=s.wrap_s) if own else HostClock()
        self._own_clock = clock
        modulus = s.counter_modulus or (None if s.rate_hz else ENDLESS)
        longest_s = None if s.rate_hz else s.silence_timeout_s
        infos = [one.info(name, s.rate_hz, longest_s) for name, one in self._scaled.streams.items()]
        self._streams = {
            info.name: SampleStream(info, clock, self._clock, np.float64, modulus) for info in infos
        }
        details = {"port": s.port, "prints": self._format.shown(self._latest), "columns": self._width}
        return DeviceInfo(
            self.name,
            self._format.model,
            streams={info.name: info for info in infos},
            clock=f"{self.name}'s own" if own else "arrivals",
            details=details | ({"rate_hz": round(rate_hz, 3)} if rate_hz else {}),
        )

    def _first_lines(self, link: SerialLink) -> list[tuple[float, LineSample]]:
        """Sound lines of one width without a break, and when they arrived; raises a `DeviceError`."""
        s, (long_s, many) = self._settings, self.settled
        sound: list[tuple[float, LineSample]] = []
        until_s = self._clock.monotonic_s() + s.reply_timeout_s
        while True:
            for arrival_s, data in link.receive():
                self._bytes += len(data)
                for line in self._lines.feed(data):
                    sample = self._parsed(line)
                    # The first one may have been cut by the opening, and its time with it.
                    if not isinstance(sample, LineSample) or self._seen == 1:
                        sound = []
                        continue
                    if sound and len(sample.counts) != len(sound[-1][1].counts):
                        sound = []  # the line before was a half one
                    sound.append((arrival_s, sample))
            if len(sound) >= many and sound[-1][0] - sound[0][0] >= long_s:
                return sound
            if link.fault is not None or self._clock.monotonic_s() > until_s:
                raise self._unsound(link, bool(sound))
            self._clock.rest(TURN_S)

    def _unsound(self, link: SerialLink, sound: bool) -> DeviceError:
        """Why it could not be opened."""
        s, doing = self._settings, f"waiting for sound lines at {self._settings.port}"
        if link.fault is not None:
            return PortError(self.name, doing, link.fault, "is it plugged in and powered?")
        if not self._bytes:
            return SilentError(
                self.name,
                doing,
                f"nothing came in {s.reply_timeout_s:g} s",
                f"is it powered, is this its port, and does it print at {s.baud} baud?",
            )
        found = f"no {self._format.ending}"
        if self._seen:
            found = self._wrong if self._wrong and not sound else "sound ones have a break"
        return ProtocolError(
            self.name,
            doing,
            f"{self._bytes} bytes and {self._seen} lines came: {found}",
            f"compare baud ({s.baud}) and, of lines, separator ({s.separator!r}; 12.5, not 12,5), columns and checksum"
            f" ({s.checksum}) with what it sends; one that sends seldom needs a greater reply_timeout_s",
        )

    def _check_rate(self, sound: list[tuple[float, LineSample]]) -> float | None:
        """The rate that its first lines have, Hz; None of too few lines. Raises `ProtocolError`: not the profile's."""
        s, (first_s, first), (last_s, last) = self._settings, sound[0], sound[-1]
        by_time = s.time_column is not None
        span_s = last.shown_s - first.shown_s if by_time else last_s - first_s
        if by_time and s.wrap_s:
            span_s %= s.wrap_s
        n = len(sound) - 1
        if s.counter_modulus and last.counter is not None and first.counter is not None:
            n += (last.counter - first.counter - n) % s.counter_modulus  # those that were lost
        rate_hz = n / span_s if span_s > 0.0 else None
        if rate_hz is None and n and by_time:
            raise ProtocolError(
                self.name,
                "reading its clock",
                f"column {s.time_column} stands still",
                "which column is its time?",
            )
        error = RATE_ERROR if by_time else RATE_ERROR_ARRIVALS
        if rate_hz and s.rate_hz and abs(rate_hz / s.rate_hz - 1.0) > error:
            by = "its time" if by_time else "their arrival"
            raise ProtocolError(
                self.name,
                "reading its clock",
                f"it prints {rate_hz:.4g} lines a second by {by}, rate_hz is {s.rate_hz:g}",
                "correct rate_hz or time_unit_s, or leave rate_hz away: then each sample has its own time",
            )
        return rate_hz

    def _valid(self, command: Command) -> Command:
        return check_sensor(self.name, command, self._scaled.streams)

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, Listen):
            for name in command.streams - self._listening:
                self._scaled.begin(name)
        if not isinstance(command, Tare):
            super()._carry_out(command)
        elif self._scaled.tare(command.stream):
            self._sent(command)
        else:
            self._refuse(command, "no samples of it yet; listen to it first")

    def _take(self, sample: LineSample, arrival_s: float) -> None:
        if math.isnan(sample.shown_s):
            self._shown_s = max(arrival_s, self._shown_s + APART_S)
            sample = sample._replace(shown_s=self._shown_s)
        for name in sorted(self._listening):
            printed = [sample.counts[column] for column in self._scaled.streams[name].columns]
            counts = self._scaled.counts(name, np.array([printed]))[0].tolist()
            self._push(name, sample._replace(counts=counts), arrival_s)


def _whole(numbers: Sequence[float], column: int, modulus: int) -> int:
    """The number of a time or a counter; raises `CodecError`."""
    number = numbers[column]
    if not (number.is_integer() and 0 <= number < modulus):
        below = f" from 0 to below {modulus}" * (modulus != ENDLESS)
        raise CodecError(f"column {column} is {number:g}, no whole number{below}")
    return int(number)
