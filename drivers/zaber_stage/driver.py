"""The linear stage: Zaber ASCII over a serial port."""

import math
from collections.abc import Generator, Mapping, Sequence
from typing import TypeVar

import numpy as np

from drivers.core.errors import PortError, ProtocolError, RefusedError, SilentError
from drivers.core.links import SerialLink, open_serial
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Home,
    MoveAt,
    MoveTo,
    Reached,
    SampleBlock,
    Stalled,
    Standstill,
    Stop,
    StreamInfo,
)
from drivers.core.numbering import Samples
from drivers.core.wire import OPENING_S, TURN_S, WireDriver
from drivers.zaber_stage import codec
from drivers.zaber_stage.dialogue import StageDialogue, StageQuestion
from drivers.zaber_stage.mounting import Mounting, ZaberStageSettings
from drivers.zaber_stage.procedures import SETS_OUT, Moving, Procedures, RejectedError, StageWay

T = TypeVar("T")


class ZaberStage(WireDriver[SerialLink]):
    """A stage on its approach axis.

    A motion is a chain of absolute moves: the first goes as far as the command's `blind_travel_m`, the next ones are
    sent while the stage moves, each as far beyond its last known position, so that it never slows down before the end.
    None goes beyond the limit of an approach, and the travel is set in the device's own limits at opening and put back
    at closing. So nothing need be done when the host dies or is stopped: the stage halts by itself. `Stop` is written
    at once, ahead of everything else. A move before homing is refused; `Home` goes to the stage's home end, which the
    device does by itself. A newer motion replaces an older.

    The stream `<name>.position` (raw microsteps, irregular) has one sample for each poll that was answered,
    dated midway between poll and answer; one that was not is a jump in the sequence. Before homing the
    position is whatever the device takes it to be.
    """

    _settings: ZaberStageSettings
    _opens = staticmethod(open_serial)

    def _prepare(self) -> None:
        self._mounting = Mounting(self._settings)
        self._procedures = Procedures(self._settings, self._mounting)
        self._info = StreamInfo(
            f"{self.name}.position", ("position",), "m", self._settings.microstep_m, longest_s=codec.LONGEST_S
        )
        self._samples = Samples(self._info, np.int64)
        self._seq = 0
        self._renewals = self._halts = 0
        self._forget()

    def _forget(self) -> None:
        self._listening = False
        self._waiting: Command | None = None  # not yet begun
        self._command: Command | None = None  # of the procedure
        self._procedure: Moving | None = None
        self._question: StageQuestion | None = None  # of the procedure
        self._poll: StageQuestion | None = None  # for the position
        self._halt: StageQuestion | None = None
        self._renewal: StageQuestion | None = None  # sends it on
        self._rest: StageQuestion | None = None  # what became of the way home
        self._rested = (0.0, 0)  # when and where it ended
        self._motion: Command | None = None  # the stage is on its way
        self._way: StageWay | None = None  # of the motion; None on the way home
        self._stopping: Stop | None = None  # not yet answered
        self._since_s = -math.inf  # answers to older questions do not count for this motion
        self._asked_s = -math.inf
        self._flag = codec.NO_FLAG

    def _identify(self, link: SerialLink) -> DeviceInfo:
        """A stage that is found moving, left so by a host that died, is stopped."""
        s = self._settings
        patience_s = max(s.reply_timeout_s, OPENING_S)
        dialogue = StageDialogue(link, s.address, self._clock, retry_s=s.retry_s, timeout_s=patience_s)
        found = self._converse(link, dialogue)
        dialogue.timeout_s = s.reply_timeout_s
        self._dialogue = dialogue
        return DeviceInfo(
            self.name,
            model=f"Zaber device {found['device_id']}",
            serial=str(found["serial"]),
            version=str(found["firmware"]),
            streams={self._info.name: self._info},
            mover=True,
            details=found,
        )

    def _leave(self, link: SerialLink, failure: str | None) -> None:
        self._abandon()
        self._dialogue.ask("stop")
        if failure is None:
            self._play(self._dialogue, self._procedures.put_back())

    def _listens(self, streams: frozenset[str]) -> bool:
        self._listening = self._info.name in streams
        return True

    def _valid(self, command: Command) -> Command:
        return self._settings.valid(self.name, command)

    def _carry_out(self, command: Command) -> None:
        self._abandon()
        if isinstance(command, Stop):
            self._write_stop(command)
        else:
            self._waiting = command
            self._turn()

    def read(self) -> Sequence[SampleBlock]:
        """Positions that have arrived since the last call."""
        self._turn()
        return self._samples.take()

    def account(self) -> Mapping[str, object]:
        """Position samples published, how often it was sent on, and how often it had halted before that."""
        return {"positions": self._seq, "sent_on": self._renewals, "halted_unseen": self._halts}

    # sending

    def _write_stop(self, command: Stop) -> None:
        """Written ahead of everything: it awaits no answer."""
        assert self._link is not None
        if self._halt is not None:
            self._dialogue.withdraw(self._halt)
        self._halt = self._dialogue.ask("stop")
        self._since_s = self._halt.sent_s
        self._stopping = command
        if self._link.fault is None:
            self._sent(command, self._since_s)
        else:
            self._fail(self._link.fault)

    def _abandon(self) -> None:
        for question in (self._question, self._renewal, self._rest):
            if question is not None:
                self._dialogue.withdraw(question)
        self._question = self._renewal = self._rest = None
        self._procedure = self._command = self._waiting = self._motion = None

    def _update(self, link: SerialLink) -> str | None:
        """Process what has arrived, send what is due."""
        dialogue = self._dialogue
        for question in dialogue.turn():
            self._receive(dialogue, question)
        if dialogue.fault is not None:
            what = _doing(self._command or self._motion)
            self._fail(f"{dialogue.fault} while {what}; is the cable in {self._settings.port}?")
        elif not (self._halt or self._poll or self._question or self._renewal or self._rest):
            self._proceed(dialogue)
        return None

    def _proceed(self, dialogue: StageDialogue) -> None:
        watched = self._listening or self._stopping is not None or self._motion is not None
        interval_s = self._settings.position_interval_s if watched else self._settings.idle_interval_s
        if self._waiting is not None:
            self._command, self._waiting = self._waiting, None
            self._procedure = self._procedures.carry_out(self._command)
            self._ask(dialogue, next(self._procedure))
        elif self._clock.monotonic_s() - self._asked_s >= interval_s:
            self._poll = dialogue.ask("get pos")
            self._asked_s = self._poll.sent_s

    def _ask(self, dialogue: StageDialogue, line: str) -> None:
        self._question = dialogue.ask(line)
        if line.startswith(SETS_OUT) and self._command is not None and dialogue.fault is None:
            self._since_s = self._question.sent_s
            self._stopping = None
            self._sent(self._command, self._since_s)

    # receiving

    def _receive(self, dialogue: StageDialogue, question: StageQuestion) -> None:
        if question is self._poll:
            self._poll = None
            self._observe(dialogue, question)
        elif question is self._halt:
            self._halt = None
        elif question is self._renewal:
            self._renewal = None
            if not question.reply.accepted:
                reason = f"it rejects {question.text!r} with {question.reply.data}"
                self._stall(self._clock.from_monotonic(question.arrival_s), reason)
                self._motion = None
        elif question is self._rest:
            self._rest = None
            self._stand_still(*self._rested, question.reply.data.split()[1:])
        elif question is self._question:
            self._advance(dialogue, question.reply)

    def _advance(self, dialogue: StageDialogue, reply: codec.StageReply) -> None:
        """Pass the reply to the procedure, and send its next line."""
        command, procedure = self._command, self._procedure
        assert command is not None
        assert procedure is not None
        try:
            self._ask(dialogue, procedure.send(reply))
        except StopIteration as end:
            self._question = self._procedure = self._command = None
            self._motion, self._way = command, end.value
        except RejectedError as rejection:
            self._question = self._procedure = self._command = None
            self._refuse(command, str(rejection))

    def _observe(self, dialogue: StageDialogue, question: StageQuestion) -> None:
        """Take a position and the flag that comes with it."""
        reply = question.reply
        if not (reply.accepted and reply.data.lstrip("-").isdecimal()):
            self._fail(f"it answers 'get pos' with {reply.data!r}; is this a linear stage?")
            return
        counts = self._mounting.counts(int(reply.data))
        t_s = self._clock.from_monotonic(0.5 * (question.sent_s + question.arrival_s))
        if self._listening:
            self._sample(question.attempts - 1, t_s, counts, self._clock.from_monotonic(question.arrival_s))
        newly = reply.flag != self._flag
        self._flag = reply.flag
        if newly and codec.astray(reply.flag):
            self._stall(t_s, f"{codec.meaning(reply.flag)} ({reply.flag})")
            self._motion = None
        if question.sent_s < self._since_s:
            return
        if self._motion is not None and self._way is not None:
            # A stage that stands elsewhere was stopped by something, perhaps by hand: it is not sent on.
            ahead = self._procedures.renewed(self._way, counts)
            if ahead is not None and (reply.busy or counts == self._way.bound):
                self._send_on(dialogue, ahead, standing=not reply.busy)
                return
        if reply.busy:
            return
        if self._motion is not None and self._way is None:
            # The flag that came is the gravest alone: it may hide that the way home was interrupted.
            self._rest, self._rested = dialogue.ask("warnings"), (t_s, counts)
        else:
            self._stand_still(t_s, counts)

    def _send_on(self, dialogue: StageDialogue, ahead: StageWay, *, standing: bool) -> None:
        self._way = ahead
        self._renewal = dialogue.ask(self._procedures.towards(ahead))
        self._renewals += 1
        self._halts += standing

    def _sample(self, lost: int, t_s: float, counts: int, arrival_s: float) -> None:
        if lost:
            self._lost(t_s, self._info.name, lost)
        self._seq += lost
        self._samples.push(self._seq, t_s, arrival_s, (counts,))
        self._seq += 1

    def _stand_still(self, t_s: float, counts: int, flags: Sequence[str] = ()) -> None:
        """Report what became of the motion that has ended; `flags` are all that a way home left."""
        wrong = next((flag for flag in flags if flag in codec.NOT_HOME or codec.astray(flag)), None)
        position_m = self._mounting.position_m(counts)
        if self._stopping is not None:
            self._report(Standstill(t_s, self.name, position_m, command_id=self._stopping.id))
        elif wrong is not None:
            self._stall(t_s, f"it came to rest on its way home: {codec.meaning(wrong)} ({wrong})")
        elif self._motion is not None and self._way is not None and self._way.target != counts:
            aim_m = self._mounting.position_m(self._way.target)
            reason = f"it stopped at {position_m:.6f} m on the way to {aim_m:.6f} m ({self._flag})"
            self._stall(t_s, reason)
        elif self._motion is not None:
            self._report(Reached(t_s, self.name, position_m, command_id=self._motion.id))
        self._stopping = None
        self._motion = None

    def _stall(self, t_s: float, reason: str) -> None:
        under_way = self._motion or self._stopping
        command_id = 0 if under_way is None else under_way.id
        self._report(Stalled(t_s, self.name, reason, command_id=command_id))

    def _fail(self, reason: str) -> None:
        self._abandon()
        super()._fail(reason)

    # the rest

    def _converse(self, link: SerialLink, dialogue: StageDialogue) -> dict[str, object]:
        """Identify the stage; what was changed in one that is refused is put back."""
        try:
            found = self._play(dialogue, self._procedures.identify())
        except RejectedError as rejection:
            self._play(dialogue, self._procedures.put_back())
            raise RefusedError(self.name, "opening", str(rejection), rejection.advice) from None
        if found is not None:
            dialogue.checksums_due = True
            return found
        port, address = self._settings.port, self._settings.address
        if link.fault is not None:
            raise PortError(self.name, "opening", f"{port}: {link.fault}", "see: ls /dev/serial/by-id")
        if dialogue.garbage:
            advice = f"is another device there, its cable noisy, or its speed not {self._settings.baud} baud?"
            raise ProtocolError(
                self.name, "opening", f"{dialogue.fault} from {port}, which is no Zaber ASCII", advice
            )
        advice = (
            f"is this its port, is it powered, set to the ASCII protocol, and device {address} on its line?"
        )
        raise SilentError(self.name, "opening", f"{dialogue.fault} from {port}", advice)

    def _play(self, dialogue: StageDialogue, procedure: Generator[str, codec.StageReply, T]) -> T | None:
        """Carry a procedure through, waiting for each reply; None where one does not come.

        No checksum is asked for: the procedure may switch them.
        """
        dialogue.checksums_due = False
        try:
            question = dialogue.ask(next(procedure))
            while dialogue.fault is None:
                for answered in dialogue.turn():
                    if answered is question:
                        question = dialogue.ask(procedure.send(answered.reply))
                self._clock.rest(TURN_S)
        except StopIteration as end:
            result: T = end.value
            return result
        return None


def _doing(command: Command | None) -> str:
    match command:
        case MoveAt(limit_m=target_m) | MoveTo(position_m=target_m):
            return f"moving to {target_m:g} m"
        case Home():
            return "homing"
    return "standing"
