"""The lines between host and person, against lines written by hand."""

import pytest

from drivers.core.errors import CodecError
from drivers.core.messages import Ask, LoadWeight
from drivers.operator.codec import (
    LINE_MAX,
    LineDecoder,
    PersonAnswer,
    PersonHello,
    PersonRequest,
    decode,
    encode,
    request_of,
)

GOLDEN = [
    (PersonHello("touchbench"), b'{"hello": "touchbench"}\n'),
    (PersonRequest(3, "turn it by 90°"), '{"ask": 3, "says": "turn it by 90°"}\n'.encode()),
    (
        PersonRequest(4, "hang 0.50 N on bridge Fx", "x", 0.5),
        b'{"ask": 4, "says": "hang 0.50 N on bridge Fx", "load": {"bridge": "x", "force_n": 0.5}}\n',
    ),
    (PersonAnswer(4, True), b'{"answer": 4, "done": true}\n'),
    (PersonAnswer(4, False, "it broke"), b'{"answer": 4, "done": false, "reason": "it broke"}\n'),
]


@pytest.mark.parametrize(("message", "line"), GOLDEN)
def test_messages_are_the_lines_of_the_page_both_ways(message, line):
    assert encode(message) == line
    assert decode(line) == message


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


def test_the_decoder_puts_lines_together_and_goes_on_after_noise():
    decoder = LineDecoder()
    stream = b"".join(line for _, line in GOLDEN)
    messages = [message for byte in stream for message in decoder.feed(bytes([byte]))]
    assert messages == [message for message, _ in GOLDEN]
    assert decoder.feed(b"noise\n\r\n" + GOLDEN[3][1]) == [PersonAnswer(4, True)]
    assert decoder.malformed == 1
    assert decoder.feed(b"noise\nnoise\n") == []
    assert decoder.malformed == 3


def test_a_line_without_end_does_not_fill_the_memory():
    decoder = LineDecoder()
    assert decoder.feed(b"x" * (LINE_MAX + 1)) == []
    assert decoder.malformed == 1
    assert decoder.feed(b"x" * (LINE_MAX + 1)) == []
    assert decoder.malformed == 2
    assert decoder.feed(b"x" * LINE_MAX) == []
    assert decoder.malformed == 2, "its end may come"
    assert decoder.feed(b"\n") == []
    assert decoder.feed(GOLDEN[3][1]) == [PersonAnswer(4, True)]


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
    load = (command.bridge, command.force_n) if isinstance(command, LoadWeight) else ()
    assert request_of(7, command) == PersonRequest(7, text, *load)


def test_a_number_that_json_has_not_is_not_written():
    with pytest.raises(ValueError, match="not JSON compliant"):
        encode(PersonRequest(1, "hang it", "x", float("nan")))
