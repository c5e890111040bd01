"""Questions to one stage, and what becomes of them, on a line made of lists, in virtual time."""

import pytest

from drivers.core.clock import VirtualClock
from drivers.zaber_stage.codec import StageReply, StageRequest, decode_request, encode_message
from drivers.zaber_stage.dialogue import StageDialogue

BEGIN_S = 64.0
WRITE_S = 1.0 / 256.0
"""How long a write takes here: the time of a question is that of its last byte. All times are sums of powers of two."""


class Link:
    """Notes what is written; gives what the test puts in."""

    def __init__(self, clock):
        self.clock, self.written, self.waiting, self.fault = clock, [], [], None

    def send(self, data):
        if self.fault is not None:
            return None
        self.clock.rest(WRITE_S)
        self.written.append(decode_request(data.rstrip()))
        return self.clock.monotonic_s()

    def receive(self):
        taken, self.waiting = self.waiting, []
        return taken


class Line:
    """A dialogue with device 3, which is asked again after 1/8 s and given up after half a second."""

    def __init__(self):
        self.clock = VirtualClock()
        self.clock.rest(BEGIN_S)
        self.link = Link(self.clock)
        self.dialogue = StageDialogue(self.link, 3, self.clock, retry_s=0.125, timeout_s=0.5)

    def receives(self, *replies, checksum=True):
        data = b"".join(encode_message(reply, checksum=checksum) for reply in replies)
        self.link.waiting.append((self.clock.monotonic_s(), data))
        return self.dialogue.turn()

    def turn(self, seconds):
        self.clock.rest(seconds)
        return self.dialogue.turn()

    @property
    def ids(self):
        return [request.id for request in self.link.written]


@pytest.fixture
def line():
    return Line()


def reply(number, device=3, data="0"):
    return StageReply(device, 1, number, True, False, "--", data)


def test_a_question_is_written_at_once_to_the_one_axis_under_a_number(line):
    question = line.dialogue.ask("stop")
    line.dialogue.ask("get pos")
    assert line.link.written == [StageRequest(3, 1, 0, "stop"), StageRequest(3, 1, 1, "get pos")]
    assert (question.first_s, question.sent_s, question.attempts) == (BEGIN_S, BEGIN_S + WRITE_S, 1)


def test_an_answer_goes_to_its_question_with_both_times_once(line):
    first, second = line.dialogue.ask("stop"), line.dialogue.ask("get pos")
    line.clock.rest(0.01)
    late, early = reply(second.id, data="123"), reply(first.id)
    assert line.receives(late, early) == [second, first]
    assert (second.reply, first.reply) == (late, early)
    assert first.arrival_s == second.arrival_s == line.clock.monotonic_s()
    assert line.receives(early) == []


def test_answers_of_others_without_a_number_or_to_no_question_are_passed_over(line):
    line.dialogue.ask("stop")
    assert line.receives(reply(0, device=4), reply(None), reply(7)) == []
    assert len(line.receives(reply(0))) == 1


def test_a_line_that_came_in_two_pieces_has_the_time_of_its_end(line):
    question, data = line.dialogue.ask("stop"), encode_message(reply(0))
    line.link.waiting = [(1.0, data[:5]), (2.0, data[5:])]
    assert line.dialogue.turn() == [question]
    assert (question.reply, question.arrival_s) == (reply(0), 2.0)


def test_garbage_before_an_answer_is_no_matter(line):
    question = line.dialogue.ask("stop")
    line.link.waiting = [(1.0, b"\xff@@\n")]
    assert line.receives(reply(question.id)) == [question]
    assert line.dialogue.garbage == b""
    assert line.dialogue.fault is None


@pytest.mark.parametrize(("due", "count"), [(False, 1), (True, 0)])
def test_a_reply_without_a_checksum_counts_until_checksums_are_due(line, due, count):
    line.dialogue.checksums_due = due
    line.dialogue.ask("stop")
    assert len(line.receives(reply(0), checksum=False)) == count


def test_a_question_without_an_answer_is_asked_again_under_a_new_number(line):
    question = line.dialogue.ask("stop")
    line.turn(0.125)
    assert line.ids == [0], "not after exactly its time"
    line.turn(0.001)
    assert line.ids == [0, 1]
    assert (question.id, question.attempts, question.first_s) == (1, 2, BEGIN_S)
    assert question.sent_s == line.clock.monotonic_s()
    assert line.receives(reply(0)) == [], "what comes late"
    line.turn(0.125)
    line.turn(0.001)
    assert question.attempts == 3
    assert line.receives(reply(2)) == [question]
    line.turn(1.0)
    assert line.ids == [0, 1, 2]
    assert line.dialogue.fault is None


@pytest.mark.parametrize(
    ("received", "reported"),
    [(b"", "no reply"), (b"x" * 40, f"only {b'x' * 24!r}"), (b"\xff\n", r"only b'\xff\n'")],
)
def test_a_question_that_is_never_answered_is_a_fault_that_says_what_came(line, received, reported):
    line.dialogue.ask("stop")
    line.clock.wait_until(BEGIN_S + 0.5)
    line.dialogue.turn()
    assert line.dialogue.fault is None
    if received:
        line.link.waiting = [(line.clock.monotonic_s(), received)]
    line.turn(0.02)
    assert line.dialogue.fault == f"{reported} in 0.50 s"
    asked = len(line.link.written)
    line.turn(0.2)
    assert len(line.link.written) == asked, "it is not asked any more"


def test_the_first_fault_is_kept_but_for_a_link_that_is_gone(line):
    line.dialogue.ask("stop")
    line.dialogue.fault = "no reply to an older one"
    line.turn(0.5)
    assert line.dialogue.fault == "no reply to an older one"
    line.link.fault = "the port was taken away"
    line.turn(0.0)
    assert line.dialogue.fault == "the port was taken away"


def test_a_link_that_is_gone_is_seen_when_something_is_asked(line):
    line.link.fault = "the port was taken away"
    question = line.dialogue.ask("stop")
    assert line.dialogue.fault == "the port was taken away"
    assert question.sent_s == BEGIN_S


def test_what_is_withdrawn_is_neither_asked_again_nor_answered(line):
    question, other = line.dialogue.ask("move max"), line.dialogue.ask("stop")
    line.dialogue.withdraw(question)
    line.dialogue.withdraw(question)
    assert line.receives(reply(0), reply(1)) == [other]
    line.turn(1.0)
    assert line.ids == [0, 1]
    assert line.dialogue.fault is None


def test_numbers_come_round_after_a_hundred(line):
    for _ in range(102):
        line.dialogue.withdraw(line.dialogue.ask("get pos"))
    assert line.ids[98:] == [98, 99, 0, 1]
