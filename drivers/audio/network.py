"""A recorder on the network: sound and messages over one TCP connection."""

import math
import socket
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.audio.codec import FrameDecoder, SoundMessage, encode_line
from drivers.audio.settings import AudioSettings
from drivers.audio.source import Drive, SourceEvent, SourceFound, Swept
from drivers.core.clock import Clock
from drivers.core.errors import CodecError, DeviceError, PortError, ProtocolError, SilentError
from drivers.core.links import drained
from drivers.core.messages import Chirp, Refused, Tone
from drivers.core.wire import OPENING_S

CHUNK_BYTES: Final = 1 << 16

WAITING_BYTES: Final = 8 << 20
"""Of sound that was not taken (14 s): beyond, the network holds the rest back, and the recorder's counter shows
what it had to drop (assumption)."""

PAUSE_S: Final = 0.002
"""Between two looks at what has come while opening, and at a queue that is full (assumption)."""

CLOSE_S: Final = 0.5
"""Longest wait at close: for the recorder to hang up, for the thread (assumption)."""

HUNG_UP: Final = "the recorder has hung up"

ADVICE: Final = "is it switched on, and the address right?"


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


class NetworkRecorder:
    """A client of a recorder; protocol: docs/reference/sensors.md.

    Args:
        address: `HOST:PORT`.
    """

    def __init__(self, device: str, settings: AudioSettings, clock: Clock, address: str) -> None:
        self._device = device
        self._settings = settings
        self._clock = clock
        self._address = address
        self._link: _Link | None = None
        self._decoder = FrameDecoder()
        self._tag = 0
        self._asked: dict[int, _Asked] = {}
        self._greeting: Greeting | None = None
        self._sounding = False
        self._events: list[SourceEvent] = []
        self.fault: str | None = None

    def open(self) -> SourceFound:
        """See `Source.open`."""
        doing = f"connecting to {self._address}"
        patience_s = max(self._settings.reply_timeout_s, OPENING_S)
        host, _, port = self._address.rpartition(":")
        if not host or not port.isdecimal():
            raise PortError(
                self._device, doing, "it is no address", 'write port = "tcp:HOST:PORT", tcp:10.0.0.7:9640'
            )
        try:
            connection = socket.create_connection((host, int(port)), patience_s)
        except (OSError, OverflowError) as error:
            reason = f"it does not answer ({getattr(error, 'strerror', None) or error})"
            raise PortError(self._device, doing, reason, ADVICE) from error
        self._link = _Link(self._device, connection, self._clock)
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
            self._clock.rest(PAUSE_S)
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

    def peek(self, seconds: float) -> NDArray[np.int32] | None:
        """See `Source.peek`: it has to be waited for."""
        return None

    def listen(self, on: bool) -> None:
        """See `Source.listen`; sound that is still under way from before is dropped."""
        self._sounding = False
        self._ask({"do": "start" if on else "stop"})

    def drive(self, command: Drive) -> None:
        """See `Source.drive`."""
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
        """See `Source.receive`."""
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

    def account(self) -> Mapping[str, object]:
        """See `Source.account`."""
        return {}

    def close(self) -> None:
        """See `Source.close`."""
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


class _Link:
    """A connection with its reader thread, which fills a queue and does nothing else.

    Attributes:
        fault: Why the link is gone, or None while it stands.
    """

    def __init__(self, device: str, connection: socket.socket, clock: Clock) -> None:
        self.fault: str | None = None
        self._connection = connection
        self._clock = clock
        self._arrived: deque[tuple[float, bytes]] = deque()
        self._taken_bytes = 0
        self._closing = False
        connection.settimeout(None)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reader = threading.Thread(target=self._fill, name=f"{device}-reader", daemon=True)
        self._reader.start()

    def send(self, data: bytes) -> None:
        """Hand bytes to the kernel, without waiting."""
        if self.fault is not None:
            return
        try:
            if self._connection.send(data, socket.MSG_DONTWAIT) < len(data):
                self.fault = self.fault or "the network takes no more bytes"
        except OSError as error:
            self.fault = self.fault or _gone(error)

    def receive(self) -> list[tuple[float, bytes]]:
        """What has arrived since the last call: (monotonic arrival in seconds, bytes), in order."""
        chunks = drained(self._arrived)
        self._taken_bytes += sum(len(data) for _, data in chunks)
        return chunks

    def close(self) -> None:
        """Hang up and wait for the thread. Never raises."""
        self._closing = True
        with suppress(OSError):
            # What was sent last still goes out; the end of file wakes the recorder, and its own the thread.
            self._connection.shutdown(socket.SHUT_WR)
        self._reader.join(CLOSE_S)
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RD)
        self._reader.join(CLOSE_S)
        self._connection.close()

    def _fill(self) -> None:
        came_bytes = 0
        try:
            while True:
                while came_bytes - self._taken_bytes > WAITING_BYTES and not self._closing:
                    self._clock.rest(PAUSE_S)
                data = self._connection.recv(CHUNK_BYTES)
                if not data:
                    break
                if not self._closing:
                    self._arrived.append((self._clock.monotonic_s(), data))
                    came_bytes += len(data)
            reason = HUNG_UP
        except OSError as error:
            reason = _gone(error)
        if not self._closing:
            self.fault = self.fault or reason


def _gone(error: OSError) -> str:
    """Why the connection ended; a recorder that closes before it has read all resets it."""
    if isinstance(error, ConnectionResetError | BrokenPipeError):
        return HUNG_UP
    return f"the connection is gone ({error.strerror or error})"
