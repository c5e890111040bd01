"""The base of sensors on a serial port that send a line for each sample."""

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from drivers.core.clock_model import DeviceClock, HostClock
from drivers.core.links import LineBuffer, SerialLink, SerialPort, open_serial
from drivers.core.messages import Command, DeviceInfo, Listen, StreamInfo
from drivers.core.numbering import SampleStream
from drivers.core.wire import Inquiry, WireDriver, check_sensor

LONGEST_LINE = 1024
"""Bytes; what is longer is no line of a sensor (assumption)."""


class LineSensorSettings(SerialPort):
    """A sensor that sends lines."""

    reply_timeout_s: float = Field(default=0.2, gt=0.0, le=10.0)
    """When it is asked again (assumption)."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Silence after which it has failed (assumption: tens of samples)."""
    max_drift_ppm: float = Field(default=10_000.0, gt=0.0, le=50_000.0)
    """Bound on the drift between its clock and the host's. Assumption: a ceramic resonator is within 5000 ppm."""


class LineIdentity(NamedTuple):
    """What a sensor says of itself.

    Attributes:
        stream: Its samples; the name as in `<device>.force`, the unit and scale of a count.
        wrap_s: After how long its clock is zero again; None never.
        counter_modulus: At which its counter of samples is zero again; None where it counts none.
    """

    model: str
    serial: str
    stream: StreamInfo
    wrap_s: float | None = None
    counter_modulus: int | None = None


class LineSample(NamedTuple):
    """A sample: counts of each channel, what the sensor's clock showed (s), and its number by the sensor."""

    counts: Sequence[float]
    shown_s: float
    counter: int | None = None


class LineSensor(WireDriver[SerialLink]):
    """A sensor that sends a line for each sample.

    A subclass names its stream, three orders, and reads its lines.

    Attributes:
        channel: Of its stream: `force` is `<device>.force`.
    """

    channel: ClassVar[str]
    query: ClassVar[bytes]
    start: ClassVar[bytes]
    stop: ClassVar[bytes]

    _settings: LineSensorSettings
    _opens = staticmethod(open_serial)

    def parse(self, line: bytes) -> LineIdentity | LineSample | None:
        """What a line says; None where it is an acknowledgement.

        Raises:
            CodecError: it is no line of this sensor.
        """
        raise NotImplementedError

    def account(self) -> Mapping[str, object]:
        """Lines that made no sense, and the drift of its clock."""
        return {"malformed": self._malformed, **self._own_clock.account(self.name)}

    def _prepare(self) -> None:
        self._stream_name = f"{self.name}.{self.channel}"
        self._forget()

    def _forget(self) -> None:
        self._lines = LineBuffer(LONGEST_LINE)
        self._malformed, self._wrong = 0, ""  # lines that made no sense, and why the latest made none
        self._streams: dict[str, SampleStream] = {}
        self._own_clock: DeviceClock = HostClock()
        self._listening = frozenset[str]()
        self._received_s = 0.0

    def _identify(self, link: SerialLink) -> DeviceInfo:
        s = self._settings
        inquiry = Inquiry(
            self.name,
            f"asking who is at {s.port}",
            link,
            self._clock,
            s.reply_timeout_s,
            strange=lambda: f"{self._malformed} lines that are not its own arrived" * bool(self._malformed),
            stranger="is another device at this port, or the baud rate wrong?",
            silent="is it powered, and is this its port?",
        )
        link.send(self.stop)  # an earlier host may have left it on
        found = inquiry.ask(lambda: link.send(self.query), self._identity)
        clock = self._own_clock = DeviceClock(s.max_drift_ppm, wrap_s=found.wrap_s)
        name = found.stream.name
        self._streams[name] = SampleStream(
            found.stream, clock, self._clock, np.float64, found.counter_modulus
        )
        return DeviceInfo(
            self.name,
            found.model,
            found.serial,
            streams={name: found.stream},
            clock=f"{self.name}'s own",
            details={"port": s.port},
        )

    def _leave(self, link: SerialLink, failure: str | None) -> None:
        link.send(self.stop)

    def _valid(self, command: Command) -> Command:
        return check_sensor(self.name, command, (self._stream_name,), "a sensor", (Listen,))

    def _carry_out(self, command: Command) -> None:
        wanted = command.streams if isinstance(command, Listen) else frozenset[str]()
        if wanted != self._listening and self._link is not None:
            for name in wanted - self._listening:
                self._streams[name].begin()
            self._listening, self._received_s = wanted, self._clock.monotonic_s()
            self._sent(command, self._link.send(self.start if wanted else self.stop))

    def _update(self, link: SerialLink) -> str | None:
        for arrival_s, data in link.receive():
            for message in self._messages(data):
                if isinstance(message, LineSample) and self._listening:
                    self._received_s = arrival_s
                    self._take(message, arrival_s)
        for stream in self._streams.values():
            self._blocks += stream.take()
        limit_s, silent_s = self._settings.silence_timeout_s, self._clock.monotonic_s() - self._received_s
        silent = bool(self._listening) and silent_s > limit_s
        return f"no sample in {limit_s:g} s; is it powered?" if silent else None

    def _take(self, sample: LineSample, arrival_s: float) -> None:
        """Handle a sample that is listened to."""
        self._push(self._stream_name, sample, arrival_s)

    def _push(self, name: str, sample: LineSample, arrival_s: float) -> None:
        """Number and date the counts of a stream."""
        t_s, lost = self._streams[name].push(sample.counts, sample.shown_s, arrival_s, sample.counter)
        if lost is not None:
            self._lost(t_s, name, lost)

    def _identity(self, arrived: tuple[float, bytes]) -> LineIdentity | None:
        return next((found for found in self._messages(arrived[1]) if isinstance(found, LineIdentity)), None)

    def _messages(self, data: bytes) -> Iterator[LineIdentity | LineSample]:
        for line in self._lines.feed(data):
            if (message := self._parsed(line)) is not None:
                yield message

    def _parsed(self, line: bytes) -> LineIdentity | LineSample | None:
        """See `parse`; a line that makes no sense is counted."""
        try:
            return self.parse(line)
        except ValueError as error:  # `CodecError` is one, and so is what `float` says of a garbled number
            self._malformed, self._wrong = self._malformed + 1, str(error)
            return None
