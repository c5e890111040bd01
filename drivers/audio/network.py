"""A recorder on the network: sound and messages over one TCP connection."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.audio.codec import FrameDecoder, SoundMessage, encode_line
from drivers.audio.settings import AudioSettings
from drivers.audio.source import Drive, SoundSource, SourceEvent, SourceFound, Swept
from drivers.core.clock import Clock
from drivers.core.errors import CodecError, DeviceError, PortError, ProtocolError, SilentError
from drivers.core.links import SerialLink, SerialPort, open_serial
from drivers.core.messages import Chirp, Refused, Tone
from drivers.core.wire import OPENING_S, TURN_S

PORTS: Final = range(1, 1 << 16)


class Greeting(BaseModel):
    """What a recorder reports of itself; unknown keys of newer ones are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)

    recorder: str
    """Its model."""
    serial: str = ""
    """Its serial number."""
    version: str = ""
    """Its version."""
    rate_hz: float = Field(gt=0.0)
    """Frames a second."""
    channels: int = Field(ge=1)
    """How many."""
    bits: int = Field(ge=1)
    """Of a sample."""


class _Asked(NamedTuple):
    """A request without a reply yet: what it does, the drive that it carries out, when the reply is overdue."""

    do: str
    command: Drive | None
    due_s: float


class NetworkRecorder(SoundSource):
    """A client of a recorder; protocol: docs/reference/sensors.md.

    Args:
        address: `HOST:PORT`.
    """

    def __init__(self, device: str, settings: AudioSettings, clock: Clock, address: str) -> None:
        super().__init__(device, settings, clock, address)
        self._link: SerialLink | None = None
        self._decoder = FrameDecoder()
        self._tag = 0
        self._asked: dict[int, _Asked] = {}
        self._greeting: Greeting | None = None
        self._sounding = False
        self._events: list[SourceEvent] = []

    def open(self) -> SourceFound:
        """See `SoundSource.open`."""
        doing = f"connecting to {self._address}"
        patience_s = max(self._settings.reply_timeout_s, OPENING_S)
        host, _, port = self._address.rpartition(":")
        if not host or not port.isdecimal() or int(port) not in PORTS:
            raise PortError(
                self._device, doing, "it is no address", 'write port = "tcp:HOST:PORT", tcp:10.0.0.7:9640'
            )
        where = SerialPort(port=f"socket://{self._address}")
        self._link = open_serial(self._device, where, self._clock)
        greeting = self._greet(doing, patience_s)
        # An earlier host may have left it driving.
        self._ask({"do": "silence"})
        return SourceFound(
            what=f"the recorder at {self._address}",
            model=greeting.recorder,
            serial=greeting.serial,
            version=greeting.version,
            rate_hz=greeting.rate_hz,
            channels=greeting.channels,
            bits=greeting.bits,
            clock=f"{self._device} frames",
            details={"address": self._address},
        )

    def _greet(self, doing: str, patience_s: float) -> Greeting:
        """Its greeting.

        Raises:
            SilentError: it does not answer.
            ProtocolError: it is no recorder.
        """
        self._ask({"do": "hello"})
        until_s = self._clock.monotonic_s() + patience_s
        while self._clock.monotonic_s() < until_s and self.fault is None and self._greeting is None:
            self._clock.rest(TURN_S)
            self.receive()
        if self._greeting is not None:
            return self._greeting
        error: type[DeviceError] = SilentError if self.fault is None else ProtocolError
        waited = f"it does not answer in {patience_s:g} s"
        raise error(
            self._device,
            doing,
            self.fault or waited,
            "is a recorder there, and no other host connected to it?",
        )

    def listen(self, on: bool) -> None:
        """See `SoundSource.listen`; sound that is still under way from before is dropped."""
        self._sounding = False
        self._ask({"do": "start" if on else "stop"})

    def drive(self, command: Drive) -> None:
        """See `SoundSource.drive`."""
        match command:
            case Tone():
                request = {"do": "tone", "frequency_hz": command.frequency_hz, "level": command.level}
            case Chirp():
                span = {"from_hz": command.from_hz, "to_hz": command.to_hz}
                request = {"do": "chirp", **span, "duration_s": command.duration_s, "level": command.level}
            case _:
                request = {"do": "silence"}
        self._ask(request, command)

    def receive(self) -> Sequence[SourceEvent]:
        """See `SoundSource.receive`."""
        link = self._link
        if link is None or self.fault is not None:
            return self._take()
        try:
            for arrival_s, data in link.receive():
                for frame in self._decoder.feed(data):
                    if isinstance(frame, SoundMessage):
                        self._receive(frame, arrival_s)
                    elif self._sounding:
                        self._events.append(replace(frame, arrival_s=arrival_s))
        except CodecError as error:
            self.fault = f"it does not send as a recorder does: {error}"
        self.fault = self.fault or link.fault or self._overdue()
        return self._take()

    def close(self) -> None:
        """See `SoundSource.close`."""
        link, self._link = self._link, None
        if link is not None:
            link.send(encode_line({"do": "stop"}) + encode_line({"do": "silence"}))
            link.close()

    def _take(self) -> Sequence[SourceEvent]:
        events, self._events = self._events, []
        return events

    def _ask(self, request: Mapping[str, Any], command: Drive | None = None) -> None:
        if self._link is None or self.fault is not None:
            return
        self._tag += 1
        # `_greet` times the reply to a hello itself.
        timeout_s = math.inf if request["do"] == "hello" else self._settings.reply_timeout_s
        self._asked[self._tag] = _Asked(request["do"], command, self._clock.monotonic_s() + timeout_s)
        self._link.send(encode_line({**request, "tag": self._tag}))

    def _receive(self, message: SoundMessage, arrival_s: float) -> None:
        content = message.content
        if content.get("event") == "swept":
            self._events.append(Swept(message.frame, arrival_s))
        asked = self._asked.pop(content.get("reply", 0), None)
        if asked is None:
            return
        if "refused" in content:
            reason = f"the recorder will not: {content['refused']}"
            if asked.command is None:
                self.fault = f"{reason} ({asked.do})"
            else:
                t_s = self._clock.from_monotonic(arrival_s)
                self._events.append(Refused(t_s, self._device, asked.command, reason))
        elif asked.do == "hello":
            try:
                self._greeting = Greeting.model_validate(dict(content))
            except ValidationError as error:
                first = error.errors()[0]
                where = ".".join(map(str, first["loc"]))
                self.fault = f"its greeting is not a recorder's: {where}: {first['msg']}"
        elif asked.do in ("start", "stop"):
            # Of two on the way the later one holds: its reply is still to come.
            later = any(other.do in ("start", "stop") for other in self._asked.values())
            self._sounding = asked.do == "start" and not later

    def _overdue(self) -> str | None:
        now_s = self._clock.monotonic_s()
        for asked in self._asked.values():
            if now_s > asked.due_s:
                return f"no reply to {asked.do} in {self._settings.reply_timeout_s:g} s"
        return None
