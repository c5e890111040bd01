"""Questions and answers with one Zaber device: ids, checksums, repeats, silence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from drivers.core.clock import Clock
from drivers.core.errors import CodecError
from drivers.core.links import SerialLink
from drivers.zaber_stage import codec

AXIS = 1
"""The stage has one axis (manual: axes count from 1)."""


@dataclass(slots=True, eq=False)
class StageQuestion:
    """A command on its way: monotonic times in seconds, of its first and of its last writing."""

    text: str
    id: int
    first_s: float
    sent_s: float
    attempts: int = 1


class StageAnswer(NamedTuple):
    """A reply, with the monotonic times at which its question was written and at which it arrived."""

    reply: codec.StageReply
    sent_s: float
    arrival_s: float


class StageDialogue:
    """Questions that have no answer yet.

    A question without an answer is repeated, under a new id, every `retry_s`: each command of this
    driver may safely be repeated. Late and garbled lines are dropped. Nothing here waits.

    Args:
        link: The open port.
        address: Device number on the line.
        clock: For what is overdue.
        retry_s: When to ask again, in seconds.
        timeout_s: When to give up, in seconds.

    Attributes:
        checksums_due: True where a reply without a checksum is dropped.
        fault: Why the device has failed, or None.
        garbage: The latest bytes since the last line that was a message.
    """

    def __init__(
        self, link: SerialLink, address: int, clock: Clock, *, retry_s: float, timeout_s: float
    ) -> None:
        self.checksums_due = False
        self.fault: str | None = None
        self.garbage = b""
        self._link = link
        self._address = address
        self._clock = clock
        self._retry_s = retry_s
        self._timeout_s = timeout_s
        self._lines = codec.LineBuffer()
        self._open: dict[int, StageQuestion] = {}
        self._next_id = 0

    def ask(self, text: str) -> StageQuestion:
        """Write a question, whatever else is open."""
        now_s = self._clock.monotonic_s()
        question = StageQuestion(text, self._next_id, now_s, now_s)
        self._write(question)
        return question

    def withdraw(self, question: StageQuestion) -> None:
        """Neither repeat a question nor take its answer."""
        self._open.pop(question.id, None)

    def turn(self) -> list[tuple[StageQuestion, StageAnswer]]:
        """The answers that have arrived, in order; repeats what is overdue."""
        answered = []
        for arrival_s, data in self._link.receive():
            self.garbage = data
            for line in self._lines.feed(data):
                reply = self._decode(line)
                question = self._open.pop(reply.id, None) if reply and reply.id is not None else None
                if reply and question:
                    answered.append((question, StageAnswer(reply, question.sent_s, arrival_s)))
        self._repeat(self._clock.monotonic_s())
        return answered

    def _decode(self, line: bytes) -> codec.StageReply | None:
        try:
            message = codec.decode_message(line, checksum=self.checksums_due)
        except CodecError:
            return None
        self.garbage = b""
        mine = isinstance(message, codec.StageReply) and message.device == self._address
        return message if mine and isinstance(message, codec.StageReply) else None

    def _repeat(self, now_s: float) -> None:
        for question in list(self._open.values()):
            if now_s - question.first_s > self._timeout_s:
                received = f"only {self.garbage[:24]!r}" if self.garbage else "no reply"
                self.fault = self.fault or f"{received} in {self._timeout_s:.2f} s"
            elif now_s - question.sent_s > self._retry_s:
                self.withdraw(question)
                question.attempts += 1
                self._write(question)
        self.fault = self._link.fault or self.fault

    def _write(self, question: StageQuestion) -> None:
        question.id = self._next_id
        self._next_id = (self._next_id + 1) % codec.IDS
        self._open[question.id] = question
        request = codec.StageRequest(self._address, AXIS, question.id, question.text)
        question.sent_s = self._link.send(codec.encode_request(request)) or self._clock.monotonic_s()
        self.fault = self._link.fault or self.fault
