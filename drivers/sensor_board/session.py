"""A board that has said hello: frames in, orders out, the watchdog fed, silence noticed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from pydantic import Field, model_validator

from drivers.clock import Clock
from drivers.links import SerialLink
from drivers.messages import (
    Command,
    Failed,
    Lost,
    Refused,
    SampleBlock,
    Sent,
    Status,
    StreamInfo,
)
from drivers.sensor_board.codec import Code, CodecError, Reply, ReplyStatus, Samples, Times, decode
from drivers.sensor_board.commands import BoardLimits
from drivers.sensor_board.dialogue import Dialogue, Order
from drivers.sensor_board.framing import FrameDecoder
from drivers.sensor_board.streams import BoardStreams

TURN_MAX_S = 0.05
"""A turn that comes later counts as this: a host that was away must not blame the board (assumption)."""

FEEDS = 4
"""Times that the watchdog is fed in its period: three may be lost or late (assumption)."""

REFUSALS = {
    ReplyStatus.UNKNOWN: "the board does not know this command",
    ReplyStatus.REFUSED: "the board refuses it",
    ReplyStatus.BUSY: "the board is busy",
}


class SensorBoardSettings(BoardLimits):
    """The sensor board."""

    port: str
    """Path of the serial port."""
    baud: int = Field(default=921_600, ge=9_600, le=12_000_000)
    """Line speed in bits per second. Assumption: four times what two streams of 1 kHz in small blocks need."""
    reply_timeout_s: float = Field(default=0.25, gt=0.0, le=10.0)
    """How long a reply may take. Assumption: 15 times the longest arrival delay measured on a pty."""
    watchdog_s: float = Field(default=1.0, ge=0.1, le=65.0)
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


class Session:
    """One open board.

    Args:
        name: Name in the profile.
        settings: Of the board.
        clock: Gives bench time.
        link: The open port.
        decoder: In step with the line.
        infos: The board's streams by their id.

    Attributes:
        failure: Why the board can no longer be trusted, or None.
    """

    def __init__(
        self,
        name: str,
        settings: SensorBoardSettings,
        clock: Clock,
        link: SerialLink,
        decoder: FrameDecoder,
        infos: Mapping[int, StreamInfo],
    ) -> None:
        self.failure: str | None = None
        self._name = name
        self._settings = settings
        self._clock = clock
        self._link = link
        self._decoder = decoder
        self._infos = infos
        self._dialogue = Dialogue(link, settings.reply_timeout_s)
        self._streams = BoardStreams(infos, clock, settings.max_drift_ppm)
        self._malformed = 0
        self._blocks: list[SampleBlock] = []
        self._statuses: list[Status] = []
        self._excited = False
        self._heard_s: dict[int, float] = {}
        """For each stream that is on: when it was last heard, by the watch."""
        self._watch_s = 0.0
        self._turned_s = self._fed_s = self._clock.monotonic_s()

    @property
    def idle(self) -> bool:
        """Whether every order has its reply."""
        return self._dialogue.idle

    def begin(self) -> None:
        """Stop whatever an earlier host has left on, and set the watchdog."""
        self.order(Code.STOP)
        self._feed(self._turned_s)

    def forget(self) -> None:
        """What came so far was for somebody else."""
        self._blocks.clear()
        self._statuses.clear()

    def leave(self) -> None:
        """Say that excitation and streams shall be off, whatever has failed before."""
        self._dialogue.ask(self._watch_s, Code.EXCITE, 0)
        self._dialogue.ask(self._watch_s, Code.STOP)

    def order(self, code: Code, argument: int | None = None, command: Command | None = None) -> None:
        """Write an order; a command's `Sent` or `Refused` follows."""
        if self.failure is None:
            if not (self._heard_s or self._excited):  # what is off could starve for as long as it liked
                self._fed_s = self._clock.monotonic_s()
            order = self._dialogue.ask(self._watch_s, code, argument, command)
            if order.sent_s is None:
                self._fail(self._link.fault or "the port is closed")
            elif command is not None:
                self._statuses.append(Sent(self._clock.from_monotonic(order.sent_s), self._name, command))
        if self.failure is not None and command is not None:
            self._refuse(command, self.failure)

    def turn(self) -> None:
        """Hear what has come, repeat what is overdue, feed the watchdog, notice what is silent."""
        now_s = self._clock.monotonic_s()
        self._watch_s += min(now_s - self._turned_s, TURN_MAX_S)
        self._turned_s = now_s
        arrived = self._link.receive()
        if self.failure is not None:
            return
        for arrival_s, data in arrived:
            for body in self._decoder.feed(data):
                self._hear(body, arrival_s)
        fault = (
            self._link.fault or self._starved(now_s) or self._dialogue.turn(self._watch_s) or self._silent()
        )
        if fault is not None:
            self._fail(fault)
        # A feed that waits for its reply is not replaced: it is repeated, and fails by itself.
        elif self._due(now_s) and not self._dialogue.awaits(Code.WATCHDOG):
            self._feed(now_s)

    def take_blocks(self) -> list[SampleBlock]:
        """Blocks since the last call."""
        taken, self._blocks = self._blocks, []
        return taken

    def take_statuses(self) -> list[Status]:
        """Statuses since the last call."""
        taken, self._statuses = self._statuses, []
        return taken

    def account(self) -> Mapping[str, object]:
        """Frames on the line by what came of them, and the drift of the board's clock in ppm."""
        drift_ppm = self._streams.clock.model.drift_ppm
        return {**asdict(self._decoder.counts), "malformed": self._malformed, "drift_ppm": drift_ppm}

    # what is heard

    def _hear(self, body: bytes, arrival_s: float) -> None:
        try:
            message = decode(body)
            if isinstance(message, Samples | Times):
                self._take(message, arrival_s)
            elif isinstance(message, Reply):
                self._settle(message)
        except CodecError:
            self._malformed += 1

    def _take(self, frame: Samples | Times, arrival_s: float) -> None:
        arrival = self._streams.push(frame, arrival_s)
        block = arrival.block
        if arrival.lost is not None:
            t_s = self._clock.from_monotonic(arrival_s)
            self._statuses.append(Lost(t_s, self._name, block.stream, arrival.lost))
        self._blocks.append(block)
        if frame.stream in self._heard_s:
            self._heard_s[frame.stream] = self._watch_s

    def _settle(self, reply: Reply) -> None:
        order = self._dialogue.answered(reply)
        if order is None:
            return
        if reply.status == ReplyStatus.OK:
            self._follow(order)
        elif order.command is not None:
            self._refuse(order.command, _refusal(reply.status))
        elif reply.status != ReplyStatus.BUSY:
            self._fail(f"{_refusal(reply.status)}: {order.code.name.lower()}")

    def _follow(self, order: Order) -> None:
        """The board has done it. Its reply stands on the line between the frames before and after."""
        if order.code is Code.EXCITE:
            self._excited = bool(order.argument)
        elif order.code in (Code.START, Code.STOP):
            mask = order.argument or 0
            on = [number for number in self._infos if mask >> number & 1]
            self._streams.begin(number for number in on if number not in self._heard_s)
            self._heard_s = {number: self._heard_s.get(number, self._watch_s) for number in on}

    # what is wrong

    def _starved(self, now_s: float) -> str | None:
        if now_s - self._fed_s <= self._settings.watchdog_s or not (self._heard_s or self._excited):
            return None
        return f"the host was away for {now_s - self._fed_s:.2f} s, so the board's watchdog switched it off"

    def _silent(self) -> str | None:
        limit_s = self._settings.silence_timeout_s
        for number, heard_s in self._heard_s.items():
            if self._infos[number].rate_hz is not None and self._watch_s - heard_s > limit_s:
                return f"nothing of {self._infos[number].name} in {limit_s:g} s; is the board powered?"
        return None

    def _due(self, now_s: float) -> bool:
        return now_s - self._fed_s >= self._settings.watchdog_s / FEEDS

    def _feed(self, now_s: float) -> None:
        self._fed_s = now_s
        self.order(Code.WATCHDOG, round(self._settings.watchdog_s * 1e3))

    def _fail(self, reason: str) -> None:
        if self.failure is None:
            self.failure = reason
            self._statuses.append(Failed(self._clock.now(), self._name, reason))

    def _refuse(self, command: Command, reason: str) -> None:
        self._statuses.append(Refused(self._clock.now(), self._name, command, reason))


def _refusal(status: int) -> str:
    return next((words for known, words in REFUSALS.items() if known == status), f"the board says {status}")
