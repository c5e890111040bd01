"""The gripper: SSG-48 on a CAN bus."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self, TypeVar

import numpy as np
from pydantic import Field, model_validator

from drivers.can_gripper import units
from drivers.can_gripper.codec import (
    POLL,
    Answer,
    DriveOrder,
    GripperCode,
    GripperErrors,
    GripperMessage,
    Order,
    decode_answer,
    encode_order,
)
from drivers.core.can_link import CanLink, CanPort, ReceivedFrame, open_can, strange_frames
from drivers.core.errors import CodecError
from drivers.core.messages import Command, DeviceInfo, Grip, Release, SampleBlock, Stop, StreamInfo
from drivers.core.numbering import Samples
from drivers.core.wire import Inquiry, WireDriver
from drivers.gripper.outcome import GripperOutcome
from drivers.gripper.state import GripFinding, GripperState

IDLE = DriveOrder(0, 0, 0, activate=False, go=False)


UNSEEN_POLLS = 5
"""After so many intervals without a state the jaws are taken to have gone on as ordered (assumption)."""

T = TypeVar("T", bound=Answer)


class CanGripperSettings(CanPort, units.CanGripperLimits):
    """A gripper on a CAN bus; widths are the opening between its fingers."""

    node: int = Field(default=0, ge=0, le=15)
    """Node number on the bus (docs/reference/grippers.md: 0 by default)."""
    closed_width_m: float = Field(default=units.CLOSED_MIN_M, ge=units.CLOSED_MIN_M, le=units.CLOSED_MAX_M)
    """Opening of the closed jaws: set by the brackets that the fingers stand on, 48 mm less than the open ones."""
    force_n_per_ma: float = Field(default=units.FORCE_N_PER_MA, gt=0.0, le=1.0)
    """Force of the jaws in N for each mA of motor current."""
    watchdog_s: float = Field(default=1.0, ge=0.2, le=60.0)
    """The gripper opens its grip when the host is silent for this long (assumption: twice the tolerated silence)."""
    poll_interval_s: float = Field(default=0.01, ge=0.002, le=0.1)
    """Time between two questions while it moves, holds or is subscribed (data sheet: 50 Hz or faster)."""
    idle_interval_s: float = Field(default=0.1, ge=0.002, le=5.0)
    """The same otherwise: it feeds the watchdog (assumption)."""
    reply_timeout_s: float = Field(default=0.05, gt=0.0, le=5.0)
    """When an answer counts as lost. Assumption: three times the longest delay measured on a pty."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=30.0)
    """Silence after which the gripper has failed (assumption: ten lost answers)."""

    @model_validator(mode="after")
    def _fed_in_time(self) -> Self:
        slowest_s = max(self.idle_interval_s, self.poll_interval_s) + self.reply_timeout_s
        if self.watchdog_s < 2.0 * slowest_s:
            raise ValueError(
                f"watchdog_s = {self.watchdog_s:g} is less than twice idle_interval_s + reply_timeout_s"
                f" = {slowest_s:g}: one lost answer would open the grip"
            )
        return self


class CanGripper(WireDriver[CanLink]):
    """A gripper whose jaws open and close.

    `Home` clears faults and calibrates where that has not been done since power-up: the jaws open and close
    fully, so they must be empty. `Grip` is one frame, written before `apply` returns: a grip that tightens
    costs no more. Force is set by the motor's current and never measured: the reported force is the measured
    current times the maker's constant. `Stop` holds the jaws where they are, with what they hold. Any fault
    opens the grip and is reported as `Stalled`.

    The gripper's own watchdog is set at `open` and fed by `read` and `poll`, not by a thread: it opens the
    grip when the host hangs or dies. `close` switches it off, so that what is held at the end of a program stays held.

    Streams, irregular, one sample for each answered poll, dated midway between poll and answer; a lost
    answer is a jump in the sequence: `<name>.width` in m, `<name>.force` in N, positive where the jaws press
    inwards.
    """

    _settings: CanGripperSettings
    _opens = staticmethod(open_can)

    def _prepare(self) -> None:
        s = self._settings
        self._units = units.GripperUnits(s.closed_width_m, s.force_n_per_ma)
        self._infos = (
            StreamInfo(f"{self.name}.width", ("width",), "m", longest_s=units.LONGEST_S),
            StreamInfo(
                f"{self.name}.force",
                ("force",),
                "N",
                s.force_n_per_ma,
                longest_s=units.LONGEST_S,
                tared=False,
            ),
        )
        self._samples = [Samples(info, np.float64) for info in self._infos]
        self._seq = 0
        self._unanswered = 0
        self._forget()

    def _forget(self) -> None:
        self._outcome = GripperOutcome(self.name, self._units, self._settings.object_hold_s)
        self._subscribed: frozenset[str] = frozenset()
        self._state: GripperState | None = None
        self._state_s = -math.inf  # monotonic; when it was asked for
        self._order = IDLE  # the last one that drives the jaws
        self._ordered_s = -math.inf  # monotonic; but for stops
        self._asked: deque[float] = deque()  # monotonic times of polls without an answer
        self._asked_s = -math.inf
        self._late: deque[float] = deque()  # those whose answer may still come, or was lost
        self._given_up_s = -math.inf
        self._missing = 0  # polls in a row without an answer
        self._faults: list[str] = []

    def _identify(self, link: CanLink) -> DeviceInfo:
        """A gripper that is found moving is stopped."""

        def reading(code: GripperCode) -> tuple[int, ...]:
            return self._ask(link, GripperMessage(code), GripperMessage).numbers

        hardware, _, software, serial = reading(GripperCode.INFO)
        errors = self._ask(link, GripperMessage(GripperCode.ERRORS), GripperErrors).active
        (temperature_c,), (supply_mv,) = reading(GripperCode.TEMPERATURE), reading(GripperCode.VOLTAGE)
        state = self._state = self._ask(link, POLL, GripperState)
        self._write(link, _watchdog(self._settings.watchdog_s))
        if state.calibrated and state.going and state.finding is GripFinding.MOVING:
            steady_ma = self._units.current_ma(self._settings.release_force_n)
            self._write(link, DriveOrder(state.position, 0, steady_ma))
        self._outcome.faulty = bool(errors)
        return DeviceInfo(
            self.name,
            model=f"SSG-48, hardware {hardware}",
            serial=str(serial),
            version=str(software),
            streams={info.name: info for info in self._infos},
            mover=True,
            details={
                "closed_width_m": self._units.closed_width_m,
                "open_width_m": self._units.open_width_m,
                "watchdog_s": self._settings.watchdog_s,
                "calibrated": state.calibrated,
                "faults": sorted(errors),
                "temperature_c": float(temperature_c),
                "supply_v": supply_mv * 1e-3,
            },
        )

    def _leave(self, link: CanLink, failure: str | None) -> None:
        """Stop what moves, whatever has failed, and switch the watchdog off: what is held stays held. The watchdog of a
        gripper that has failed stays on: it lets go of what nobody sees any more."""
        if not self._outcome.resting:
            self._write(link, *self._stopping())
        if failure is None:
            self._write(link, _watchdog(0.0))

    def _ask(self, link: CanLink, order: GripperMessage, kind: type[T]) -> T:
        """Query it until it answers; raises a `DeviceError`."""
        strangers = 0

        def parse(received: ReceivedFrame) -> T | None:
            nonlocal strangers
            answer, _ = self._answer(received)
            strangers += answer is None
            # Readings carry the code that was queried.
            fits = not isinstance(answer, GripperMessage) or answer.code is order.code
            return answer if isinstance(answer, kind) and fits else None

        where = f"node {self._settings.node}, and the bus at {self._settings.bitrate} bit/s?"
        inquiry = Inquiry(
            self.name,
            f"asking who is at {self._settings.port}",
            link,
            self._clock,
            self._settings.reply_timeout_s,
            strange=lambda: strange_frames(strangers, link),
            stranger=f"is the gripper {where}",
            silent=f"is it powered with 24 V, {where}",
        )
        question = encode_order(self._settings.node, order)
        return inquiry.ask(lambda: link.send(question), parse)

    def _answer(self, received: ReceivedFrame) -> tuple[Answer | None, bool]:
        """An answer of this node, None where the frame is something else, and whether it has a fault."""
        try:
            sender, fault, answer = decode_answer(received.frame)
        except CodecError:
            return None, False
        return (answer, fault) if sender == self._settings.node else (None, False)

    def _listens(self, streams: frozenset[str]) -> bool:
        self._subscribed = streams & {info.name for info in self._infos}
        return True

    def _valid(self, command: Command) -> Command:
        return self._units.checked(
            self.name, command, self._settings.max_speed_m_s, self._settings.max_force_n
        )

    def _carry_out(self, command: Command) -> None:
        assert self._link is not None
        refusal = self._refusal(command)
        if refusal is not None:
            self._refuse(command, refusal)
            return
        self._order_now(self._link, command)
        if self._link.fault is None:
            self._sent(command)

    def _order_now(self, link: CanLink, command: Command) -> None:
        orders = self._orders(command)
        self._write(link, *orders)
        if not isinstance(command, Stop):
            self._ordered_s = self._clock.monotonic_s()
        self._outcome.begin(command, self._clock.now(), drives=any(map(_drives, orders)))

    def read(self) -> Sequence[SampleBlock]:
        """Widths and forces that have arrived since the last call."""
        self._turn()
        blocks = [block for samples in reversed(self._samples) for block in samples.take()]
        return [block for block in blocks if block.stream in self._subscribed]

    def account(self) -> Mapping[str, object]:
        """States received and lost, malformed frames and faults, for the manifest."""
        malformed = 0 if self._link is None else self._link.malformed
        answered = self._seq - self._unanswered
        return {"states": answered, "lost": self._unanswered, "malformed": malformed, "faults": self._faults}

    # sending

    def _refusal(self, command: Command) -> str | None:
        """Why a command cannot be carried out now."""
        if isinstance(command, Grip | Release):
            if self._outcome.faulty:
                return "it has a fault; send Home, which clears it"
            if self._state is None or not self._state.calibrated:
                return "it does not know its ends; send Home first, with empty jaws"
        return None

    def _orders(self, command: Command) -> Sequence[Order]:
        """The orders that carry out a command."""
        match command:
            case Grip():
                self._order = self._units.grip(command)
                return (self._order,)
            case Release():
                self._order = self._units.release(command, self._settings.release_force_n)
                return (self._order,)
            case Stop():
                if not self._outcome.resting:
                    return self._stopping()
                return (POLL,) if self._failure is None else ()  # a poll would feed the watchdog
        known = self._state is not None and self._state.calibrated
        if known and not self._outcome.faulty:
            return (POLL,)
        # An emergency stop stays up until an order without it has come, and only then can be cleared.
        self._order = IDLE
        clearing = (IDLE, GripperMessage(GripperCode.CLEAR_ERROR))
        # What lost its ends lost its watchdog's setting with them.
        watchdog = _watchdog(self._settings.watchdog_s)
        return clearing if known else (*clearing, watchdog, GripperMessage(GripperCode.CALIBRATE))

    def _stopping(self) -> Sequence[Order]:
        """The order that stops a motion: hold the position, or sleep where it is not known.

        Where a program was away, the latest position is an old one: held, it would send the jaws back.
        """
        if self._state is None or not self._state.calibrated:
            return (GripperMessage(GripperCode.IDLE),)
        position, unseen_s = (
            self._state.position,
            self._clock.monotonic_s() - max(self._state_s, self._ordered_s),
        )
        if self._order.go and unseen_s > UNSEEN_POLLS * self._settings.poll_interval_s:
            position = self._units.ahead(position, self._order, unseen_s)
        self._order = replace(self._order, position=position)
        return (self._order,)

    def _fail(self, reason: str) -> None:
        super()._fail(reason)
        self._state = None  # where the jaws are by now, nobody knows

    def _write(self, link: CanLink, *orders: Order) -> None:
        for order in orders:
            sent_s = link.send(encode_order(self._settings.node, order))
            if (order == POLL or isinstance(order, DriveOrder)) and sent_s is not None:
                self._asked.append(sent_s)
                self._asked_s = sent_s

    # receiving

    def _update(self, link: CanLink) -> str | None:
        """Process what has arrived, poll when due."""
        for received in link.receive():
            self._receive(link, received)
        now_s = self._clock.monotonic_s()
        self._give_up(now_s)
        if self._missing * self._settings.reply_timeout_s >= self._settings.silence_timeout_s:
            return f"no answer to {self._missing} polls in a row; is it powered, and the bus whole?"
        if link.fault is None and not self._asked and now_s - self._asked_s >= self._interval_s():
            self._write(link, POLL)
        return None

    def _interval_s(self) -> float:
        watched = self._subscribed or self._outcome.busy or self._order.go
        return self._settings.poll_interval_s if watched else self._settings.idle_interval_s

    def _receive(self, link: CanLink, received: ReceivedFrame) -> None:
        answer, fault = self._answer(received)
        if isinstance(answer, GripperErrors):
            self._faults = sorted(answer.active)
        if not isinstance(answer, GripperState):
            return
        self._missing = 0
        asked_s = self._asked.popleft() if self._asked else received.arrival_s
        earliest_s = self._earliest_asked_s(asked_s)
        if fault and not self._outcome.faulty:
            self._write(link, GripperMessage(GripperCode.ERRORS))
        self._state, self._state_s = answer, earliest_s
        home = self._outcome.only_asks
        if fault and not self._outcome.faulty and home is not None:
            # The fault is older than the Home, as after a pause longer than the watchdog's: the Home clears it.
            self._outcome.faulty = True
            self._order_now(link, home)
        else:
            self._statuses += self._outcome.push(self._clock.from_monotonic(earliest_s), answer, fault)
        if self._subscribed:
            t_s = self._clock.from_monotonic(0.5 * (asked_s + received.arrival_s))
            arrival_s = self._clock.from_monotonic(received.arrival_s)
            for samples, value in zip(
                self._samples, (self._units.width_m(answer.position), -answer.current_ma), strict=True
            ):
                samples.push(self._seq, t_s, arrival_s, (value,))
        self._seq += 1

    def _earliest_asked_s(self, asked_s: float) -> float:
        """The earliest time at which the state of an answer may have been requested.

        Answers come in order and have no number: after one that was given up, each may be the one before it, until
        the gripper would count as silent.
        """
        if not self._late:
            return asked_s
        self._late.append(asked_s)
        return self._late.popleft()

    def _give_up(self, now_s: float) -> None:
        """Count answers that are overdue as lost."""
        if now_s - self._given_up_s > self._settings.silence_timeout_s:
            self._late.clear()
        while self._asked and now_s - self._asked[0] > self._settings.reply_timeout_s:
            self._late.append(self._asked[0])
            self._given_up_s = now_s
            t_s = self._clock.from_monotonic(self._asked.popleft())
            self._seq += 1
            self._unanswered += 1
            self._missing += 1
            for stream in sorted(self._subscribed):
                self._lost(t_s, stream, 1)


def _watchdog(period_s: float) -> Order:
    """Sets the gripper's own; 0 switches it off."""
    return GripperMessage(GripperCode.WATCHDOG, (round(period_s * 1e3), 0))


def _drives(order: Order) -> bool:
    """Whether an order drives the jaws; one that puts the drive to sleep does not."""
    return order.go if isinstance(order, DriveOrder) else order.code is GripperCode.CALIBRATE
