"""A small force sensor on a serial port."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import Field

from touchbench import (
    CodecError,
    Command,
    DeviceClock,
    DeviceInfo,
    Inquiry,
    Listen,
    SampleStream,
    SerialLink,
    SerialPort,
    StreamInfo,
    WireDriver,
    check_streams,
    open_serial,
    wrong,
)

from . import codec


class ForceSensorSettings(SerialPort):
    """The force sensor."""

    reply_timeout_s: float = Field(default=0.2, gt=0.0, le=10.0)
    """How long an answer may take (assumption)."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Silence after which it has failed (assumption: fifty samples)."""


class ForceSensor(WireDriver[SerialLink]):
    """A force sensor; a `touchbench.Device`. Its stream is `<name>.force`, in N."""

    _settings: ForceSensorSettings
    _opens = staticmethod(open_serial)

    def _prepare(self) -> None:
        self._name = f"{self.name}.force"
        self._forget()

    def _forget(self) -> None:
        self._lines = codec.Lines()
        self._malformed = 0
        self._listening = False
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
        link.send(codec.encode("halt"))  # an earlier host may have left it on
        found: codec.Identity = inquiry.ask(lambda: link.send(codec.encode("id")), self._identity, 3)
        info = StreamInfo(self._name, ("force",), "N", found.newton_per_count, found.rate_hz, noisy=True)
        clock = DeviceClock(max_drift_ppm=200.0, wrap_s=codec.TIME_MODULUS * 1e-3)
        self._stream = SampleStream(info, clock, self._clock, np.int32, codec.COUNTER_MODULUS)
        streams, ticks = {info.name: info}, f"{self.name} milliseconds"
        return DeviceInfo(self.name, "FS1", found.serial, streams=streams, clock=ticks)

    def _leave(self, link: SerialLink, failure: str | None) -> None:
        link.send(codec.encode("halt"))

    def account(self) -> Mapping[str, object]:
        """Lines that made no sense."""
        return {"malformed": self._malformed}

    def _valid(self, command: Command) -> Command:
        if not isinstance(command, Listen):
            raise wrong(self.name, command, "it has no such command", "a force sensor can Listen")
        check_streams(self.name, command, command.streams, (self._name,))
        return command

    def _carry_out(self, command: Command) -> None:
        wanted = isinstance(command, Listen) and bool(command.streams)
        if wanted != self._listening and self._link is not None:
            self._listening, self._received_s = wanted, self._clock.monotonic_s()
            self._stream.begin()
            self._sent(command, self._link.send(codec.encode("go" if wanted else "halt")))

    def _update(self, link: SerialLink) -> str | None:
        for arrival_s, message in self._messages(link.receive()):
            if isinstance(message, codec.Sample) and self._listening:
                self._received_s = arrival_s
                sample, shown_s = (message.counts,), message.time_ms * 1e-3
                t_s, lost = self._stream.push(sample, shown_s, arrival_s, message.counter)
                if lost is not None:
                    self._lost(t_s, self._name, lost)
        self._blocks += self._stream.take()
        limit_s, silent_s = self._settings.silence_timeout_s, self._clock.monotonic_s() - self._received_s
        silent = self._listening and silent_s > limit_s
        return f"no sample in {limit_s:g} s; is it powered?" if silent else None

    def _identity(self, arrived: tuple[float, bytes]) -> codec.Identity | None:
        messages = (message for _, message in self._messages([arrived]))
        return next((message for message in messages if isinstance(message, codec.Identity)), None)

    def _messages(self, arrived: list[tuple[float, bytes]]) -> list[tuple[float, codec.Message]]:
        messages = []
        for arrival_s, data in arrived:
            for line in self._lines.feed(data):
                try:
                    messages.append((arrival_s, codec.decode(line)))
                except CodecError:
                    self._malformed += 1
        return messages
