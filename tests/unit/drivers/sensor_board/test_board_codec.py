"""Messages of the sensor board against golden bytes and against themselves."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.errors import CodecError
from drivers.sensor_board.codec import (
    ARGUMENTS,
    BoardCode,
    BoardHello,
    BoardReply,
    BoardSamples,
    CommandFrame,
    HelloStream,
    Message,
    decode,
    encode,
)
from drivers.sensor_board.framing import BoardFrameDecoder, frame
from tests.refusals import refused

GOLDEN: list[dict[str, Any]] = json.loads(
    (Path(__file__).parents[3] / "data" / "board_golden.json").read_text()
)["frames"]

U8, U16, U32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
I32 = st.integers(-(2**31), 2**31 - 1)
LIMITS = {
    BoardCode.START: U32,
    BoardCode.EXCITE: U8,
    BoardCode.TENDON: I32,
    BoardCode.TARE: U8,
    BoardCode.WATCHDOG: U16,
}
NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,10}", fullmatch=True)
SCALES = st.floats(1e-9, 1e3)


def body_of(message: Message) -> bytes:
    (body,) = BoardFrameDecoder().feed(b"\0" + encode(message))
    return body


def stream(**changes: Any) -> dict[str, Any]:
    plain = {"id": 0, "name": "load_cell", "channels": 1, "rate_hz": 1000.0, "unit": "N", "scale": 1e-5}
    return {**plain, "kind": "samples", **changes}


def hello_body(*streams: dict[str, Any], **changes: Any) -> bytes:
    fields = {"board": "b", "serial": "7", "version": "1", "streams": streams, **changes}
    return b"\x03" + json.dumps(fields).encode()


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden["what"])
def test_a_golden_body_is_its_frame_and_its_message(golden: dict[str, Any]) -> None:
    body, expected = bytes.fromhex(golden["body"]), golden["message"]
    assert frame(body).hex(" ") == golden["frame"]
    assert BoardFrameDecoder().feed(b"\0" + frame(body)) == [body]
    message = decode(body)
    if isinstance(message, BoardHello):  # JSON may be spaced as one likes: decoding alone is golden
        assert [(s.id, s.name, s.rate_hz) for s in message.streams] == [
            (0, "load_cell", 1000.0),
            (3, "period", None),
        ]
        return
    assert encode(message) == frame(body)
    for name in expected.keys() - {"kind"}:
        assert np.array_equal(getattr(message, name), expected[name]), name


@given(U8, U16, U32, st.lists(I32, min_size=1, max_size=200))
def test_samples_come_back(number: int, seq: int, t_us: int, values: list[int]) -> None:
    again = decode(body_of(BoardSamples(number, seq, t_us, np.array(values, np.int32))))
    assert isinstance(again, BoardSamples)
    assert (again.stream, again.seq, again.t_us, again.values.tolist()) == (number, seq, t_us, values)


@given(U8, U16, U32, st.lists(st.tuples(U32, I32), min_size=1, max_size=100))
def test_samples_with_times_come_back(number: int, seq: int, t_us: int, rows: list[tuple[int, int]]) -> None:
    times, values = map(list, zip(*rows, strict=True))
    sent = BoardSamples(number, seq, t_us, np.array(values, np.int32), np.array(times, np.uint32))
    again = decode(body_of(sent))
    assert isinstance(again, BoardSamples)
    assert again.times_us is not None
    assert (again.stream, again.seq, again.t_us) == (number, seq, t_us)
    assert (again.times_us.tolist(), again.values.tolist()) == (times, values)


@given(st.sampled_from(sorted(ARGUMENTS)), U8, st.data())
def test_commands_come_back(code: int, tag: int, data: st.DataObject) -> None:
    argument = data.draw(LIMITS[BoardCode(code)]) if code in LIMITS else None
    command = CommandFrame(code, tag, argument)
    assert decode(body_of(command)) == command


@given(U8, U8, U8)
def test_replies_come_back(code: int, tag: int, status: int) -> None:
    assert decode(body_of(BoardReply(code, tag, status))) == BoardReply(code, tag, status)


@settings(max_examples=30, deadline=None)
@given(st.text(), st.text(), st.lists(NAMES, unique=True, max_size=8), SCALES, st.data())
def test_hellos_come_back(
    board: str, serial: str, names: list[str], scale: float, data: st.DataObject
) -> None:
    channels = st.integers(1, 6) | st.lists(NAMES, min_size=1, max_size=3).map(tuple)
    rates = st.none() | st.floats(0.1, 1e6)
    hello = BoardHello(
        board=board,
        serial=serial,
        version="1",
        streams=tuple(
            HelloStream(
                id=number,
                name=name,
                channels=data.draw(channels),
                rate_hz=data.draw(rates),
                unit="N",
                scale=scale,
            )
            for number, name in enumerate(names)
        ),
    )
    assert decode(body_of(hello)) == hello


@given(st.binary(max_size=60))
def test_any_body_is_a_message_or_a_codec_error(body: bytes) -> None:
    try:
        message = decode(body)
    except CodecError:
        return
    assert isinstance(message, BoardSamples | BoardHello | CommandFrame | BoardReply)


@pytest.mark.parametrize(
    ("body", "named"),
    [
        ("", "begins with nothing"),
        ("7f 00 00", "begins with 7f"),
        ("01 00 02 01 40 42 0f", "kind 0x01 with 7 bytes"),
        ("01 00 02 01 40 42 0f 00", "a frame without samples"),
        ("01 00 02 01 40 42 0f 00 00 c0 ff", "kind 0x01 with 11 bytes"),
        ("02 00 02 01 40 42 0f 00 00 00 00 00", "kind 0x02 with 12 bytes"),
        ("80 04", "kind 0x80 with 2 bytes"),
        ("80 04 07", "kind 0x80 with 3 bytes"),
        ("80 03 07 01", "kind 0x80 with 4 bytes"),
        ("81 04 07", "kind 0x81 with 3 bytes"),
        ("81 04 07 00 00", "kind 0x81 with 5 bytes"),
        (b"\x03{".hex(), "hello"),
        (b"\x03\xff\xfe".hex(), "hello"),
        (hello_body(stream(id=-1)).hex(), "hello (streams.0.id)"),
        (hello_body(stream(id=32)).hex(), "hello (streams.0.id)"),
        (hello_body(stream(), stream(name="other")).hex(), "two streams have one id"),
        (hello_body(stream(), stream(id=1)).hex(), "two streams have one name"),
        (hello_body(stream(scale=0)).hex(), "scale of 0"),
        (hello_body(stream(scale="1e-5")).hex(), "scale"),
        (hello_body(stream(rate_hz=-1)).hex(), "rate_hz"),
        (hello_body(stream(channels=0)).hex(), "channels"),
        (hello_body(stream(channels=[])).hex(), "channels"),
        (hello_body(stream(name="Load Cell")).hex(), "name"),
        (hello_body(board=None).hex(), "board"),
    ],
)
def test_a_body_that_is_no_message_is_refused_by_its_kind_and_place(body: str, named: str) -> None:
    with refused(CodecError, named):
        decode(bytes.fromhex(body))


def test_a_command_that_is_not_known_keeps_its_code_and_tag_for_the_answer() -> None:
    assert decode(bytes.fromhex("80 63 05 aa bb")) == CommandFrame(0x63, 5)


@pytest.mark.parametrize(
    "message",
    [
        CommandFrame(BoardCode.WATCHDOG, 0, 70_000),
        CommandFrame(BoardCode.EXCITE, 0),
        CommandFrame(BoardCode.STOP, 0, 1),
        CommandFrame(99, 0),
        BoardReply(4, 256, 0),
        BoardSamples(0, 65_536, 0, np.zeros(1, np.int32)),
        BoardSamples(0, 0, 0, np.zeros(0, np.int32)),
    ],
)
def test_what_does_not_fit_into_its_field_is_not_encoded(message: Message) -> None:
    with pytest.raises(CodecError):
        encode(message)


def test_keys_of_a_newer_board_are_passed_over() -> None:
    hello = decode(hello_body(stream(range=22.2), colour="red"))
    assert isinstance(hello, BoardHello)
    assert hello.streams[0].unit == "N"


@pytest.mark.parametrize(
    ("channels", "names"), [(1, ("load_cell",)), (3, ("0", "1", "2")), (["x", "z"], ("x", "z"))]
)
def test_channels_are_named_or_counted(channels: Any, names: tuple[str, ...]) -> None:
    hello = decode(hello_body(stream(channels=channels)))
    assert isinstance(hello, BoardHello)
    assert hello.streams[0].channel_names == names
