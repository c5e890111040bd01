"""A Robotiq gripper: 2F-85, 2F-140 or Hand-E on a UR arm, through the socket of its URCap."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from drivers.core.errors import CommandError, check_streams
from drivers.core.links import SerialLink, open_serial
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Grip,
    Home,
    Listen,
    Release,
    SampleBlock,
    Stop,
    StreamInfo,
)
from drivers.core.numbering import Samples
from drivers.core.wire import OPENING_S, Inquiry, WireDriver
from drivers.gripper.outcome import GripperOutcome
from drivers.gripper.state import GripFinding, GripperState
from drivers.gripper.units import ROUNDING_M
from drivers.robotiq import codec
from drivers.robotiq.codec import MODELS, RobotiqOrder
from drivers.robotiq.settings import RobotiqSettings

CYCLE: Final = ("PRE", "OBJ", "POS", "FLT", "STA")
"""What makes a state, in this order: `PRE`, the position that it was sent to, shows whether `OBJ` is about that."""

FINDINGS: Final = {
    codec.OPENING_OBJECT: GripFinding.OBJECT_OPENING,
    codec.CLOSING_OBJECT: GripFinding.OBJECT_CLOSING,
    3: GripFinding.AT_POSITION,
}


class _Asked(NamedTuple):
    """What has no answer yet: the name that it bears, and when it was written."""

    name: str
    sent_s: float


class Robotiq(WireDriver[SerialLink]):
    """A gripper whose jaws open and close.

    `Home` activates it where that has not been done since power-up, or a fault is to be cleared: the jaws open and
    close fully, so they must be empty. `Grip` is one line, written before `apply` returns. `Stop` stops the motor where
    it is; the jaws cannot be pushed back, so what is held stays held. The URCap tells no force: `Gripped` has the one
    that was asked for. It has no watchdog: if the host dies, the jaws go where they were sent, with that force.

    Stream, irregular, one sample for each state, dated midway between question and answer: `<name>.width` in m.
    """

    _settings: RobotiqSettings
    _opens = staticmethod(open_serial)

    def _prepare(self) -> None:
        self._units = self._settings.units()
        self._info = StreamInfo(f"{self.name}.width", ("width",), "m", longest_s=codec.LONGEST_S)
        self._samples = Samples(self._info, np.float64)
        self._seq = 0
        self._forget()

    def _forget(self) -> None:
        self._outcome = GripperOutcome(self.name, self._units, self._settings.object_hold_s)
        self._subscribed = False
        self._buffer = b""
        self._asked: deque[_Asked] = deque()
        self._values: dict[str, int] = {}
        self._cycle_s = -math.inf  # when the state that is being asked for was begun
        self._order: RobotiqOrder | None = None  # the last one that drives the jaws
        self._going = False
        self._activating = ""  # "reset" until it is; then "active"

    def _identify(self, link: SerialLink) -> DeviceInfo:
        """A gripper that is found moving is stopped."""
        for name in (*CYCLE, "GTO"):
            self._values[name] = self._reading(link, name)
        values = self._values
        if values["STA"] == codec.ACTIVE and values["GTO"] and not values["OBJ"]:
            link.send(codec.encode_set(GTO=0))
            self._asked.append(_Asked(codec.ACK, self._clock.monotonic_s()))
        trouble = codec.TROUBLE.get(values["FLT"], "")
        self._outcome.faulty = bool(trouble)
        return DeviceInfo(
            self.name,
            model=f"Robotiq {self._settings.model}",
            streams={self._info.name: self._info},
            mover=True,
            details={
                "closed_width_m": self._units.closed_width_m,
                "open_width_m": self._units.open_width_m,
                "calibrated": values["STA"] == codec.ACTIVE,
                "faults": [trouble] if trouble else [],
                "least_speed_m_s": MODELS[self._settings.model].speed_m_s[0],
                "least_force_n": self._units.force_min_n,
                "watchdog": "none",
            },
        )

    def _reading(self, link: SerialLink, name: str) -> int:
        """Query it until it answers; raises a `DeviceError`."""

        def parse(received: tuple[float, bytes]) -> int | None:
            self._buffer += received[1]
            answer, self._buffer = codec.take_answer(self._buffer)
            return answer[1] if answer is not None and answer[0] == name else None

        inquiry = Inquiry(
            self.name,
            f"asking for {name} at {self._settings.port}",
            link,
            self._clock,
            max(self._settings.reply_timeout_s, OPENING_S),  # asked once: TCP loses nothing
            strange=lambda: f"it answers {self._buffer[:24]!r}" if self._buffer else "",
            stranger=f"is this the URCap's port, {codec.PORT}?",
            silent="is the gripper's URCap installed, and the gripper switched on at the pendant?",
        )
        return inquiry.ask(lambda: link.send(codec.encode_get(name)), parse)

    def _leave(self, link: SerialLink, failure: str | None) -> None:
        """Stop what moves, whatever has failed: what is held stays held."""
        link.send(self._line(Stop(self.name)))

    def _listens(self, streams: frozenset[str]) -> bool:
        check_streams(self.name, Listen(self.name, streams), streams, (self._info.name,))
        self._subscribed = bool(streams)
        return True

    def _valid(self, command: Command) -> Command:
        least_m_s = MODELS[self._settings.model].speed_m_s[0]
        if isinstance(command, Grip | Release) and 0.0 < command.speed_m_s < least_m_s - ROUNDING_M:
            reason = f"it cannot go as slowly as {command.speed_m_s:g} m/s"
            raise CommandError(self.name, f"applying {command}", reason, f"choose {least_m_s:g} m/s or more")
        return self._units.checked(
            self.name, command, self._settings.max_speed_m_s, self._settings.forces_n[1]
        )

    def read(self) -> Sequence[SampleBlock]:
        """Widths that have arrived since the last call."""
        self._turn()
        blocks = self._samples.take()
        return blocks if self._subscribed else ()

    def account(self) -> Mapping[str, object]:
        """States received, for the manifest."""
        return {"states": self._seq}

    # sending

    def _carry_out(self, command: Command) -> None:
        link = self._link
        assert link is not None
        if isinstance(command, Grip | Release) and (refusal := self._refusal()):
            self._refuse(command, refusal)
            return
        line = self._line(command)
        if line:
            self._write(link, codec.ACK, line)
        if link.fault is None:
            self._outcome.begin(command, self._clock.now(), drives=bool(line))
            self._sent(command)

    def _refusal(self) -> str:
        if self._outcome.faulty:
            return "it has a fault; send Home, which clears it"
        if self._values["STA"] != codec.ACTIVE or self._activating:
            return "it does not know its ends; send Home first, with empty jaws"
        return ""

    def _line(self, command: Command) -> bytes:
        """The line that carries out a command; nothing where the jaws are as it wants them."""
        if isinstance(command, Grip | Release):
            self._order, self._going = self._units.order(command), True
            return codec.encode_drive(self._order)
        if isinstance(command, Stop):
            if self._outcome.resting:
                return b""
            activating, self._activating, self._going = self._activating, "", False
            return codec.encode_set(ACT=0) if activating else codec.encode_set(GTO=0)
        assert isinstance(command, Home)
        if not (self._refusal() or self._activating):
            return b""
        self._order, self._going, self._activating = None, False, "reset"
        return codec.encode_set(ACT=0)

    def _write(self, link: SerialLink, name: str, line: bytes) -> None:
        sent_s = link.send(line)
        if sent_s is not None:
            self._asked.append(_Asked(name, sent_s))

    # receiving

    def _update(self, link: SerialLink) -> str | None:
        """Process what has arrived, ask what is due."""
        for arrival_s, data in link.receive():
            self._buffer += data
            while self._asked:
                answer, self._buffer = codec.take_answer(self._buffer)
                if answer is None:
                    break
                if answer[0] != self._asked[0].name:
                    return f"it answers {answer[0]} where {self._asked[0].name} was asked for"
                self._take(link, self._asked.popleft(), answer[1], arrival_s)
        now_s = self._clock.monotonic_s()
        if self._asked:
            if now_s - self._asked[0].sent_s > self._settings.reply_timeout_s:
                return f"no answer in {self._settings.reply_timeout_s:g} s; is the arm's controller up?"
        elif link.fault is None and now_s - self._cycle_s >= self._interval_s():
            self._cycle_s = now_s
            self._write(link, CYCLE[0], codec.encode_get(CYCLE[0]))
        return None

    def _interval_s(self) -> float:
        watched = self._subscribed or self._outcome.busy or self._going
        return self._settings.poll_interval_s if watched else self._settings.idle_interval_s

    def _take(self, link: SerialLink, asked: _Asked, value: int, arrival_s: float) -> None:
        if asked.name == codec.ACK:
            return
        self._values[asked.name] = value
        if asked.name == "POS" and self._subscribed:
            t_s = self._clock.from_monotonic(0.5 * (asked.sent_s + arrival_s))
            self._samples.push(
                self._seq, t_s, self._clock.from_monotonic(arrival_s), (self._units.width_m(value),)
            )
        following = CYCLE[CYCLE.index(asked.name) + 1 :][:1]
        for name in following:
            self._write(link, name, codec.encode_get(name))
        if not following:
            self._seq += 1
            self._conclude(link)

    def _conclude(self, link: SerialLink) -> None:
        """A state is complete."""
        values = self._values
        if self._activating == "reset" and values["STA"] == codec.RESET:
            self._activating = "active"
            self._write(link, codec.ACK, codec.encode_set(ACT=1))
        elif self._activating == "active" and values["STA"] == codec.ACTIVE:
            self._activating = ""
        trouble = "" if self._activating else codec.TROUBLE.get(values["FLT"], "")
        finding = FINDINGS.get(values["OBJ"], GripFinding.MOVING)
        if self._going and self._order is not None and values["PRE"] != self._order.position:
            finding = GripFinding.MOVING  # it has not taken the order yet
        held = finding in (GripFinding.OBJECT_CLOSING, GripFinding.OBJECT_OPENING) and self._order is not None
        state = GripperState(
            position=values["POS"],
            current_ma=self._order.force if held and self._order is not None else -1,
            finding=finding,
            activated=values["STA"] == codec.ACTIVE,
            going=self._going,
            over_temperature=False,
            watchdog=False,
            estop=False,
            calibrated=values["STA"] == codec.ACTIVE and not self._activating,
            trouble=trouble,
        )
        self._statuses += self._outcome.push(self._clock.from_monotonic(self._cycle_s), state, bool(trouble))
