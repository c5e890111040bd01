"""The lines between host and person, against lines written by hand."""

import pytest

from drivers.core.errors import CodecError
from drivers.core.messages import Ask, LoadWeight
from drivers.operator.codec import decode, encode, request_of

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
