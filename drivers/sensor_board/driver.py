"""The sensor board: sample streams in, excitation and tendon out, over a serial port."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field, model_validator

from drivers.core.errors import CodecError, PortError, ProtocolError
from drivers.core.links import SerialLink, SerialPort, open_serial
from drivers.core.messages import Command, DeviceInfo, Excite, Listen, SetTendon, StreamInfo, Tare
from drivers.core.settings import SILENCES
from drivers.core.wire import OPENING_S, TURN_S, Inquiry, WireDriver
from drivers.sensor_board.codec import (
    BoardCode,
    BoardHello,
    BoardKind,
    BoardReply,
    BoardSamples,
    CommandFrame,
    ReplyStatus,
    decode,
    encode,
)
from drivers.sensor_board.commands import BoardLimits
from drivers.sensor_board.dialogue import BoardDialogue, BoardOrder
from drivers.sensor_board.framing import BoardFrameDecoder
from drivers.sensor_board.streams import BoardStreams, stream_info

CLOSE_S = 0.25
"""Longest wait at close for the board to acknowledge that all is off (assumption: as long as a reply may take)."""

TURN_MAX_S = 0.05
"""A turn that comes later counts as this: a host that was away must not blame the board (assumption)."""

FEEDS = 4
"""Times that the watchdog is fed in its period: three may be lost or late (assumption)."""

FIRMWARE = "does the board's firmware fit this version of the program?"

REFUSALS: Mapping[int, str] = {
    ReplyStatus.UNKNOWN: "the board does not know this command",
    ReplyStatus.REFUSED: "the board refuses it",
    ReplyStatus.BUSY: "the board is busy",
}


class SensorBoardSettings(SerialPort, BoardLimits):
    """The sensor board."""

    baud: int = Field(default=921_600, ge=9_600, le=12_000_000)
    """Line speed in bits per second. Assumption: four times what two streams of 1 kHz in small blocks need."""
    reply_timeout_s: float = Field(default=0.25, gt=0.0, le=10.0)
    """How long a reply may take. Assumption: 15 times the longest arrival delay measured on a pty."""
    boot_s: float = Field(default=3.0, ge=0.0, le=60.0)
    """How long the board may take for its first answer: opening the port restarts many, and their boot loaders wait
    (an Arduino's about 2 s)."""
    watchdog_s: Annotated[float, SILENCES] = Field(default=1.0, ge=0.1, le=65.0)
    """The board switches excitation and streams off when the host is silent for this long (assumption)."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """A regular stream that sends nothing for this long has failed. Assumption: 50 blocks of 10 ms."""
    max_drift_ppm: float = Field(default=200.0, gt=0.0, le=10_000.0)
    """Bound on the drift between the board's clock and the host's. Assumption: two crystals of 100 ppm."""

    @model_validator(mode="after")
    def _watchdog_outlasts_a_lost_reply(self) -> SensorBoardSettings:
        if self.watchdog_s < 2.0 * self.reply_timeout_s:
            raise ValueError(
                "watchdog_s must be at least twice reply_timeout_s, or one lost reply ends the run"
            )
        return self


class SensorBoard(WireDriver[SerialLink]):
    """A board of sensor streams.

    The board reports its streams. Blocks carry raw counts with their scale; their times come from the board's clock
    through the lower envelope of arrivals (`clock_model`), never from an arrival. Loss is found by the board's own
    sample counter and reported as `Lost`; `Lost` of 0 samples is a board that restarted. A stream that `Listen`
    switches on again begins a new segment: its numbers jump, and nothing is reported as lost. The last blocks before a
    stream ends can be lost unnoticed, for no later counter shows it.

    A command without a reply is written once more; then the board has failed. The board's watchdog is fed
    from `read` and `poll`, not by a thread: a host that hangs or dies loses the excitation. If that happens during a
    run the device fails, rather than go on unexcited. A tendon position is rounded to the micrometre.
    """

    _settings: SensorBoardSettings
    _opens = staticmethod(open_serial)

    def _prepare(self) -> None:
        self._numbers: Mapping[str, int] = {}
        self._forget()

    def _forget(self) -> None:
        self._decoder = BoardFrameDecoder()
        self._infos: Mapping[int, StreamInfo] = {}
        self._malformed = 0
        self._excited = False
        self._arrived_s: dict[int, float] = {}
        """For each stream that is on: when its last frame arrived, in attended time."""
        self._fault: str | None = None
        self._attended_s = 0.0
        self._turned_s = self._fed_s = self._clock.monotonic_s()

    def account(self) -> Mapping[str, object]:
        """Frames on the line, good and bad, and the drift of the board's clock in ppm."""
        if not self._infos:
            return {}
        return {
            "good": self._decoder.good,
            "bad_crc": self._decoder.bad_crc,
            "bad_cobs": self._decoder.bad_cobs,
            "overlong": self._decoder.overlong,
            "malformed": self._malformed,
            **self._streams.clock.account(self.name),
        }

    # open and close; excitation and tendon stay as they are at the one, and are switched off at the other

    def _identify(self, link: SerialLink) -> DeviceInfo:
        s = self._settings
        hello = self._hello(link)
        self._infos = {
            stream.id: stream_info(
                f"{self.name}.{stream.name}", stream.channel_names, stream.unit, stream.scale, stream.rate_hz
            )
            for stream in hello.streams
        }
        self._numbers = {info.name: number for number, info in self._infos.items()}
        self._streams = BoardStreams(self._infos, self._clock, s.max_drift_ppm)
        self._dialogue = BoardDialogue(link, max(s.reply_timeout_s, OPENING_S / 2))
        self._set_up(link)
        self._dialogue.timeout_s = s.reply_timeout_s
        return DeviceInfo(
            self.name,
            model=hello.board,
            serial=hello.serial,
            version=hello.version,
            streams={info.name: info for info in self._infos.values()},
            clock=f"{self.name} microseconds",
            details={"port": s.port, "watchdog_s": s.watchdog_s},
        )

    def _hello(self, link: SerialLink) -> BoardHello:
        """Ask for the hello; raises a `DeviceError`."""
        doing = f"asking who is at {self._settings.port}"
        received_bytes = 0

        def parse(arrived: tuple[float, bytes]) -> BoardHello | None:
            nonlocal received_bytes
            received_bytes += len(arrived[1])
            for body in self._decoder.feed(arrived[1]):
                if body[:1] == bytes([BoardKind.HELLO]):
                    try:
                        hello = decode(body)
                    except CodecError as error:
                        raise ProtocolError(self.name, doing, str(error), FIRMWARE) from error
                    assert isinstance(hello, BoardHello)
                    return hello
            return None

        inquiry = Inquiry(
            self.name,
            doing,
            link,
            self._clock,
            self._settings.reply_timeout_s,
            strange=lambda: (
                f"{received_bytes} bytes came, but no hello of a sensor board" if received_bytes else ""
            ),
            stranger="is another device at this port, or the baud rate wrong?",
            silent="is it powered, and is this its port?",
        )
        # The leading delimiter closes any partial frame that the board has received.
        question = b"\0" + encode(CommandFrame(BoardCode.HELLO, 0))
        return inquiry.ask(lambda: link.send(question), parse, self._settings.boot_s)

    def _set_up(self, link: SerialLink) -> None:
        """Stop whatever an earlier host has left on, and set the watchdog."""
        self._dialogue.ask(self._attended_s, BoardCode.STOP)
        self._feed(self._clock.monotonic_s())
        fault = self._settled(link, math.inf)
        if fault is not None:
            error = ProtocolError if link.fault is None else PortError
            raise error(self.name, "setting it up", fault, FIRMWARE)
        # What has arrived so far belongs to an earlier session.
        self._blocks.clear()
        self._statuses.clear()

    def _settled(self, link: SerialLink, limit_s: float) -> str | None:
        """Wait for the replies to all orders, at most `limit_s`; returns a fault, or None."""
        until_s = self._clock.monotonic_s() + limit_s
        fault = link.fault
        while fault is None and not self._dialogue.idle and self._clock.monotonic_s() < until_s:
            self._clock.rest(TURN_S)
            fault = self._update(link) or link.fault
        return fault

    def _leave(self, link: SerialLink, failure: str | None) -> None:
        self._dialogue.ask(self._attended_s, BoardCode.EXCITE, 0)
        self._dialogue.ask(self._attended_s, BoardCode.STOP)
        if failure is None:
            self._settled(link, CLOSE_S)

    # sending

    def _valid(self, command: Command) -> Command:
        return self._settings.checked(self.name, self._numbers, command)

    def _carry_out(self, command: Command) -> None:
        code, argument = self._translated(command)
        if not (self._arrived_s or self._excited):  # with all off, the watchdog may have tripped
            self._fed_s = self._clock.monotonic_s()
        order = self._dialogue.ask(self._attended_s, code, argument, command)
        if order.sent_s is not None:
            self._sent(command, order.sent_s)
            return
        assert self._link is not None
        reason = self._link.fault or "the port is closed"
        self._fail(reason)
        self._refuse(command, reason)

    def _translated(self, command: Command) -> tuple[BoardCode, int | None]:
        match command:
            case Excite(on=on):
                return BoardCode.EXCITE, int(on)
            case SetTendon(position_m=position_m):
                return BoardCode.TENDON, round(position_m * 1e6)
            case Tare(stream=stream):
                return BoardCode.TARE, self._numbers[stream]
            case Listen(streams=streams) if streams:
                return BoardCode.START, sum(1 << self._numbers[stream] for stream in streams)
        return BoardCode.STOP, None

    def _feed(self, now_s: float) -> None:
        self._fed_s = now_s
        self._dialogue.ask(self._attended_s, BoardCode.WATCHDOG, round(self._settings.watchdog_s * 1e3))

    # receiving

    def _update(self, link: SerialLink) -> str | None:
        """Process what has arrived, repeat what is overdue, feed the watchdog, check for silence."""
        now_s = self._clock.monotonic_s()
        self._attended_s += min(now_s - self._turned_s, TURN_MAX_S)
        self._turned_s = now_s
        for arrival_s, data in link.receive():
            for body in self._decoder.feed(data):
                self._receive(body, arrival_s)
        fault = (
            self._fault
            or link.fault
            or self._starved(now_s)
            or self._dialogue.turn(self._attended_s)
            or self._silent()
        )
        # A feed that awaits its reply is not sent again here: the dialogue repeats it, and then fails.
        due = now_s - self._fed_s >= self._settings.watchdog_s / FEEDS
        if fault is None and due and not self._dialogue.awaits(BoardCode.WATCHDOG):
            self._feed(now_s)
        return fault

    def _receive(self, body: bytes, arrival_s: float) -> None:
        try:
            message = decode(body)
            if isinstance(message, BoardSamples):
                self._take(message, arrival_s)
            elif isinstance(message, BoardReply):
                self._settle(message)
        except CodecError:
            self._malformed += 1

    def _take(self, frame: BoardSamples, arrival_s: float) -> None:
        block, lost = self._streams.push(frame, arrival_s)
        if lost is not None:
            self._lost(self._clock.from_monotonic(arrival_s), block.stream, lost)
        self._blocks.append(block)
        if frame.stream in self._arrived_s:
            self._arrived_s[frame.stream] = self._attended_s

    def _settle(self, reply: BoardReply) -> None:
        order = self._dialogue.answered(reply)
        if order is None:
            return
        reason = REFUSALS.get(reply.status, f"the board replies {reply.status}")
        if reply.status == ReplyStatus.OK:
            self._follow(order)
        elif order.command is not None:
            self._refuse(order.command, reason)
        elif reply.status != ReplyStatus.BUSY:
            self._fault = f"{reason}: {order.code.name.lower()}"

    def _follow(self, order: BoardOrder) -> None:
        """The board has carried an order out. Its reply separates the frames before from those after."""
        if order.code is BoardCode.EXCITE:
            self._excited = bool(order.argument)
        elif order.code in (BoardCode.START, BoardCode.STOP):
            mask = order.argument or 0
            on = [number for number in self._infos if mask >> number & 1]
            self._streams.begin(number for number in on if number not in self._arrived_s)
            self._arrived_s = {number: self._arrived_s.get(number, self._attended_s) for number in on}

    # faults

    def _starved(self, now_s: float) -> str | None:
        if now_s - self._fed_s <= self._settings.watchdog_s or not (self._arrived_s or self._excited):
            return None
        return f"the host was away for {now_s - self._fed_s:.2f} s, so the board's watchdog switched it off"

    def _silent(self) -> str | None:
        limit_s = self._settings.silence_timeout_s
        for number, arrived_s in self._arrived_s.items():
            if self._infos[number].rate_hz is not None and self._attended_s - arrived_s > limit_s:
                return f"nothing of {self._infos[number].name} in {limit_s:g} s; is the board powered?"
        return None


__all__ = ["SensorBoard", "SensorBoardSettings"]
