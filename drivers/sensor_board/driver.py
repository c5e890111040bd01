"""The sensor board: sample streams in, excitation and tendon out, over a serial port."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from drivers.clock import Clock
from drivers.errors import PortError, ProtocolError
from drivers.links import SerialLink, open_serial
from drivers.messages import (
    Applied,
    Command,
    DeviceInfo,
    Excite,
    Listen,
    SampleBlock,
    SetTendon,
    Status,
    Tare,
)
from drivers.sensor_board.codec import Code
from drivers.sensor_board.commands import mine, tendon_um, wrong
from drivers.sensor_board.dialogue import TURN_S, identify
from drivers.sensor_board.framing import FrameDecoder
from drivers.sensor_board.session import SensorBoardSettings, Session
from drivers.sensor_board.streams import stream_info

CLOSE_S = 0.25
"""Longest wait at close for the board to say that all is off (assumption: as long as a reply may take)."""


class SensorBoard:
    """A board of sensor streams; implements `drivers.protocols.Device`.

    What it can send it says itself. Blocks carry raw counts with their scale; their times come from the
    board's clock through the lower envelope of arrivals (`clock_model`), never from an arrival. Loss is
    counted by the board's own sample counter and told as `Lost`; `Lost` of 0 samples is a board that began
    anew. A stream that `Listen` switches on again begins a new segment: its numbers jump, and nothing is
    told as lost. The last blocks before a stream ends can be lost unseen: no later counter tells of them.

    A command without a reply is written once more; then the board has failed. The board's watchdog is fed
    from `read` and `poll`, by no thread: a host that hangs or dies loses the excitation. Where that has
    happened under way the device fails, rather than go on unexcited.

    Args:
        name: Name in the profile.
        settings: Of the board.
        clock: Gives bench time.
    """

    def __init__(self, name: str, settings: SensorBoardSettings, clock: Clock) -> None:
        self.name = name
        self._settings = settings
        self._clock = clock
        self._link: SerialLink | None = None
        self._session: Session | None = None
        self._numbers: Mapping[str, int] = {}

    def open(self) -> DeviceInfo:
        """Connect, ask who it is, stop its streams, set its watchdog; excitation and tendon stay as they are.

        Raises:
            PortError: the port is absent, busy or was taken away.
            SilentError: nothing answers.
            ProtocolError: what answers is no sensor board.
        """
        s = self._settings
        self.close()
        self._link = open_serial(self.name, s.port, s.baud, self._clock)
        try:
            decoder = FrameDecoder()
            hello = identify(self.name, s.port, self._link, decoder, self._clock, s.reply_timeout_s)
            infos = {
                stream.id: stream_info(
                    f"{self.name}.{stream.name}",
                    stream.channel_names,
                    stream.unit,
                    stream.scale,
                    stream.rate_hz,
                )
                for stream in hello.streams
            }
            self._numbers = {info.name: number for number, info in infos.items()}
            session = Session(self.name, s, self._clock, self._link, decoder, infos)
            self._session = self._begun(session, self._link)
        except BaseException:
            self.close()
            raise
        return DeviceInfo(
            self.name,
            model=hello.board,
            serial=hello.serial,
            version=hello.version,
            streams={info.name: info for info in infos.values()},
            clock=f"{self.name} microseconds",
            details={"port": s.port, "watchdog_s": s.watchdog_s},
        )

    def close(self) -> None:
        """Switch excitation and streams off, let go of the port. Never raises; may be called twice."""
        link, self._link = self._link, None
        session, self._session = self._session, None
        if link is None:
            return
        try:
            if session is not None:
                session.leave()
                self._wait(session, CLOSE_S)
        finally:
            link.close()

    def apply(self, command: Command) -> Applied:
        """Queue a command; it is written when this returns. A tendon position is rounded to the micrometre.

        Raises:
            CommandError: not for a sensor board, not finite or out of range. Nothing was sent.
            PortError: the board is not open.
        """
        code, argument, command = self._translated(command)
        if self._session is None:
            raise PortError(self.name, f"applying {command}", "it is not open", "open it first")
        self._session.order(code, argument, command)
        return Applied(command, self._clock.now())

    def read(self) -> Sequence[SampleBlock]:
        """Blocks that have arrived since the last call, in order for each stream."""
        if self._session is None:
            return ()
        self._session.turn()
        return self._session.take_blocks()

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""
        if self._session is None:
            return ()
        self._session.turn()
        return self._session.take_statuses()

    def account(self) -> Mapping[str, object]:
        """What came of the frames on the line, and the drift of the board's clock, for the manifest."""
        return {} if self._session is None else self._session.account()

    def _translated(self, command: Command) -> tuple[Code, int | None, Command]:
        """Code and argument of a command, and the command as the board will see it."""
        mine(self.name, command)
        match command:
            case Excite():
                return Code.EXCITE, int(command.on), command
            case SetTendon():
                um = tendon_um(self.name, self._settings, command)
                return Code.TENDON, um, replace(command, position_m=um * 1e-6)
            case Tare():
                return Code.TARE, self._number(command, command.stream), command
            case Listen(streams=streams) if not streams:
                return Code.STOP, None, command
            case Listen():
                mask = sum(1 << self._number(command, stream) for stream in command.streams)
                return Code.START, mask, command
            case _:
                advice = "a sensor board can Excite, SetTendon, Tare and Listen"
                raise wrong(self.name, command, "it has no such command", advice)

    def _number(self, command: Command, stream: str) -> int:
        if stream not in self._numbers:
            known = ", ".join(sorted(self._numbers)) or "none before it is open"
            raise wrong(self.name, command, f"it has no stream {stream}", f"it has: {known}")
        return self._numbers[stream]

    def _begun(self, session: Session, link: SerialLink) -> Session:
        """The session, once the board has stopped its streams and taken its watchdog."""
        session.begin()
        self._wait(session, math.inf)
        if session.failure is not None:
            error = ProtocolError if link.fault is None else PortError
            advice = "does the board's firmware fit this version of the program?"
            raise error(self.name, "setting it up", session.failure, advice)
        session.forget()
        return session

    def _wait(self, session: Session, limit_s: float) -> None:
        """Let every order have its reply, at most for `limit_s`."""
        until_s = self._clock.now() + limit_s
        while not session.idle and session.failure is None and self._clock.now() < until_s:
            self._clock.rest(TURN_S)
            session.turn()


__all__ = ["SensorBoard", "SensorBoardSettings"]
