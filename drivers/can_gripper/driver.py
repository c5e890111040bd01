"""The gripper: SSG-48 on a CAN bus."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drivers.can_gripper.brackets import Brackets, CanGripperSettings, valid
from drivers.can_gripper.codec import encode_order
from drivers.can_gripper.identify import answer_from, identify
from drivers.can_gripper.messages import (
    AskState,
    DriveOrder,
    GripFinding,
    GripperCode,
    GripperErrors,
    GripperState,
    Order,
    Plain,
    Poll,
    Watchdog,
)
from drivers.can_gripper.units import LONGEST_S
from drivers.can_gripper.watch import Watch
from drivers.core.can_link import CanLink, ReceivedFrame, open_can
from drivers.core.messages import (
    Applied,
    Command,
    DeviceInfo,
    Grip,
    Listen,
    Release,
    SampleBlock,
    Stop,
    StreamInfo,
)
from drivers.core.numbering import Runs, SampleRun
from drivers.core.wire import WireDriver

IDLE = DriveOrder(0, 0, 0, activate=False, go=False)


class _Sample(NamedTuple):
    width_m: float
    closing_ma: int


class CanGripper(WireDriver[CanLink]):
    """A gripper whose jaws open and close; implements `drivers.core.protocols.Device`.

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
        self._brackets = Brackets(self._settings.closed_width_m, self._settings.force_n_per_ma)
        self._infos = (
            StreamInfo(f"{self.name}.width", ("width",), "m", longest_s=LONGEST_S),
            StreamInfo(
                f"{self.name}.force", ("force",), "N", self._settings.force_n_per_ma, longest_s=LONGEST_S
            ),
        )
        self._runs = Runs[_Sample]()
        self._seq = 0
        self._unanswered = 0
        self._forget()

    def _forget(self) -> None:
        self._watch = Watch(self.name, self._brackets, self._settings.object_hold_s)
        self._subscribed: frozenset[str] = frozenset()
        self._state: GripperState | None = None
        self._order = IDLE  # the last one that drives the jaws
        self._asked: deque[float] = deque()  # monotonic times of polls without an answer
        self._asked_s = -math.inf
        self._late: deque[float] = deque()  # those whose answer may still come, or was lost
        self._given_up_s = -math.inf
        self._missing = 0  # polls in a row without an answer
        self._faults: list[str] = []

    def _identify(self, link: CanLink) -> DeviceInfo:
        """A gripper that is found moving is stopped."""
        found = identify(self.name, self._settings, link, self._clock)
        self._write(link, Watchdog(round(self._settings.watchdog_s * 1e3)))
        if found.state.calibrated and found.state.going and found.state.finding is GripFinding.MOVING:
            steady_ma = self._brackets.current_ma(self._settings.release_force_n)
            self._write(link, DriveOrder(found.state.position, 0, steady_ma))
        self._state = found.state
        self._watch.faulty = bool(found.errors.active)
        self._asked.clear()
        return DeviceInfo(
            self.name,
            model=f"SSG-48, hardware {found.info.hardware}",
            serial=str(found.info.serial),
            version=str(found.info.software),
            streams={info.name: info for info in self._infos},
            mover=True,
            details={
                "closed_width_m": self._brackets.closed_width_m,
                "open_width_m": self._brackets.open_width_m,
                "watchdog_s": self._settings.watchdog_s,
                "calibrated": found.state.calibrated,
                "faults": sorted(found.errors.active),
                "temperature_c": found.temperature_c,
                "supply_v": found.supply_v,
            },
        )

    def _leave(self, link: CanLink, failure: str | None) -> None:
        """Stop what moves, switch the watchdog off: what is held stays held."""
        if failure is None:
            if not self._watch.resting:
                self._write(link, *self._stopping())
            self._write(link, Watchdog(0))

    def apply(self, command: Command) -> Applied:
        """Queue a command; it is written when this returns.

        Too great a speed is clamped; width, speed and force are rounded to the gripper's counts, the force down.

        Raises:
            CommandError: not for a gripper, not finite or out of range. Nothing was sent.
        """
        if isinstance(command, Listen):
            self._subscribed = command.streams & {info.name for info in self._infos}
            return Applied(command, self._clock.now())
        return super().apply(command)

    def _valid(self, command: Command) -> Command:
        s = self._settings
        return valid(self.name, self._brackets, s.max_speed_m_s, s.max_force_n, command)

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
        self._watch.begin(command, self._clock.now(), drives=any(map(_drives, orders)))

    def read(self) -> Sequence[SampleBlock]:
        """Widths and forces that have arrived since the last call."""
        self._turn()
        runs = self._runs.take()
        return [
            self._block(info, run)
            for info in reversed(self._infos)
            if info.name in self._subscribed
            for run in runs
        ]

    def account(self) -> Mapping[str, object]:
        """States received and lost, malformed frames and faults, for the manifest."""
        malformed = 0 if self._link is None else self._link.malformed
        answered = self._seq - self._unanswered
        return {"states": answered, "lost": self._unanswered, "malformed": malformed, "faults": self._faults}

    # sending

    def _refusal(self, command: Command) -> str | None:
        """Why a command cannot be carried out now."""
        if isinstance(command, Grip | Release):
            if self._watch.faulty:
                return "it has a fault; send Home, which clears it"
            if self._state is None or not self._state.calibrated:
                return "it does not know its ends; send Home first, with empty jaws"
        return None

    def _orders(self, command: Command) -> Sequence[Order]:
        """The orders that carry out a command."""
        match command:
            case Grip():
                self._order = self._brackets.grip(command)
                return (self._order,)
            case Release():
                self._order = self._brackets.release(command, self._settings.release_force_n)
                return (self._order,)
            case Stop():
                return (Poll(),) if self._watch.resting else self._stopping()
        known = self._state is not None and self._state.calibrated
        if known and not self._watch.faulty:
            return (Poll(),)
        # An emergency stop stays up until an order without it has come, and only then can be cleared.
        self._order = IDLE
        clearing = (IDLE, Plain(GripperCode.CLEAR_ERROR))
        return clearing if known else (*clearing, Plain(GripperCode.CALIBRATE))

    def _stopping(self) -> Sequence[Order]:
        """The order that stops a motion: hold the position, or sleep where it is not known."""
        if self._state is None or not self._state.calibrated:
            return (Plain(GripperCode.IDLE),)
        self._order = self._brackets.hold(self._state, self._order)
        return (self._order,)

    def _write(self, link: CanLink, *orders: Order) -> None:
        for order in orders:
            sent_s = link.send(encode_order(self._settings.node, order))
            if isinstance(order, Poll | DriveOrder) and sent_s is not None:
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
            self._write(link, Poll())
        return None

    def _interval_s(self) -> float:
        watched = self._subscribed or self._watch.busy or self._order.go
        return self._settings.poll_interval_s if watched else self._settings.idle_interval_s

    def _receive(self, link: CanLink, received: ReceivedFrame) -> None:
        answer, fault = answer_from(self._settings.node, received) or (None, False)
        if isinstance(answer, GripperErrors):
            self._faults = sorted(answer.active)
        if not isinstance(answer, GripperState):
            return
        self._missing = 0
        asked_s = self._asked.popleft() if self._asked else received.arrival_s
        earliest_s = self._earliest_asked_s(asked_s)
        if fault and not self._watch.faulty:
            self._write(link, AskState(GripperCode.ERRORS))
        self._state = answer
        home = self._watch.only_asks
        if fault and not self._watch.faulty and home is not None:
            # The fault is older than the Home, as after a pause longer than the watchdog's: the Home clears it.
            self._watch.faulty = True
            self._order_now(link, home)
        else:
            self._statuses += self._watch.push(self._clock.from_monotonic(earliest_s), answer, fault)
        if self._subscribed:
            t_s = self._clock.from_monotonic(0.5 * (asked_s + received.arrival_s))
            width_m = self._brackets.width_m(answer.position)
            arrival_s = self._clock.from_monotonic(received.arrival_s)
            self._runs.push(self._seq, t_s, arrival_s, _Sample(width_m, -answer.current_ma))
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

    def _block(self, info: StreamInfo, run: SampleRun[_Sample]) -> SampleBlock:
        width = info is self._infos[0]
        return info.block(
            run.seq,
            run.t0_s,
            np.array([[sample.width_m if width else sample.closing_ma] for sample in run.samples]),
            times_s=np.array(run.times_s),
            arrival_s=run.arrival_s,
        )


def _drives(order: Order) -> bool:
    """Whether an order drives the jaws; one that puts the drive to sleep does not."""
    return order == Plain(GripperCode.CALIBRATE) or (isinstance(order, DriveOrder) and order.go)
