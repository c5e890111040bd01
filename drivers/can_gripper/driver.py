"""The gripper: SSG-48 on a CAN bus."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drivers.can_gripper.brackets import Brackets, CanGripperSettings, valid
from drivers.can_gripper.codec import encode_order
from drivers.can_gripper.identify import heard_from, identify
from drivers.can_gripper.units import LONGEST_S
from drivers.can_gripper.watch import Watch
from drivers.can_gripper.words import (
    Ask,
    Code,
    Drive,
    Errors,
    Finding,
    Order,
    Plain,
    Poll,
    State,
    Watchdog,
)
from drivers.can_link import CanLink, Heard, open_can
from drivers.clock import Clock
from drivers.messages import (
    Applied,
    Command,
    DeviceInfo,
    Failed,
    Grip,
    Listen,
    Lost,
    Refused,
    Release,
    SampleBlock,
    Sent,
    Status,
    Stop,
    StreamInfo,
)
from drivers.numbering import Run, Runs

NOT_OPEN = "it is not open"

IDLE = Drive(0, 0, 0, activate=False, go=False)


class _Sample(NamedTuple):
    width_m: float
    closing_ma: int


class CanGripper:
    """A gripper whose jaws open and close; implements `drivers.protocols.Device`.

    `Home` clears faults and calibrates where that has not been done since power-up: the jaws open and close
    fully, so they must be empty. `Grip` is one frame, written before `apply` returns: a grip that tightens
    costs no more. Force is set by the motor's current and never measured: what is told as force is the
    measured current times the maker's constant. `Stop` holds the jaws where they are; what they hold already
    they go on holding. Any fault lets the grip go, and is told as `Stalled`.

    The gripper's own watchdog is set at `open` and fed by `read` and `poll`, by no thread: it lets go when the
    host hangs or dies. `close` switches it off, so that what is held at the end of a program stays held.

    Streams, irregular, one sample for each answered question, at the middle of question and answer; a lost
    answer is a jump in the sequence: `<name>.width` in m, `<name>.force` in N, positive where the jaws press
    inwards.

    Args:
        name: Name in the profile.
        settings: Of the gripper.
        clock: Gives bench time.
    """

    def __init__(self, name: str, settings: CanGripperSettings, clock: Clock) -> None:
        self.name = name
        self._settings = settings
        self._clock = clock
        self._brackets = Brackets(settings.closed_width_m, settings.force_n_per_ma)
        self._infos = (
            StreamInfo(f"{name}.width", ("width",), "m", longest_s=LONGEST_S),
            StreamInfo(f"{name}.force", ("force",), "N", settings.force_n_per_ma, longest_s=LONGEST_S),
        )
        self._link: CanLink | None = None
        self._failure: str | None = NOT_OPEN
        self._statuses: list[Status] = []
        self._runs = Runs[_Sample]()
        self._seq = 0
        self._lost = 0
        self._forget()

    def _forget(self) -> None:
        self._watch = Watch(self.name, self._brackets, self._settings.object_hold_s)
        self._heard: frozenset[str] = frozenset()
        self._state: State | None = None
        self._order = IDLE  # the last one that moves
        self._asked: deque[float] = deque()  # monotonic times of questions for the state without an answer
        self._asked_s = -math.inf
        self._missing = 0  # questions in a row without an answer
        self._faults: list[str] = []

    def open(self) -> DeviceInfo:
        """Connect, identify, set the watchdog; a gripper that is found moving is stopped.

        Raises:
            PortError: the bus is absent, busy or was taken away.
            SilentError: nothing answers.
            ProtocolError: what answers is no SSG-48.
        """
        self.close()
        self._forget()
        self._link = open_can(self.name, self._settings, self._clock)
        try:
            found = identify(self.name, self._settings, self._link, self._clock)
            self._say(self._link, Watchdog(round(self._settings.watchdog_s * 1e3)))
            if found.state.calibrated and found.state.going and found.state.finding is Finding.MOVING:
                steady_ma = self._brackets.current_ma(self._settings.release_force_n)
                self._say(self._link, Drive(found.state.position, 0, steady_ma))
        except BaseException:
            self.close()
            raise
        self._failure = None
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

    def close(self) -> None:
        """Stop what moves, switch the watchdog off, let go of the bus. Never raises; may be called twice."""
        link, self._link = self._link, None
        if link is None:
            return
        if self._failure is None:
            if not self._watch.resting:
                self._say(link, *self._stopping())
            self._say(link, Watchdog(0))
        self._failure = NOT_OPEN
        link.close()
        self._forget()

    def apply(self, command: Command) -> Applied:
        """Queue a command; it is written when this returns.

        Too great a speed is clamped; width, speed and force are rounded to the gripper's counts, the force down.

        Raises:
            CommandError: not for a gripper, not finite or out of range. Nothing was sent.
        """
        s = self._settings
        command = valid(self.name, self._brackets, s.max_speed_m_s, s.max_force_n, command)
        if isinstance(command, Listen):
            self._heard = command.streams & {info.name for info in self._infos}
            return Applied(command, self._clock.now())
        link, refusal = self._link, self._refusal(command)
        if link is None or refusal is not None:
            self._statuses.append(Refused(self._clock.now(), self.name, command, refusal or NOT_OPEN))
        else:
            orders = self._orders(command)
            self._say(link, *orders)
            sent_s = self._clock.now()
            self._watch.begin(command, sent_s, drives=any(map(_drives, orders)))
            if link.fault is None:
                self._statuses.append(Sent(sent_s, self.name, command))
        return Applied(command, self._clock.now())

    def read(self) -> Sequence[SampleBlock]:
        """Widths and forces that have arrived since the last call."""
        self._turn()
        runs = self._runs.take()
        return [
            self._block(info, run)
            for info in reversed(self._infos)
            if info.name in self._heard
            for run in runs
        ]

    def poll(self) -> Sequence[Status]:
        """Statuses since the last call, in order."""
        self._turn()
        statuses, self._statuses = self._statuses, []
        return statuses

    def account(self) -> Mapping[str, object]:
        """How the bus did so far, for the manifest."""
        malformed = 0 if self._link is None else self._link.malformed
        answered = self._seq - self._lost
        return {"states": answered, "lost": self._lost, "malformed": malformed, "faults": self._faults}

    # what is said

    def _refusal(self, command: Command) -> str | None:
        """Why a command cannot be carried out now."""
        if self._failure is not None:
            return self._failure
        if isinstance(command, Grip | Release):
            if self._watch.faulty:
                return "it has a fault; send Home, which clears it"
            if self._state is None or not self._state.calibrated:
                return "it does not know its ends; send Home first, with empty jaws"
        return None

    def _orders(self, command: Command) -> Sequence[Order]:
        """What is written to carry out a command."""
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
        clearing = (IDLE, Plain(Code.CLEAR_ERROR))
        return clearing if known else (*clearing, Plain(Code.CALIBRATE))

    def _stopping(self) -> Sequence[Order]:
        """What stops a motion: to hold where the jaws are, or to sleep where they do not know that."""
        if self._state is None or not self._state.calibrated:
            return (Plain(Code.IDLE),)
        self._order = self._brackets.hold(self._state, self._order)
        return (self._order,)

    def _say(self, link: CanLink, *orders: Order) -> None:
        for order in orders:
            sent_s = link.send(encode_order(self._settings.node, order))
            if isinstance(order, Poll | Drive) and sent_s is not None:
                self._asked.append(sent_s)
                self._asked_s = sent_s

    # what is heard

    def _turn(self) -> None:
        """Hear what has come, ask what is due."""
        link = self._link
        if link is None or self._failure is not None:
            return
        for heard in link.receive():
            self._hear(link, heard)
        now_s = self._clock.monotonic_s()
        self._give_up(now_s)
        if link.fault is not None:
            self._fail(link.fault)
        elif self._missing * self._settings.reply_timeout_s >= self._settings.silence_timeout_s:
            self._fail(
                f"{self._missing} questions in a row have no answer; is it powered, and the bus whole?"
            )
        elif not self._asked and now_s - self._asked_s >= self._interval_s():
            self._say(link, Poll())

    def _interval_s(self) -> float:
        watched = self._heard or self._watch.busy or self._order.go
        return self._settings.poll_interval_s if watched else self._settings.idle_interval_s

    def _hear(self, link: CanLink, heard: Heard) -> None:
        answer, fault = heard_from(self._settings.node, heard) or (None, False)
        if isinstance(answer, Errors):
            self._faults = sorted(answer.active)
        if not isinstance(answer, State):
            return
        self._missing = 0
        asked_s = self._asked.popleft() if self._asked else heard.arrival_s
        if fault and not self._watch.faulty:
            self._say(link, Ask(Code.ERRORS))
        self._state = answer
        self._statuses += self._watch.push(self._clock.from_monotonic(asked_s), answer, fault)
        if self._heard:
            t_s = self._clock.from_monotonic(0.5 * (asked_s + heard.arrival_s))
            width_m = self._brackets.width_m(answer.position)
            arrival_s = self._clock.from_monotonic(heard.arrival_s)
            self._runs.push(self._seq, t_s, arrival_s, _Sample(width_m, -answer.current_ma))
        self._seq += 1

    def _give_up(self, now_s: float) -> None:
        """Count answers that will not come any more."""
        while self._asked and now_s - self._asked[0] > self._settings.reply_timeout_s:
            t_s = self._clock.from_monotonic(self._asked.popleft())
            self._seq += 1
            self._lost += 1
            self._missing += 1
            self._statuses += [Lost(t_s, self.name, stream, 1) for stream in sorted(self._heard)]

    def _fail(self, reason: str) -> None:
        self._failure = reason
        self._statuses.append(Failed(self._clock.now(), self.name, reason))

    def _block(self, info: StreamInfo, run: Run[_Sample]) -> SampleBlock:
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
    return order == Plain(Code.CALIBRATE) or (isinstance(order, Drive) and order.go)
