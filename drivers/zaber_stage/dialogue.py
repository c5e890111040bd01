"""Questions and answers with one Zaber device: ids, checksums, repeats, silence."""

from dataclasses import dataclass, field

from drivers.core.clock import Clock
from drivers.core.errors import CodecError
from drivers.core.links import LineBuffer, SerialLink
from drivers.zaber_stage import codec


@dataclass(slots=True, eq=False)
class StageQuestion:
    """A command on its way.

    Attributes:
        id: Under which it was last written.
        first_s: Monotonic time of its first writing.
        sent_s: Likewise of its last.
    """

    text: str
    id: int
    first_s: float
    sent_s: float
    attempts: int = 1
    reply: codec.StageReply = field(init=False)
    arrival_s: float = field(init=False)


class StageDialogue:
    """Questions that have no answer yet.

    A question without an answer is repeated, under a new id, every `retry_s`: each command of this
    driver may safely be repeated. Late and garbled lines are dropped. Nothing here waits.

    Args:
        address: Device number on the line.
        retry_s: When to ask again, in seconds.

    Attributes:
        timeout_s: When to give up, in seconds.
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
        self.timeout_s = timeout_s
        self._lines = LineBuffer(codec.MAX_LINE)
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

    def turn(self) -> list[StageQuestion]:
        """The questions that have been answered, in the order of their replies; repeats what is overdue."""
        answered = []
        for arrival_s, data in self._link.receive():
            self.garbage = data
            for line in self._lines.feed(data):
                question = self._answered(line, arrival_s)
                if question is not None:
                    answered.append(question)
        self._repeat(self._clock.monotonic_s())
        return answered

    def _answered(self, line: bytes, arrival_s: float) -> StageQuestion | None:
        try:
            reply = codec.decode_message(line, checksum=self.checksums_due)
        except CodecError:
            return None
        self.garbage = b""
        if reply.lead != "@" or reply.device != self._address or reply.id not in self._open:
            return None
        question = self._open.pop(reply.id)
        question.reply, question.arrival_s = reply, arrival_s
        return question

    def _repeat(self, now_s: float) -> None:
        for question in list(self._open.values()):
            if now_s - question.first_s > self.timeout_s:
                received = f"only {self.garbage[:24]!r}" if self.garbage else "no reply"
                self.fault = self.fault or f"{received} in {self.timeout_s:.2f} s"
            elif now_s - question.sent_s > self._retry_s:
                self.withdraw(question)
                question.attempts += 1
                self._write(question)
        self.fault = self._link.fault or self.fault

    def _write(self, question: StageQuestion) -> None:
        question.id = self._next_id
        self._next_id = (self._next_id + 1) % codec.IDS
        self._open[question.id] = question
        request = codec.StageRequest(self._address, codec.scope(question.text), question.id, question.text)
        question.sent_s = self._link.send(codec.encode_request(request)) or self._clock.monotonic_s()
        self.fault = self._link.fault or self.fault
