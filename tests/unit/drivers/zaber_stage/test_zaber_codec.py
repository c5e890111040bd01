"""The stage's lines, and microsteps out of metres."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.core.errors import CodecError
from drivers.core.messages import MoveAt
from drivers.zaber_stage import codec
from drivers.zaber_stage.mounting import Mounting, ZaberStageSettings

GOLDEN = tomllib.loads((Path(__file__).parents[3] / "data" / "zaber_golden.toml").read_text())


def pick(case: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in case.items() if key not in ("source", "bytes")}


@pytest.mark.parametrize("case", GOLDEN["request"], ids=lambda case: case["source"])
def test_a_request_has_the_bytes_of_the_page(case: dict[str, Any]) -> None:
    request = codec.StageRequest(**pick(case))
    assert codec.encode_request(request) == case["bytes"].encode()
    assert codec.decode_request(case["bytes"].encode().rstrip()) == request


@pytest.mark.parametrize("case", GOLDEN["reply"], ids=lambda case: case["source"])
def test_a_reply_has_the_bytes_of_the_page(case: dict[str, Any]) -> None:
    reply = codec.StageReply(**pick(case))
    assert codec.encode_message(reply) == case["bytes"].encode()
    assert codec.decode_message(case["bytes"].encode().rstrip()) == reply


ALERT = codec.StageReply(1, 1, None, True, False, "FS", "", "!")
INFO = codec.StageReply(1, 0, 9, True, False, "--", "hello", "#")


@pytest.mark.parametrize(
    ("message", "line"),
    [
        (ALERT, b"!01 1 IDLE FS"),
        (replace(ALERT, busy=True, flag="--", data="7"), b"!01 1 BUSY -- 7"),
        (INFO, b"#01 0 09 hello"),
        (replace(INFO, id=None), b"#01 0 hello"),
        (codec.StageReply(1, 1, None, True, False, "--", "0"), b"@01 1 OK IDLE -- 0"),
    ],
)
def test_what_a_stage_says_goes_there_and_back(message: codec.StageReply, line: bytes) -> None:
    checked = line + f":{-sum(line[1:]) & 0xFF:02X}".encode()
    assert codec.encode_message(message, checksum=False) == line + b"\r\n"
    assert codec.encode_message(message) == checked + b"\r\n"
    assert codec.decode_message(line, checksum=False) == message
    assert codec.decode_message(checked) == message


@pytest.mark.parametrize(
    ("line", "request_"),
    [
        (b"/stop", codec.StageRequest(0, 0, None, "stop")),
        (b"/", codec.StageRequest(0, 0, None, "")),
        (b"/2 stop", codec.StageRequest(2, 0, None, "stop")),
        (b"/2 1 stop", codec.StageRequest(2, 1, None, "stop")),
        (b"/2 1 7 5 set", codec.StageRequest(2, 1, 7, "5 set")),
    ],
)
def test_numbers_that_a_request_leaves_out_are_zero(line: bytes, request_: codec.StageRequest) -> None:
    assert codec.decode_request(line) == request_


def test_a_request_without_a_number_has_none_on_the_wire() -> None:
    assert codec.encode_request(codec.StageRequest(2, 1, None, "stop"), checksum=False) == b"/2 1 stop\n"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"", "no Zaber ASCII line"),
        (b"hello", "no Zaber ASCII line"),
        (b"@", "no Zaber ASCII message"),
        (b"@01 1", "no Zaber ASCII message"),
        (b"@01 1 04 YES IDLE -- 0", "no Zaber ASCII message"),
        (b"@a b c d", "no Zaber ASCII message"),
        (b"@\xff", "not ASCII"),
        (b"@01 1 04 OK IDLE -- 24188:32", "wrong checksum"),
        (b"@01 1 04 OK IDLE -- 24188", "no checksum"),
    ],
)
def test_a_refused_line_is_quoted(line: bytes, reason: str) -> None:
    with pytest.raises(CodecError) as error:
        codec.decode_message(line, checksum=reason == "no checksum")
    assert str(error.value) == f"{reason}: {line!r}"


def test_a_flag_without_a_meaning_is_a_fault() -> None:
    assert codec.meaning("ZZ") == "it reports a fault"


def test_a_checksum_is_held_against_a_command_and_may_be_missing_where_none_is_due() -> None:
    with pytest.raises(CodecError, match="wrong checksum"):
        codec.decode_request(b"/1 1 07 stop:12")
    assert codec.decode_message(b"@01 1 04 OK IDLE -- 24188", checksum=False).data == "24188"


@given(
    st.sampled_from(GOLDEN["reply"]),
    st.integers(min_value=1, max_value=27),
    st.integers(min_value=0, max_value=7),
)
def test_no_flipped_bit_of_a_checked_reply_goes_unseen(case: dict[str, Any], place: int, bit: int) -> None:
    line = bytearray(case["bytes"].encode().rstrip())
    place = min(place, len(line) - 1)
    line[place] ^= 1 << bit
    if place >= len(line) - 2 and bit == 5:
        return  # 0xAB and 0xab are the same checksum
    with pytest.raises(CodecError):
        codec.decode_message(bytes(line))


def test_speeds_become_the_data_of_the_page() -> None:
    assert codec.velocity_data(0.00254, codec.MICROSTEP_M) == 8389
    assert codec.velocity_data(0.0127, codec.MICROSTEP_M) == 41943
    assert codec.velocity_m_s(8389, codec.MICROSTEP_M) == pytest.approx(0.00254, rel=1e-4)


@pytest.mark.parametrize(
    ("flag", "lost"),
    [*((flag, True) for flag in ("FS", "FD", "FQ", "WM", "WS", "WL")), ("NI", False), ("WV", False)],
)
def test_faults_and_displacement_say_that_the_stage_has_lost_its_way(flag: str, lost: bool) -> None:
    assert codec.astray(flag) is lost


STEP_M = 0.49609375e-6


def mounting(**settings: object) -> Mounting:
    return Mounting(ZaberStageSettings(port="-", **settings))  # type: ignore[arg-type]


@given(st.floats(min_value=0.0, max_value=0.0254))
def test_a_limit_is_never_beyond_what_was_asked_for_and_less_than_a_microstep_before_it(
    position_m: float,
) -> None:
    m = mounting()
    slack_m = 1e-6 * STEP_M
    assert position_m - STEP_M < m.position_m(m.at_most(position_m)) <= position_m + slack_m
    assert position_m - slack_m <= m.position_m(m.at_least(position_m)) < position_m + STEP_M


def test_a_whole_number_of_microsteps_is_met_exactly() -> None:
    m = mounting()
    assert m.at_most(1000 * STEP_M) == m.at_least(1000 * STEP_M) == m.nearest(1000 * STEP_M) == 1000


@pytest.mark.parametrize(("velocity_m_s", "counts"), [(0.01, 1000), (-0.01, 1001)])
def test_an_approach_ends_at_the_last_whole_microstep_before_its_limit(
    velocity_m_s: float, counts: int
) -> None:
    assert mounting().target(MoveAt("stage", velocity_m_s, 1000.5 * STEP_M)) == counts


def test_positions_count_from_the_origin_away_from_the_home_end() -> None:
    m = mounting(origin_m=0.0127, travel_max_m=1000 * STEP_M)
    assert m.device(0) == 25600
    assert m.device(1000) == 26600
    assert m.counts(26600) == 1000
    assert m.limits() == {"limit.min": 25600, "limit.max": 26600}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"travel_min_m": 0.02, "travel_max_m": 0.01}, "is not below"),
        ({"travel_min_m": -0.001}, "travel_min_m = -0.001 is 0.001 m beyond the home end"),
        ({"travel_max_m": 0.03}, "travel_m is 0.0254"),
        ({"travel_m": 0.02}, "travel_max_m = 0.0254 is 0.0254 m from the home end"),
        ({"forward": -1}, "forward"),
        ({"max_speed_m_s": float("nan")}, "max_speed_m_s"),
        ({"baud": "fast"}, "baud"),
    ],
)
def test_settings_that_no_stage_can_follow_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ZaberStageSettings(port="-", **wrong)  # type: ignore[arg-type]
