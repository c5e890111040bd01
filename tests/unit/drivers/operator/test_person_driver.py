"""A person as a device: the console, and the lines to one elsewhere."""

import io
import math

import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import CodecError, CommandError, PortError
from drivers.core.messages import Answered, Ask, Home, Listen, Loaded, LoadWeight, Refused, Sent
from drivers.core.protocols import Asking
from drivers.operator.codec import decode, encode, request_of
from drivers.operator.driver import Person, PersonSettings
from tests.refusals import refused


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def person(monkeypatch):
    monkeypatch.setattr("sys.stdin", Terminal())
    clock = VirtualClock()
    person = Person("operator", PersonSettings(), clock)
    person.open()
    vars(person)["clock"] = clock
    return person


def test_the_console_sees_a_device_that_asks(person):
    assert isinstance(person, Asking)
    assert person.question is None


def test_a_weight_is_asked_for_and_loaded_on_enter(person):
    person.apply(Listen("operator", frozenset({"operator.load"})))
    command = LoadWeight("operator", "x", 0.5)
    person.apply(command)
    number, text = person.question
    assert text == "hang 0.50 N on bridge Fx, then press Enter (n and Enter: it cannot be done)"
    assert person.poll() == [Sent(0.0, "operator", command)]
    person.clock.wait_until(7.0)
    person.answer(number, done=True)
    (block,) = person.read()
    assert (block.stream, block.times.tolist(), block.values.tolist()) == (
        "operator.load",
        [7.0],
        [[0.5, 0.0, 0.0]],
    )
    assert person.poll() == [Loaded(7.0, "operator", "x", 0.5)]
    assert person.question is None


def test_no_is_a_refusal(person):
    command = LoadWeight("operator", "t", 1.0)
    person.apply(command)
    person.answer(person.question.number, done=False)
    assert person.poll()[-1] == Refused(0.0, "operator", command, "the person says no")


def test_an_answer_to_a_question_that_was_replaced_counts_for_nothing(person):
    person.apply(LoadWeight("operator", "x", 0.5))
    old = person.question.number
    person.apply(LoadWeight("operator", "x", 0.5))
    assert person.question.number != old, "the same text, another question"
    person.answer(old, done=True)
    assert not [status for status in person.poll() if isinstance(status, Loaded)]
    assert person.question is not None


def test_loads_are_numbered_with_and_without_a_subscriber(person):
    for listened in (frozenset(), frozenset({"operator.load"})):
        person.apply(Listen("operator", listened))
        person.apply(LoadWeight("operator", "y", 1.0))
        person.answer(person.question.number, done=True)
    (block,) = person.read()
    assert block.seq == 1


@pytest.mark.parametrize(
    ("command", "reason", "remedy"),
    [
        *(
            (LoadWeight("operator", "x", force), "on Fx is out", "0 to 10 N")
            for force in (10.1, -0.1, math.nan)
        ),
        (LoadWeight("operator", "t", 1.6), "on Ft is out of range", "0 to 1.5 N"),
        (LoadWeight("operator", "z", 1.0), "no bridge z", "x, y, t"),
        (Ask("operator", " "), "no text", "what is to be done"),
        (Home("operator"), "no such command", "Ask and LoadWeight"),
    ],
)
def test_what_the_sensor_does_not_bear_or_a_person_cannot_do_is_refused(person, command, reason, remedy):
    with refused(CommandError, "operator: ", reason, remedy):
        person.apply(command)
    assert person.question is None


def test_without_a_terminal_open_is_refused(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(
        PortError, match="standard input is no terminal while opening the console; run it in a terminal"
    ):
        Person("operator", PersonSettings(), VirtualClock()).open()


def test_lines_that_are_no_message_are_counted_and_passed_over(person):
    person.apply(Ask("operator", "shut the door"))
    person._link.receive = lambda: [(0.0, b'noise\n\r\n{"answer": 1, "done": true}\n[1]\n')]
    assert person.poll()[-1] == Answered(0.0, "operator", "shut the door")
    person._link.receive = list
    assert person.account() == {"requests": 1, "malformed_lines": 2}


def test_after_close_nothing_is_asked(person):
    person.apply(LoadWeight("operator", "x", 0.5))
    person.close()
    person.close()
    assert person.question is None
    person.poll()
    person.apply(LoadWeight("operator", "x", 0.5))
    assert [status.reason for status in person.poll()] == ["it is not open"]


LOAD = {"bridge": "x", "force_n": 0.5}
GOLDEN = [
    ({"hello": "touchbench"}, b'{"hello": "touchbench"}\n'),
    ({"ask": 3, "says": "turn it by 90°"}, '{"ask": 3, "says": "turn it by 90°"}\n'.encode()),
    (
        {"ask": 4, "says": "hang 0.50 N on bridge Fx", "load": LOAD},
        b'{"ask": 4, "says": "hang 0.50 N on bridge Fx", "load": {"bridge": "x", "force_n": 0.5}}\n',
    ),
    (
        {"answer": 4, "done": False, "reason": "it broke"},
        b'{"answer": 4, "done": false, "reason": "it broke"}\n',
    ),
]


@pytest.mark.parametrize(("message", "line"), GOLDEN)
def test_messages_are_the_lines_of_the_page_both_ways(message, line):
    assert encode(message) == line
    assert decode(line) == message


def test_an_answer_needs_no_reason_and_other_keys_are_passed_over():
    line = b'{"answer": 4, "done": true, "mood": "good"}'
    assert decode(line) == {"answer": 4, "done": True, "reason": ""}


@pytest.mark.parametrize(
    "line",
    [
        b"done",
        b"{}",
        b"[1]",
        b'{"answer": "4", "done": true}',
        b'{"answer": 4}',
        b"\xff\xfe",
        b"[" * 9999,
        b'{"ask": 1, "says": "", "load": {"bridge": "x", "force_n": 1%b}}' % (b"0" * 400),
    ],
)
def test_what_is_no_message_is_an_error(line):
    with pytest.raises(CodecError, match=r"^no message: b'"):
        decode(line)


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (LoadWeight("operator", "x", 0.5), "hang 0.50 N on bridge Fx"),
        (LoadWeight("operator", "t", 0.05), "hang 0.050 N on bridge Ft"),
        (LoadWeight("operator", "y", 7.0), "hang 7.00 N on bridge Fy"),
        (LoadWeight("operator", "y", 0.0), "take every weight off"),
        (Ask("operator", "shut the door"), "shut the door"),
    ],
)
def test_a_request_has_a_text(command, text):
    request = request_of(7, command)
    assert (request["ask"], request["says"]) == (7, text)
    weighs = isinstance(command, LoadWeight)
    assert request.get("load") == ({"bridge": command.bridge, "force_n": command.force_n} if weighs else None)


def test_a_number_that_json_has_not_is_not_written():
    with pytest.raises(ValueError, match="not JSON compliant"):
        encode({"ask": 1, "says": "hang it", "load": {"bridge": "x", "force_n": float("nan")}})
